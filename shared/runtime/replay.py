"""Replay of one agent from a recording: exactly the inputs that it consumed, in that order, and the same outputs.

Each recorded output lists what was fed to the agent since the output before, and the newest of each key of which
nothing else counts. Feeding the same again must give the same bytes, since a step is a function of what the agent was
fed. What lies in a recording and was never fed (frames that a newer one replaced) is left out.

A recording may lack an input: it came before the recording began, or was lost on its way to the recorder. The output
made from it cannot be repeated; it is handed out with what is missing, and is neither the same nor different.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from schemas.codec import decode, encode
from schemas.messages import CommandRecord, Consumed
from schemas.topics import COMMANDS, TOPICS, topic_of
from shared.runtime.agent import Agent, Command, Output, Received


class Recorded(Protocol):
    """One recorded message: its key, its number in which run of its publisher, and its bytes."""

    @property
    def key(self) -> str: ...
    @property
    def epoch(self) -> int: ...
    @property
    def sequence(self) -> int: ...
    @property
    def payload(self) -> bytes: ...


@dataclass(frozen=True)
class Replayed:
    """One recorded output beside what a replay made of the same inputs.

    Fields:
        now: None where the replay made nothing.
        missing: what the output was made from and the recording does not hold.
    """

    key: str
    epoch: int
    sequence: int
    then: bytes
    now: bytes | None
    missing: tuple[Consumed, ...] = ()

    @property
    def same(self) -> bool:
        """Whether both are the same, byte for byte."""
        return self.then == self.now


class ReplayError(ValueError):
    """An agent or a recording that cannot be replayed; the text says why."""


class _Place(NamedTuple):
    key: str
    epoch: int
    sequence: int


class _Run:
    """One run of the agent, from its start: what was fed to it, and what it made of what was fed last."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._fed: set[_Place] = set()
        self._consumed: tuple[Consumed, ...] = ()
        self._made: list[Output] = []

    def remake(self, topic: str, consumed: tuple[Consumed, ...], messages: Mapping[_Place, Recorded]) -> bytes | None:
        """The next output on a topic that was made from this, once what is new of it has been fed."""
        if consumed != self._consumed:
            self._consumed, self._made = consumed, []
            for place in (_place(c) for c in consumed):
                if place in messages and place not in self._fed:
                    self._fed.add(place)
                    self._made += _fed(self._agent, messages[place])
        return _next_of(self._made, topic, consumed)


def replay(build: Callable[[], Agent], recording: Iterable[Recorded]) -> Iterator[Replayed]:
    """Feed an agent what it consumed in a recording and compare each of its outputs.

    `build` gives the agent with the settings of the recorded one, as it was before its first step: one for each run, so
    that an agent that was restarted begins anew.

    Raises:
        ReplayError: where the agent acts on ticks, which are in no recording, or a command is of an unknown topic.
    """
    agent = build()
    if agent.tick_hz is not None:
        raise ReplayError(f"{agent.kind} acts on ticks of the clock, which no recording holds; it cannot be replayed")
    messages = {_place(r): r for r in recording if _concerns(agent, r.key)}
    outputs = {str(topic) for topic in agent.outputs}
    runs: dict[int, _Run] = {}
    for place, recorded in messages.items():
        topic = topic_of(recorded.key)
        if str(topic) not in outputs:
            continue
        if recorded.epoch not in runs:
            runs[recorded.epoch] = _Run(build())
        consumed = decode(topic.message, recorded.payload).consumed
        now = runs[recorded.epoch].remake(str(topic), consumed, messages)
        missing = tuple(c for c in consumed if _place(c) not in messages)
        yield Replayed(*place, recorded.payload, None if missing else now, missing)


def _place(named: Recorded | Consumed) -> _Place:
    return _Place(named.key, named.epoch, named.sequence)


def _concerns(agent: Agent, key: str) -> bool:
    """Whether a message is an input, an output or a command of the agent; the rest need not be kept."""
    topic, (kind, instance) = topic_of(key), key.split("/")[2:4]
    if topic is COMMANDS:
        return (kind, instance) == (agent.kind, agent.instance)
    listened = any(i.topic is topic and i.instance in ("*", instance) for i in agent.inputs)
    return listened or topic in agent.outputs


def _fed(agent: Agent, recorded: Recorded) -> list[Output]:
    topic = topic_of(recorded.key)
    if topic is COMMANDS:
        arrived: Any = _command(recorded)
    else:
        arrived = Received(topic, recorded.key, recorded.sequence, decode(topic.message, recorded.payload))
    return [output for output in agent.step(arrived) if isinstance(output, Output)]


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
