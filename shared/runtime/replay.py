"""Replay of one agent from a recording: exactly the inputs that it consumed, in that order, and the same outputs.

Each recorded output lists what was fed to the agent since the output before (shared/runtime/outlets.py). Feeding the
same again must give the same bytes, since a step is a function of what the agent was fed. What lies in a recording and
was never fed (frames that a newer one replaced) is left out. Ticks of the agent's clock are in the lists themselves.

A recording may lack an input: it came before the recording began, or was lost on its way to the recorder. The output
made from it cannot be repeated; it is handed out with what is missing, and is neither the same nor different. Of an
agent that adds up what it is fed, the same holds for all outputs after it, and after an output that was lost, of which
nobody knows what it listed. An agent that goes on from its own last output is fed that, so that only the next is lost.
It is fed the recorded one each time, which tells of every step by itself; or, where asked to, only where the replay has
none of its own, so that what a changed agent makes otherwise has the consequences that it would have had live.

`Lockstep` runs several agents in step, without router and clocks: every message reaches whoever listens before the next
tick. What comes of it is a recording like those of live sessions, and the same every time.
"""

import dataclasses
import functools
import logging
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from schemas.codec import decode, encode, encoding_name
from schemas.messages import CommandAnswer, CommandRecord, Consumed
from schemas.topics import COMMANDS, CONFIGURATION, MAIN, TOPICS, Topic, key, topic_of
from shared.recording.mcap_file import Entry
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick, awaited, only_remembers, outputs_in
from shared.runtime.outlets import Fed, adds_up, is_tick
from shared.runtime.parameters import Parameters


class Placed(Protocol):
    """What names a message: its key, and its number in which run of its publisher."""

    @property
    def key(self) -> str: ...
    @property
    def epoch(self) -> int: ...
    @property
    def sequence(self) -> int: ...


class Recorded(Placed, Protocol):
    """One recorded message, with its bytes; repeated ones are from before, for others to be made from."""

    @property
    def payload(self) -> bytes: ...
    @property
    def repeated(self) -> bool: ...


@dataclass(frozen=True)
class Replayed:
    """One recorded output beside what a replay made of the same inputs.

    Fields:
        now: None where the replay made nothing.
        missing: what the output was made from and the recording does not hold; of an agent that adds up, all of it
            since the run began.
        unrecorded: outputs of the same topic that the replay made of what was fed before, and the recording has not.
    """

    key: str
    epoch: int
    sequence: int
    then: bytes
    now: bytes | None
    missing: tuple[Consumed, ...] = ()
    unrecorded: int = 0

    @property
    def same(self) -> bool:
        """Whether both are the same, byte for byte."""
        return self.then == self.now


class ReplayError(ValueError):
    """A recording that cannot be replayed; the text says why."""


class Place(NamedTuple):
    """Key, run and number of a message."""

    key: str
    epoch: int
    sequence: int


_Steps = dict[tuple[Consumed, ...], list[Recorded]]
"""The steps of one run: what each listed, and its outputs, which list the same."""


class _Run:
    """One run of the agent, from its start: what was fed to it, and what is missing since."""

    def __init__(self, agent: Agent, messages: Mapping[Place, Recorded], from_own_state: bool) -> None:
        self._agent, self._messages = agent, messages
        # what goes on from its last output alone loses no more than the next one
        self._adds_up = adds_up(agent)
        self._parameters = Parameters(agent)
        self._from_own_state = from_own_state
        self._fed: set[Place] = set()
        self._missing: tuple[Consumed, ...] = ()

    def repeat(self, consumed: tuple[Consumed, ...], outputs: Sequence[Recorded]) -> Iterator[Replayed]:
        """The outputs of a step beside what is made now, once what is new of its list has been fed."""
        made: list[Output] = []
        unrecorded: list[Output] = []
        for arrived in self._still_to_feed(consumed):
            # the last one is what the recorded outputs followed from
            unrecorded += made
            made = self._outputs(arrived)
        missing = tuple(c for c in consumed if not is_tick(c.key) and place_of(c) not in self._messages)
        if missing or not self._adds_up:
            self._missing = (*self._missing, *missing) if self._adds_up else missing
        for output in outputs:
            topic = topic_of(output.key)
            now = None if self._missing else _next_of(made, str(topic), consumed)
            if self._from_own_state and now is not None and topic is self._agent.goes_on_from:
                # its state is the agent's own from here on, and need not be fed
                self._fed.add(place_of(output))
            more = sum(other.topic is topic for other in unrecorded)
            yield Replayed(*place_of(output), output.payload, now, self._missing, more)

    def _still_to_feed(self, consumed: tuple[Consumed, ...]) -> Iterator[Received | Tick | Command]:
        for listed in consumed:
            place, recorded = place_of(listed), self._messages.get(place_of(listed))
            if is_tick(listed.key):
                yield Tick(listed.sequence)
            elif recorded is not None and place not in self._fed and self._is_fed(listed.key):
                self._fed.add(place)
                yield _arrived(recorded)

    def _outputs(self, arrived: Received | Tick | Command) -> list[Output]:
        """What a step gives; one that raises gives nothing and is logged, as in a live session."""
        try:
            return outputs_in(self._parameters.step(arrived))
        except Exception as error:
            name = f"suturegrasp.{self._agent.kind}.{self._agent.instance}"
            logging.getLogger(name).error("a step failed", exc_info=error)
            return []

    def _is_fed(self, key: str) -> bool:
        topic = topic_of(key)
        return topic not in self._agent.outputs or topic is self._agent.goes_on_from


