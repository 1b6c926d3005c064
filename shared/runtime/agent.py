"""What an agent is, seen from the runtime: inputs, outputs, and a step from one message to others.

An agent is an object with state and no sockets: `step` takes what arrived and returns what is to be published. The same
object runs live (`shared.runtime.runner`) and on a recording (`shared.runtime.replay`).
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

from schemas.messages import CommandAnswer
from schemas.topics import MAIN, Topic


@dataclass(frozen=True)
class Input:
    """A topic that an agent listens to.

    Fields:
        instance: whose; `*` for all.
        only_newest_counts: that the agent keeps nothing of earlier messages of this topic, so that a replay may leave
            them out.
        only_remembered: that it does no more with a message of this topic than to remember the newest of each key: so
            that one alone is decoded and fed, right before what the agent acts on. For *latest* topics of which only
            the newest counts: it saves a quarter of the processor that states at 100 Hz take. See `Agent.acts_on`.
    """

    topic: Topic
    instance: str = MAIN
    only_newest_counts: bool = False
    only_remembered: bool = False


@dataclass(frozen=True)
class Received:
    """A message of one of the inputs, with its key and its sequence number there."""

    topic: Topic
    key: str
    sequence: int
    message: Any


@dataclass(frozen=True)
class Tick:
    """The time, for agents that act without being asked. The first one comes before any other message."""

    now_ns: int


@dataclass(frozen=True)
class Command:
    """A command for this agent, not yet carried out; the step must yield its CommandAnswer first."""

    topic: Topic
    instance: str
    message: Any
    now_ns: int


@dataclass(frozen=True)
class Output:
    """A message to publish under one of the agent's outputs."""

    topic: Topic
    message: Any


@dataclass(frozen=True)
class Later:
    """An output that is still worked on when its step is over, so that the next step need not wait for it.

    It follows from its step as any other output: live it is published once it is there, and a replay waits for it. The
    next one of an agent waits for the one before it. None of a topic that the agent goes on from.

    Fields:
        coming: its message (`shared.background`).
    """

    topic: Topic
    coming: Future[Any]

    def output(self) -> Output:
        """The output, once it is there.

        Raises:
            Exception: whatever the work raised.
        """
        return Output(self.topic, self.coming.result())


class CannotGoOnError(Exception):
    """Raised by a step after which the agent can do nothing more; the text is the reason with which it ends."""


Reply = Output | Later | CommandAnswer


def awaited(replies: Iterable[Reply]) -> list[Output | CommandAnswer]:
    """All that follows from a step, once nothing of it is worked on any more."""
    return [reply.output() if isinstance(reply, Later) else reply for reply in list(replies)]


def outputs_in(replies: Iterable[Reply]) -> list[Output]:
    """The outputs among that."""
    return [reply for reply in awaited(replies) if isinstance(reply, Output)]


class Agent(ABC):
    """One stage of the dataflow; what the runtime asks of it beyond `step` has a default here.

    Fields:
        kind: the agent's name in keys, such as `perception`.
        instance: `main`, or the arm's name.
        inputs, outputs: what it hears and says.
        commands: what it answers.
        tick_hz: how often it wants the time; None for never. It may change with each step, but not from or to None.
        config: a frozen dataclass, which everybody on the rig may read. Fields of it that are `settable` may be set.
        goes_on_from: an output whose last message holds all that counts of what the agent was fed before: a replay
            feeds it that message in place of all before, and needs no more of the past.
        only_newest_tick_counts: that a tick that nothing followed has changed nothing, so that a replay may leave it
            out.
        accepts_replayed_time: False where the time of a recording that is replayed on its rig does not become its own,
            since it moves something real.
        keeps_time: its clock goes on by the monotonic clock for as long as that is true.
        watches_clocks: kinds of agents of whose hosts the runner measures the clocks, and tells them on
            `planner/clocks`.
    """

    kind: str
    instance: str = MAIN
    inputs: tuple[Input, ...] = ()
    outputs: tuple[Topic, ...] = ()
    commands: tuple[Topic, ...] = ()
    tick_hz: float | None = None
    config: Any = None
    goes_on_from: Topic | None = None
    only_newest_tick_counts: bool = False
    accepts_replayed_time: bool = True
    keeps_time: bool = False
    watches_clocks: tuple[str, ...] = ()

    @abstractmethod
    def step(self, arrived: Received | Tick | Command) -> Iterable[Reply]:
        """What follows from one message, tick or command; deterministic in everything that was fed to the agent."""

    def configure(self, config: Any) -> None:
        """Go on with a config in which settable fields have changed."""
        self.config = config

    def acts_on(self, topic: Topic) -> bool:  # noqa: ARG002 - an agent that remembers all alike
        """Whether it does more now with an input that is only remembered otherwise than to remember it."""
        return False

    def halt(self) -> None:  # noqa: B027 - most have nothing that moves
        """Called from any thread as soon as a command that stops has come (`shared.runtime.commands.stops`), before it
        is stepped; such a command goes before all others."""

    def close(self) -> None:  # noqa: B027 - most have nothing to let go of
        """Called once at the end, whatever ended it."""


def only_remembers(agent: Agent, wanted: Input) -> bool:
    """Whether the agent would do no more with a message of this input, came it now, than to remember it."""
    return wanted.only_remembered and not agent.acts_on(wanted.topic)
