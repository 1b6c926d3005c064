"""Every kind of process of a rig, a row each, from which follows what others must know of it without loading it.

Configuration, launching, units and containers, `doctor`, `status` and `graph` read it. What an agent says is in the
table of topics (`schemas/topics.py`), under its name; what it is made of, `agents/cli/rig/builders.py` knows.
"""

from dataclasses import dataclass
from enum import Enum

from schemas.topics import (
    CALIBRATION,
    CLOCKS,
    EXECUTION,
    FRAME_NOTICE,
    FRAMES,
    HEARTBEAT,
    MAIN,
    OBSERVATIONS,
    PLAN,
    ROBOT_STATE,
    SIMULATOR_STATE,
    SURFACE,
    THREAD,
    TOOL,
    TOPICS,
    Delivery,
    Topic,
)


class Pace(Enum):
    """How an agent stands to time, where processors are busy."""

    KEEPS_TIME = "others wait for it: it may ask for real-time priority"
    STEPS_BACK = "takes all that it gets, and leaves out images for newer ones: it steps back behind all others"
    WAITS = "waits most of the time"


@dataclass(frozen=True)
class Kind:
    """One kind of process of a rig.

    Fields:
        name: in keys, configurations and certificates.
        section: of a rig's configuration, which it is made from.
        does: in a few words.
        hears: what it may hear; some of that depends on its configuration.
        pace: see `Pace`.
        per_arm: whether each arm has one of its own, whose instance is the arm.
        writes: the file of a session that it writes, where it is there for that.
        audited: whether it writes down what it is told, in an audit log.
        films: whether it opens devices of video.
        options: of its command, beside `--arm`, where a unit or a container starts it.
    """

    name: str
    section: str
    does: str
    hears: tuple[Topic, ...]
    pace: Pace
    per_arm: bool = False
    writes: str = ""
    audited: bool = False
    films: bool = False
    options: str = ""

    @property
    def says(self) -> tuple[Topic, ...]:
        """What it publishes, in the order of the table of topics."""
        # perception's tracker of an arm's tool is a kind of its own under the same name
        mine = (topic for topic in TOPICS if topic.agent == self.name and topic.delivery is not Delivery.COMMAND)
        return tuple(topic for topic in mine if (topic is TOOL) == (self is TOOL_TRACKER))

    @property
    def answers(self) -> tuple[Topic, ...]:
        """The commands that it answers."""
        return tuple(topic for topic in TOPICS if topic.receiver == self.name and self is not TOOL_TRACKER)


CAMERA = Kind("camera", "camera", "films the field", (SIMULATOR_STATE, ROBOT_STATE), Pace.KEEPS_TIME, films=True)
PERCEPTION = Kind(
    "perception", "perception", "finds thread in both images", (FRAMES, CALIBRATION, THREAD), Pace.STEPS_BACK
)
TOOL_TRACKER = Kind(
    "perception",
    "perception",
    "finds an arm's tool in both images",
    (FRAMES, CALIBRATION, ROBOT_STATE),
    Pace.STEPS_BACK,
    per_arm=True,
)
RECONSTRUCTION = Kind(
    "reconstruction", "reconstruction", "makes a curve in space of it", (OBSERVATIONS,), Pace.STEPS_BACK
)
PLANNER = Kind(
    "planner",
    "planner",
    "plans grasps, and tells whether they hold",
    (THREAD, SURFACE, ROBOT_STATE, CLOCKS, EXECUTION),
    Pace.WAITS,
)
ROBOT_BRIDGE = Kind(
    "robot_bridge",
    "robot",
    "checks plans, and moves an arm",
    (PLAN, HEARTBEAT, SURFACE, FRAME_NOTICE, TOOL),
    Pace.KEEPS_TIME,
    per_arm=True,
    audited=True,
)
SIMULATOR = Kind("simulator", "simulator", "plays field and thread", (PLAN, ROBOT_STATE, EXECUTION), Pace.KEEPS_TIME)
AGENTS = (CAMERA, PERCEPTION, TOOL_TRACKER, RECONSTRUCTION, PLANNER, ROBOT_BRIDGE, SIMULATOR)
"""In the order of the dataflow."""
NAMES = tuple(dict.fromkeys(kind.name for kind in AGENTS))

GUARD = Kind(
    "guard",
    "robot",
    "stands by an arm, and holds it where its bridge falls silent",
    (),
    Pace.KEEPS_TIME,
    per_arm=True,
    audited=True,
)
RECORDER = Kind(
    "recorder",
    "recorder",
    "writes down what is said",
    tuple(topic for topic in TOPICS if topic.recorded),
    Pace.WAITS,
    writes="session.mcap",
    options="--numbered",
)
VIEWER = Kind(
    "viewer",
    "viewer",
    "shows what is said in Rerun",
    TOPICS,
    Pace.WAITS,
    writes="session.rrd",
    options="--numbered --show file",
)
PROCESSES = (*AGENTS, GUARD, RECORDER, VIEWER)
"""Agents, and what stands beside them; a rig's router and the commands of people are not of these kinds."""
_COMMANDS = {RECORDER: "record", VIEWER: "view"}
"""Named for what they do."""


def kind_of(name: str, instance: str = MAIN) -> Kind | None:
    """The row of a process; None for what is of no kind."""
    rows = [kind for kind in PROCESSES if kind.name == name]
    of_arm = [kind for kind in rows if kind.per_arm]
    return next(iter(rows if instance == MAIN else of_arm or rows), None)


def command_of(kind: Kind) -> str:
    """What starts a process of a kind, with places for its `{instance}` and its `{session}`, a file."""
    command = _COMMANDS.get(kind, kind.name.replace("_", "-"))
    arm = " --arm {instance}" if kind.per_arm else ""
    written = " --output {session}" if kind.writes else ""
    return f"{command}{arm}{written} {kind.options}".rstrip()


def with_pace(pace: Pace) -> frozenset[str]:
    """The names of the kinds that stand to time like that."""
    return frozenset(kind.name for kind in PROCESSES if kind.pace is pace)