@dataclass(frozen=True)
class Step:
    """One step of an agent: what it listed as consumed, and its outputs."""

    run: int
    consumed: tuple[Consumed, ...]
    outputs: tuple[Recorded, ...]


class Replay:
    """The replay of one agent, step by step, run by run.

    Fields:
        steps: in the order in which they are repeated.
        messages: what is fed, by place; whoever replays several agents puts there what each of them makes now.
    """

    def __init__(self, build: Callable[[], Agent], recording: Iterable[Recorded], from_own_state: bool = False) -> None:
        """See `replay`."""
        agent = build()
        concern = functools.cache(functools.partial(_concerns, agent))
        self.messages: dict[Place, Recorded] = {place_of(r): r for r in recording if concern(r.key)}
        runs: dict[int, _Steps] = {}
        for recorded in self.messages.values():
            if not recorded.repeated and _is_output(agent, recorded.key):
                consumed = decode(topic_of(recorded.key).message, recorded.payload).consumed
                runs.setdefault(recorded.epoch, {}).setdefault(consumed, []).append(recorded)
        self.steps = [
            Step(run, consumed, tuple(steps[consumed])) for run, steps in runs.items() for consumed in _in_order(steps)
        ]
        self._build, self._from_own_state = build, from_own_state
        self._runs: dict[int, _Run] = {}

    def repeat(self, step: Step) -> list[Replayed]:
        """The outputs of the next step of its run, beside what is made now."""
        if step.run not in self._runs:
            self._runs[step.run] = _Run(self._build(), self.messages, self._from_own_state)
        return list(self._runs[step.run].repeat(step.consumed, step.outputs))


def replay(
    build: Callable[[], Agent], recording: Iterable[Recorded], from_own_state: bool = False
) -> Iterator[Replayed]:
    """Feed an agent what it consumed in a recording and compare each of its outputs, run by run.

    `build` gives the agent with the settings of the recorded one, as it was before its first step: one for each run, so
    that an agent that was restarted begins anew. With `from_own_state`, an agent that goes on from its last output goes
    on from the one that this replay made, and from the recorded one only where that could not be repeated.

    Raises:
        ReplayError: where a command is of an unknown topic.
    """
    replayed = Replay(build, recording, from_own_state)
    for step in replayed.steps:
        yield from replayed.repeat(step)


def _in_order(steps: _Steps) -> Iterator[tuple[Consumed, ...]]:
    """Each step after the one whose output it names as the one before; those that name none, as they were recorded."""
    made_by = {place_of(output): consumed for consumed, outputs in steps.items() for output in outputs}
    before = {step: next((made_by[p] for p in map(place_of, step) if p in made_by), None) for step in steps}
    # several steps name the same one where those between gave no output that the next goes on from
    after: defaultdict[tuple[Consumed, ...] | None, list[tuple[Consumed, ...]]] = defaultdict(list)
    for step, named in before.items():
        after[named].append(step)
    for first in after[None]:
        waiting = deque([first])
        while waiting:
            step = waiting.popleft()
            yield step
            waiting.extend(after[step])


def place_of(named: Placed) -> Place:
    """Where a message stands in a recording."""
    return Place(named.key, named.epoch, named.sequence)


def _concerns(agent: Agent, key: str) -> bool:
    """Whether a message is an input, an output or a command of the agent; the rest need not be kept."""
    topic, (kind, instance) = topic_of(key), key.split("/")[2:4]
    if topic in (COMMANDS, CONFIGURATION):
        return (kind, instance) == (agent.kind, agent.instance)
    listened = any(i.topic is topic and i.instance in ("*", instance) for i in agent.inputs)
    return listened or _is_output(agent, key)


def _is_output(agent: Agent, key: str) -> bool:
    topic = topic_of(key)
    return topic in agent.outputs and (not topic.per_arm or key.split("/")[3] == agent.instance)


def _arrived(recorded: Recorded) -> Received | Command:
    topic = topic_of(recorded.key)
    if topic is COMMANDS:
        return _command(recorded)
    return Received(topic, recorded.key, recorded.sequence, decode(topic.message, recorded.payload))


def _command(recorded: Recorded) -> Command:
    record = decode(CommandRecord, recorded.payload)
    topic = next((topic for topic in TOPICS if str(topic) == record.topic), None)
    if topic is None:
        raise ReplayError(f"{recorded.key} holds a command {record.topic!r}, which the topic table does not know")
    instance = recorded.key.split("/")[-2]
    return Command(topic, instance, decode(topic.message, record.payload), record.received_ns)


def _next_of(made: list[Output], topic: str, consumed: tuple[Consumed, ...]) -> bytes | None:
    """The next output that was made on a topic, as it would travel; it is taken out of the list."""
    for index, output in enumerate(made):
        if str(output.topic) == topic:
            return encode(dataclasses.replace(made.pop(index).message, consumed=consumed))
    return None


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
