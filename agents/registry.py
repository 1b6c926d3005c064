"""Every kind of agent, a row each, from which follows what others must know of it without loading it.

Launching, units and containers, `doctor`, `status` and `graph` read it. What an agent says is in the table of topics
(`schemas/topics.py`), under its name; what it is made of, `agents/cli/rig/builders.py` knows.
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
    """One kind of agent.

    Fields:
        name: in keys, configurations and commands.
        does: in a few words.
        hears: what it may hear; some of that depends on its configuration.
        pace: see `Pace`.
        per_arm: whether each arm has one of its own, whose instance is the arm.
    """

    name: str
    does: str
    hears: tuple[Topic, ...]
    pace: Pace
    per_arm: bool = False

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


CAMERA = Kind("camera", "films the field", (SIMULATOR_STATE, ROBOT_STATE), Pace.KEEPS_TIME)
PERCEPTION = Kind("perception", "finds thread in both images", (FRAMES, CALIBRATION, THREAD), Pace.STEPS_BACK)
TOOL_TRACKER = Kind(
    "perception",
    "finds an arm's tool in both images",
    (FRAMES, CALIBRATION, ROBOT_STATE),
    Pace.STEPS_BACK,
    per_arm=True,
)
RECONSTRUCTION = Kind("reconstruction", "makes a curve in space of it", (OBSERVATIONS,), Pace.STEPS_BACK)
PLANNER = Kind(
    "planner",
    "plans grasps, and tells whether they hold",
    (THREAD, SURFACE, ROBOT_STATE, CLOCKS, EXECUTION),
    Pace.WAITS,
)
ROBOT_BRIDGE = Kind(
    "robot_bridge",
    "checks plans, and moves an arm",
    (PLAN, HEARTBEAT, SURFACE, FRAME_NOTICE, TOOL),
    Pace.KEEPS_TIME,
    per_arm=True,
)
SIMULATOR = Kind("simulator", "plays field and thread", (PLAN, ROBOT_STATE, EXECUTION), Pace.KEEPS_TIME)

AGENTS = (CAMERA, PERCEPTION, TOOL_TRACKER, RECONSTRUCTION, PLANNER, ROBOT_BRIDGE, SIMULATOR)
"""In the order of the dataflow."""
NAMES = tuple(dict.fromkeys(kind.name for kind in AGENTS))


def kind_of(name: str, instance: str = MAIN) -> Kind | None:
    """The row of an agent; None for what is no agent."""
    rows = [kind for kind in AGENTS if kind.name == name]
    of_arm = [kind for kind in rows if kind.per_arm]
    return next(iter(rows if instance == MAIN else of_arm or rows), None)


def with_pace(pace: Pace) -> frozenset[str]:
    """The names of the agents that stand to time like that."""
    return frozenset(kind.name for kind in AGENTS if kind.pace is pace)
