"""Agents in step, without router and clocks: every message reaches whoever listens before the next tick.

What comes of it is a recording like those of live sessions, and the same every time.
"""

import dataclasses
from collections import Counter, deque
from collections.abc import Iterable
from typing import Any

from schemas.codec import decode, encode, encoding_name
from schemas.messages import CommandAnswer, CommandRecord
from schemas.topics import COMMANDS, MAIN, Topic, key
from shared.recording.mcap_file import Entry
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick, awaited, only_remembers, outputs_in
from shared.runtime.fed import Fed

STEP_NS = 10_000_000
BEGAN_NS = 1_767_225_600_000_000_000
"""The first moment of 2026."""


@dataclasses.dataclass(frozen=True)
class _Sent:
    """A message under way."""

    topic: Topic
    instance: str
    key: str
    epoch: int
    sequence: int
    message: Any
    payload: bytes | None


class _Seat:
    """One agent, what it was fed since its last output, what it has yet to remember, and when it ticks."""

    def __init__(self, agent: Agent, rig: str, epoch: int) -> None:
        self.agent, self.epoch, self.fed = agent, epoch, Fed(agent, rig, epoch)
        self.due_ns = BEGAN_NS
        self.to_remember: dict[str, _Sent] = {}

    def listens(self, topic: Topic, instance: str) -> list[Input]:
        return [i for i in self.agent.inputs if i.topic is topic and i.instance in ("*", instance)]


class Lockstep:
    """A session.

    Fields:
        entries: what a recorder would have written; nothing where nothing is `recorded`.
        last: the newest message of each topic.
        now_ns: the virtual time.
    """

    def __init__(self, *agents: Agent, rig: str, recorded: bool = True, as_sent: bool = False) -> None:
        """Seat the agents.

        Args:
            as_sent: hand messages on as they are, rather than as they would arrive: a third faster. Arrays that lie
                otherwise in memory are added up otherwise, so a replay of the recording may differ in last digits.
        """
        self._rig, self._recorded, self._as_sent, self._own_epoch = rig, recorded, as_sent, len(agents) + 1
        self._seats = [_Seat(agent, rig, epoch) for epoch, agent in enumerate(agents, start=1)]
        self.entries: list[Entry] = []
        self.last: dict[Topic, Any] = {}
        self.now_ns = BEGAN_NS
        self._numbers: Counter[str] = Counter()
        self._waiting: deque[_Sent] = deque()

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.now_ns += STEP_NS
            for seat in self._seats:
                if seat.agent.tick_hz is not None and self.now_ns >= seat.due_ns:
                    seat.due_ns += round(1e9 / seat.agent.tick_hz)
                    self._remember(seat)
                    seat.fed.tick(self.now_ns)
                    self._step(seat, Tick(self.now_ns))

    def command(self, topic: Topic, message: Any) -> CommandAnswer:
        """Have a command carried out; its answer."""
        (seat,) = [seat for seat in self._seats if topic in seat.agent.commands]
        name = key(self._rig, COMMANDS, seat.agent.instance, seat.agent.kind)
        self._remember(seat)
        seat.fed.message(name, seat.epoch, self._numbers[name])
        replies = awaited(seat.agent.step(Command(topic, seat.agent.instance, message, self.now_ns)))
        (answer,) = [reply for reply in replies if isinstance(reply, CommandAnswer)]
        record = CommandRecord(str(topic), encoding_name(type(message)), encode(message), self.now_ns, answer)
        self._publish(seat.epoch, COMMANDS, seat.agent.instance, name, record)
        self._publish_all(seat, outputs_in(replies))
        self._deliver()
        return answer

    def tell(self, outputs: Iterable[Output], instance: str = MAIN) -> None:
        """Publish what somebody says who has no seat."""
        for output in outputs:
            name = key(self._rig, output.topic, instance)
            self._publish(self._own_epoch, output.topic, instance, name, output.message)
            self._deliver()

    def _step(self, seat: _Seat, arrived: Received | Tick) -> None:
        self._publish_all(seat, outputs_in(seat.agent.step(arrived)))
        self._deliver()

    def _publish_all(self, seat: _Seat, outputs: list[Output]) -> None:
        listed, last = seat.fed.listed() if outputs and self._recorded else (), None
        for output in outputs:
            instance = seat.agent.instance if output.topic.per_arm else MAIN
            name = key(self._rig, output.topic, instance)
            message = output.message
            if self._recorded and hasattr(message, "consumed"):
                message = dataclasses.replace(message, consumed=listed)
            place = name, self._publish(seat.epoch, output.topic, instance, name, message)
            last = place if output.topic is (seat.agent.goes_on_from or output.topic) else last
        if last is not None:
            seat.fed.published(*last)

    def _publish(self, epoch: int, topic: Topic, instance: str, name: str, message: Any) -> int:
        number = self._numbers[name]
        self._numbers[name] += 1
        self.last[topic] = message
        heard = any(seat.listens(topic, instance) for seat in self._seats)
        payload = encode(message) if self._recorded or (heard and not self._as_sent) else None
        if self._recorded and payload is not None and topic.recorded:
            self.entries.append(Entry(name, epoch, number, payload, self.now_ns, self.now_ns))
        if heard:
            self._waiting.append(_Sent(topic, instance, name, epoch, number, message, payload))
        return number

    def _deliver(self) -> None:
        while self._waiting:
            sent = self._waiting.popleft()
            for seat in self._seats:
                for wanted in seat.listens(sent.topic, sent.instance):
                    if only_remembers(seat.agent, wanted):
                        seat.to_remember[sent.key] = sent
                    else:
                        self._remember(seat)
                        self._feed(seat, sent, wanted.only_newest_counts)

    def _remember(self, seat: _Seat) -> None:
        """Feed the newest of what is only remembered, right before what the agent acts on."""
        while seat.to_remember:
            name = next(iter(seat.to_remember))
            self._feed(seat, seat.to_remember.pop(name), only_newest_counts=True)

    def _feed(self, seat: _Seat, sent: _Sent, only_newest_counts: bool) -> None:
        seat.fed.message(sent.key, sent.epoch, sent.sequence, only_newest_counts)
        message = sent.message if self._as_sent else decode(sent.topic.message, sent.payload or b"")
        self._step(seat, Received(sent.topic, sent.key, sent.sequence, message))
