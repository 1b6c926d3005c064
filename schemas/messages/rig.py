"""What agents tell of where and how they run, across the hosts of a rig: settings, facts, clocks."""

from dataclasses import dataclass

from schemas.checks import UInt32, UInt64, check_message, require
from schemas.messages.running import CommandHeader


@dataclass(frozen=True)
class SettableParameter:
    """A parameter that may be set while its agent runs.

    Fields:
        allowed: what it may be set to, in plain text.
        is_set: whether it was set since the agent started, and differs from its configuration.
    """

    name: str
    allowed: str
    is_set: bool

    def __post_init__(self) -> None:
        check_message(self)
        require(self.name != "", "a settable parameter needs a name")


@dataclass(frozen=True)
class AgentConfiguration:
    """The parameters that an agent runs with, told when it starts and whenever one of them changes.

    Fields:
        parameters: an object of JSON, by name.
        config_hash: a short name that changes with any of them, and with the rest of the rig's configuration.
    """

    agent: str
    instance: str
    at_ns: int
    parameters: str
    settable: tuple[SettableParameter, ...]
    config_hash: str

    def __post_init__(self) -> None:
        check_message(self)
        require(self.agent != "", "a configuration names its agent")


@dataclass(frozen=True)
class SetParameter:
    """Set one parameter of a running agent; `value` is JSON."""

    header: CommandHeader
    name: str
    value: str

    def __post_init__(self) -> None:
        check_message(self)
        require(self.name != "", "a parameter is set by its name, which is empty")


@dataclass(frozen=True)
class TopicOverride:
    """What a rig's file says of a topic otherwise than the table of topics; the value as the file writes it."""

    topic: str
    setting: str
    value: str

    def __post_init__(self) -> None:
        check_message(self)
        require(self.topic != "" and self.setting != "", "an override names its topic and what it sets")


@dataclass(frozen=True)
class RigSection:
    """A section of a rig's file by a digest of what it says, so that those of several hosts can be compared."""

    name: str
    digest: str

    def __post_init__(self) -> None:
        check_message(self)
        require(self.name != "" and self.digest != "", "a section of a rig's file has a name and a digest")


@dataclass(frozen=True)
class AgentFacts:
    """Where an agent runs and what it was granted there, told to whoever asks.

    Fields:
        schemas_hash: of the messages that it knows; those of one rig should be equal.
        shared_memory, shared_memory_reason: whether frames travel in shared memory, and why or why not.
        realtime_asked, realtime_granted, realtime_reason: the real-time priority that it asked for and has (None
            where it has none), and why not.
        writes_to, disk_free_bytes: the folder that it writes to, and the room there; empty and None where it writes
            nothing.
        calibrated_ns: when the calibration that it uses was made, None where nobody knows.
        certificate_expires_ns: None where it runs without one.
        processor_s, resident_bytes: what the process has used of processors since it began, and of memory now.
        overrides: what it does otherwise with topics than their table says, as its rig's file told it.
        rig_sections: of the rig's file that it began with, but for what each host has of its own, and topics; empty
            where it does not tell.
    """

    agent: str
    instance: str
    host: str
    at_ns: int
    version: str
    schemas_hash: str
    config_hash: str
    python: str
    zenoh: str
    shared_memory: bool
    shared_memory_reason: str
    realtime_asked: UInt32 | None
    realtime_granted: UInt32 | None
    realtime_reason: str
    writes_to: str
    disk_free_bytes: UInt64 | None
    calibrated_ns: int | None
    certificate_expires_ns: int | None
    processor_s: float
    resident_bytes: UInt64
    overrides: tuple[TopicOverride, ...] = ()
    rig_sections: tuple[RigSection, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)
        require(self.agent != "" and self.host != "", "facts name their agent and its host")


@dataclass(frozen=True)
class HostClock:
    """How far the clock of an agent's host is ahead of that of whoever asked (negative: behind).

    Fields:
        within_ms: how much that may be wrong; both are None where the agent gave no answer.
    """

    agent: str
    instance: str
    host: str
    ahead_ms: float | None
    within_ms: float | None

    def __post_init__(self) -> None:
        check_message(self)
        require((self.ahead_ms is None) == (self.within_ms is None), "an offset and its uncertainty come together")
        require(self.within_ms is None or self.within_ms >= 0, "the uncertainty of a clock must not be negative")


@dataclass(frozen=True)
class HostClocks:
    """The clocks of the hosts of other agents by the clock of one, each as far as it could be told."""

    at_ns: int
    clocks: tuple[HostClock, ...]

    def __post_init__(self) -> None:
        check_message(self)
