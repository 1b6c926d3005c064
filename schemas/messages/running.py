"""What agents say about themselves and about what they were told: health, log, commands, clocks."""

import enum
from dataclasses import dataclass

from schemas.checks import UInt64, check_message, require


@dataclass(frozen=True)
class Consumed:
    """One message that an output was made from: its key, and its number in one run (epoch) of its publisher.

    A tick of the agent's own clock is one too: its key ends in `tick`, and its number is its time in nanoseconds.
    """

    key: str
    epoch: UInt64
    sequence: UInt64

    def __post_init__(self) -> None:
        check_message(self)
        require(self.key != "", "Consumed.key is empty")
        for name in ("epoch", "sequence"):
            require(getattr(self, name) >= 0, f"Consumed.{name} must not be negative, and is {getattr(self, name)}")


class Outcome(enum.Enum):
    """What became of a command. UNKNOWN is what its sender must assume where no answer came."""

    ACCEPTED = 1
    REFUSED = 2
    UNKNOWN = 3


@dataclass(frozen=True)
class CommandHeader:
    """Who asks, under which unique id, and until when it may be carried out."""

    id: str
    deadline_ns: int
    sender: str

    def __post_init__(self) -> None:
        check_message(self)
        require(self.id != "", "a command needs an id")


@dataclass(frozen=True)
class CommandAnswer:
    """The answer to a command: accepted, or refused with a code and a reason."""

    id: str
    outcome: Outcome
    code: str
    reason: str

    def __post_init__(self) -> None:
        check_message(self)
        require(
            (self.outcome is Outcome.ACCEPTED) == (self.code == ""),
            "a refusal needs a code, and an acceptance has none",
        )


@dataclass(frozen=True)
class CommandRecord:
    """A command as its receiver got it, with the answer, published so that a recording holds both."""

    topic: str
    encoding: str
    payload: bytes
    received_ns: int
    answer: CommandAnswer


@dataclass(frozen=True)
class InputHealth:
    """How one input fares: rates over the last second or so, counts since the start."""

    topic: str
    rate_hz: float
    age_ms: float | None
    received: UInt64
    dropped: UInt64
    missed: UInt64
    refused: UInt64

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class OutputHealth:
    """How one output fares."""

    topic: str
    rate_hz: float
    published: UInt64

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class AgentHealth:
    """An agent's own account of itself; `heartbeat` counts turns of its loop, so a hung loop shows.

    Fields:
        dropped (of an input): newer messages replaced them before they were looked at, which is how *latest* works.
        missed: sequence numbers that never arrived.
        refused: messages that could not be read.
        processor_share: of one core, over the last second or so; resident_bytes: memory of the process. None in
            recordings from before they were told.
    """

    agent: str
    instance: str
    host: str
    version: str
    config_hash: str
    at_ns: int
    uptime_s: float
    heartbeat: UInt64
    step_ms_p50: float | None
    step_ms_p99: float | None
    inputs: tuple[InputHealth, ...]
    outputs: tuple[OutputHealth, ...]
    fault: str
    processor_share: float | None = None
    resident_bytes: UInt64 | None = None

    def __post_init__(self) -> None:
        check_message(self)


class LogLevel(enum.Enum):
    """How grave a log record is."""

    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4


@dataclass(frozen=True)
class LogRecord:
    """A line of an agent's log."""

    at_ns: int
    agent: str
    instance: str
    level: LogLevel
    text: str


@dataclass(frozen=True)
class ClockReading:
    """What the clock of an agent's host says at the moment of the answer."""

    host: str
    at_ns: int

    def __post_init__(self) -> None:
        check_message(self)
        require(self.host != "", "a clock's reading names its host")


@dataclass(frozen=True)
class ReplayClock:
    """The time that agents must take for now while a recording is replayed."""

    now_ns: int
    rate: float

    def __post_init__(self) -> None:
        check_message(self)
        require(self.rate >= 0, f"ReplayClock.rate must not be negative, and is {self.rate}")


@dataclass(frozen=True)
class Progress:
    """How far a consumer has got, told to whoever asks: a fast replay waits for it.

    Fields:
        listens: the key expressions that it listens to, with spaces between.
        handled: the newest message of each key that nothing more will follow from.
        published: its own newest messages, those that followed included; none of what it says unasked.
    """

    listens: str
    handled: tuple[Consumed, ...]
    published: tuple[Consumed, ...]

    def __post_init__(self) -> None:
        check_message(self)
