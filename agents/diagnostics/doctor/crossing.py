"""What crosses the link of each host of a rig, in bytes a second: who says what, how often, and who hears it where.

All that is said goes to the router and from there to each who hears it, also where both are on one host: so the link of
a host bears each stream that its agents say once, and each that they hear once for every one of them; the link of the
router's host bears what those of all others do, and nothing of what is said and heard on it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from agents.configuration.hosts import kind_and_instance
from agents.configuration.rig import RigConfig
from agents.registry import CAMERA, NEEDLE, RECORDER, ROBOT_BRIDGE, kind_of
from schemas.topics import NEEDLE_SEEN, TOOL, TOPICS, Topic

STREAMS = tuple(topic for topic in TOPICS if topic.typical_bytes)
"""What comes steadily and weighs something."""


@dataclass(frozen=True)
class Traffic:
    """What one host's link has to bear, in bytes a second by topic."""

    out: dict[str, float] = field(default_factory=dict[str, float])
    into: dict[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True)
class Crossing:
    """A stream that one process says, or hears, across its host's link.

    Fields:
        process: as `kind/instance`; what a stream is heard by, or said by.
    """

    host: str
    process: str
    topic: Topic
    is_said: bool
    bytes_per_s: float


def traffic(rig: RigConfig, bytes_of: Mapping[str, float]) -> dict[str, Traffic]:
    """What crosses the link of each host, given how large messages are, by topic."""
    found = {host: Traffic() for host in rig.hosts}
    for one in crossings(rig, bytes_of):
        at, router = found[one.host], found[rig.router.host or ""]
        for sums in (at.out, router.into) if one.is_said else (at.into, router.out):
            sums[str(one.topic)] = sums.get(str(one.topic), 0.0) + one.bytes_per_s
    return found


def crossings(rig: RigConfig, bytes_of: Mapping[str, float]) -> Iterator[Crossing]:
    """Each stream of each process whose host is not the router's."""
    heard = {str(topic) for kind, instance, _ in _processes(rig) for topic in heard_by(rig, kind, instance)}
    for kind, instance, host in _processes(rig):
        if host == rig.router.host:
            continue
        for topic in _said_on(rig):
            each = rate_of(rig, topic) * bytes_of.get(str(topic), topic.typical_bytes)
            if topic.agent == kind and str(topic) in heard:
                yield Crossing(host, f"{kind}/{instance}", topic, True, each)
            if topic in heard_by(rig, kind, instance):
                of_each = _instances(rig, kind, topic)
                yield Crossing(host, f"{kind}/{instance}", topic, False, of_each * each)


def heard_by(rig: RigConfig, kind: str, instance: str) -> tuple[Topic, ...]:
    """The streams that a process hears."""
    row = kind_of(kind)
    if row is RECORDER:
        otherwise = {str(row): row.recorded for row in rig.rows_otherwise}
        return tuple(topic for topic in _said_on(rig) if otherwise.get(str(topic), topic.recorded))
    if row is CAMERA and (rig.camera is None or rig.camera.source != "scene"):
        return ()
    unasked = {TOOL} if row is ROBOT_BRIDGE and rig.robot[instance].correction != "tool_tracker" else set[Topic]()
    return tuple(topic for topic in row.hears if topic in STREAMS and topic not in unasked) if row is not None else ()


def _said_on(rig: RigConfig) -> tuple[Topic, ...]:
    """Perception looks for lines of a needle where the rig has an agent for them."""
    return tuple(topic for topic in STREAMS if topic is not NEEDLE_SEEN or rig.section_of(NEEDLE) is not None)


def rate_of(rig: RigConfig, topic: Topic) -> float:
    """How often a stream comes, in Hz: what follows from frames as often as the camera films."""
    if topic.every_frame and rig.camera is not None:
        return rig.camera.rate_hz
    return topic.rate_hz or 0.0


def _instances(rig: RigConfig, kind: str, topic: Topic) -> int:
    """Of how many arms a process hears such a stream."""
    row = kind_of(kind)
    if not topic.per_arm or (row is not None and row.per_arm):
        return 1
    said_by = kind_of(topic.agent)
    return len(rig.arms_of(said_by) if said_by is not None else rig.robot)


def _processes(rig: RigConfig) -> Iterator[tuple[str, str, str]]:
    for host, section in rig.hosts.items():
        for name in section.runs:
            yield *kind_and_instance(name, host), host
