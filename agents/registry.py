"""Every kind of process of a rig, a row each, from which follows what others must know of it without loading it.

Configuration, launching, units and containers, `doctor`, `status` and `graph` read it. What an agent says is in the
table of topics (`schemas/topics.py`), under its name. docs/new_agent.md is how to add one.
"""

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from schemas.topics import Topic

MAIN, EVERYTHING = "main", "*"


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
        topics: that it may hear, as `agent/name`; some of that depends on its configuration.
        pace: see `Pace`.
        per_arm: whether each arm has one of its own, whose instance is the arm.
        writes: the file of a session that it writes, where it is there for that.
        audited: whether it writes down what it is told, in an audit log.
        films: whether it opens devices of video.
        agent: the class that it is made from, as `module:Class`, where its section's fields are those of its `config`;
            empty where more is needed, which `agents/launch/builders.py` knows.
        config: that config, likewise, of which its section is made: a dataclass in a module that loads at once. Empty
            where the section is one of `agents/configuration/sections.py`.
        options: of its command, beside `--arm`, where a unit or a container starts it.
    """

    name: str
    section: str
    does: str
    topics: tuple[str, ...]
    pace: Pace
    per_arm: bool = False
    writes: str = ""
    audited: bool = False
    films: bool = False
    agent: str = ""
    config: str = ""
    options: str = ""

    # the table of topics knows all messages, which takes longer to load than `--help` should
    @property
    def hears(self) -> "tuple[Topic, ...]":
        """What it may hear, in the order of the table of topics."""
        from schemas.topics import TOPICS

        return tuple(topic for topic in TOPICS if str(topic) in self.topics or EVERYTHING in self.topics)

    @property
    def says(self) -> "tuple[Topic, ...]":
        """What it publishes, in that order."""
        from schemas.topics import TOPICS, Delivery

        return tuple(t for t in TOPICS if t.agent == self.name and t.delivery is not Delivery.COMMAND)

    @property
    def answers(self) -> "tuple[Topic, ...]":
        """The commands that it answers."""
        from schemas.topics import TOPICS

        return tuple(topic for topic in TOPICS if topic.receiver == self.name)


CAMERA = Kind(
    "camera", "camera", "films the field", ("simulator/state", "robot_bridge/state"), Pace.KEEPS_TIME, films=True
)
PERCEPTION = Kind(
    "perception",
    "perception",
    "finds thread in both images",
    ("camera/frames", "camera/calibration", "reconstruction/thread"),
    Pace.STEPS_BACK,
)
TOOL_TRACKER = Kind(
    "tool_tracker",
    "tool_tracker",
    "finds an arm's tool in both images",
    ("camera/frames", "camera/calibration", "robot_bridge/state"),
    Pace.STEPS_BACK,
    per_arm=True,
    agent="agents.tool_tracker.agent:ToolTracker",
    config="agents.tool_tracker:ToolTrackerConfig",
)
RECONSTRUCTION = Kind(
    "reconstruction", "reconstruction", "makes a curve in space of it", ("perception/observations",), Pace.STEPS_BACK
)
NEEDLE = Kind(
    "needle",
    "needle",
    "finds how the needle lies in space",
    ("perception/needle_lines",),
    Pace.STEPS_BACK,
    agent="agents.needle.agent:Needle",
    config="agents.needle:NeedleConfig",
)
PLANNER = Kind(
    "planner",
    "planner",
    "plans grasps and pulls, and tells what came of them",
    (
        *("reconstruction/thread", "perception/surface", "needle/pose"),
        *("robot_bridge/state", "planner/clocks", "robot_bridge/execution"),
    ),
    Pace.WAITS,
)
ROBOT_BRIDGE = Kind(
    "robot_bridge",
    "robot",
    "checks plans, and moves an arm",
    (
        *("planner/plan", "operator/heartbeat", "perception/surface"),
        *("camera/notice", "tool_tracker/correction", "planner/tail"),
    ),
    Pace.KEEPS_TIME,
    per_arm=True,
    audited=True,
)
SIMULATOR = Kind(
    "simulator",
    "simulator",
    "plays field and thread",
    ("planner/plan", "robot_bridge/state", "robot_bridge/execution"),
    Pace.KEEPS_TIME,
    agent="agents.simulator.agent:Simulator",
)
AGENTS = (CAMERA, PERCEPTION, TOOL_TRACKER, RECONSTRUCTION, NEEDLE, PLANNER, ROBOT_BRIDGE, SIMULATOR)
"""In the order of the dataflow."""
NAMES = tuple(kind.name for kind in AGENTS)

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
    (EVERYTHING,),
    Pace.WAITS,
    writes="session.mcap",
    options="--numbered",
)
VIEWER = Kind(
    "viewer",
    "viewer",
    "shows what is said in Rerun",
    (EVERYTHING,),
    Pace.WAITS,
    writes="session.rrd",
    options="--numbered --show file",
)
PROCESSES = (*AGENTS, GUARD, RECORDER, VIEWER)
"""Agents, and what stands beside them; a rig's router and the commands of people are not of these kinds."""
_COMMANDS = {RECORDER: "record", VIEWER: "view"}
"""Named for what they do."""


def kind_of(name: str) -> Kind | None:
    """The row of a process; None for what is of no kind."""
    return next((kind for kind in PROCESSES if kind.name == name), None)


def command_of(kind: Kind) -> str:
    """What starts a process of a kind, with places for its `{instance}` and its `{session}`, a file."""
    own = kind.name.replace("_", "-")
    command = f"run {own}" if kind in AGENTS else _COMMANDS.get(kind, own)
    arm = " --arm {instance}" if kind.per_arm else ""
    written = " --output {session}" if kind.writes else ""
    return f"{command}{arm}{written} {kind.options}".rstrip()


def with_pace(pace: Pace) -> frozenset[str]:
    """The names of the kinds that stand to time like that."""
    return frozenset(kind.name for kind in PROCESSES if kind.pace is pace)
