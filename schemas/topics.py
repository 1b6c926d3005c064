"""The topic table: every key that is published, by whom, as what, how it is delivered, and whether it is recorded.

Publishers, subscribers, the recorder, health, access rules and documentation are all derived from it. A key is

    suturegrasp/{rig}/{agent}/{instance}/{topic}

with the instance `main`; the arm's name for whatever there is once per arm; the host's for operator, recorder, viewer.
"""

import enum
from dataclasses import dataclass

from schemas.messages import (
    AgentConfiguration,
    AgentHealth,
    Arm,
    ChangeState,
    CommandRecord,
    ExecutionEvent,
    FrameNotice,
    GraspCheck,
    GraspGoal,
    GraspJudgement,
    GraspPlan,
    Heartbeat,
    Hold,
    HostClocks,
    LogRecord,
    NeedleObservations,
    NeedlePose,
    Prompt,
    PullGoal,
    ReplayClock,
    RobotState,
    SetParameter,
    SimulatorState,
    StereoCalibration,
    StereoFrame,
    Tail,
    ThreadObservations,
    ThreadReconstruction,
    TissueSurface,
    ToolCorrection,
)

ROOT = "suturegrasp"
MAIN = "main"
ANY_AGENT = "*"


class Delivery(enum.Enum):
    """How a topic travels.

    LATEST: drop rather than wait; the consumer gets the newest, and gaps are counted. STATE: the last value reaches
    late joiners. EVENT: lossless and ordered across a router's restart; a miss is a fault that is reported. COMMAND: a
    query with an id, a deadline and an answer, carried out at most once.
    """

    LATEST = 1
    STATE = 2
    EVENT = 3
    COMMAND = 4


class Priority(enum.Enum):
    """Which of a process's messages go first where its link is full; names and order are Zenoh's."""

    REAL_TIME = "real_time"
    DATA_HIGH = "data_high"
    DATA = "data"
    DATA_LOW = "data_low"
    BACKGROUND = "background"


EVENTS_KEPT = 1000
"""About a router's restart at the highest rate of events."""


@dataclass(frozen=True)
class Topic:
    """One row of the table.

    Fields:
        name: without the agent, so that `planner/plan` has agent `planner` and name `plan`.
        agent: whose key it lies under; ANY_AGENT where every agent has one of its own.
        receiver: for a command, the agent that answers it, ANY_AGENT where each answers under its own key; otherwise
            empty.
        rate_hz: as expected; None where it comes by hand or on change.
        resting_hz: as expected while nothing moves of what it tells; None where it makes no difference.
        maximum_age_ms: beyond which consumers treat it as stale; None where age means nothing.
        per_arm: whether there is one per arm, so that the instance is the arm.
        good_when_late: for a command, whether it is carried out even after its deadline, as stopping must be.
        priority: of *latest* messages; states and events go with DATA.
        kept: events that each publisher keeps for those who were away.
        made_from: the topic whose message it is made of, so that both descend from one frame; None where there is none.
        every_frame: whether it comes with each frame, and so as often as the camera films.
        steady: whether it comes at its rate for as long as its agent runs; else while there is something to say.
        never_later: whether an arm that moves is held or watched by it, so that no rig may have it wait.
    """

    agent: str
    name: str
    message: type
    delivery: Delivery
    rate_hz: float | None = None
    resting_hz: float | None = None
    maximum_age_ms: float | None = None
    recorded: bool = True
    receiver: str = ""
    per_arm: bool = False
    good_when_late: bool = False
    priority: Priority = Priority.REAL_TIME
    kept: int = EVENTS_KEPT
    never_later: bool = False
    made_from: "Topic | None" = None
    every_frame: bool = False
    steady: bool = True

    def __str__(self) -> str:
        return f"{self.agent}/{self.name}"


FRAMES = Topic(
    "camera",
    "frames",
    StereoFrame,
    Delivery.LATEST,
    rate_hz=30,
    maximum_age_ms=200,
    # bulky: whatever else the camera tells goes first
    priority=Priority.DATA_LOW,
    every_frame=True,
)
FRAME_NOTICE = Topic(
    "camera",
    "notice",
    FrameNotice,
    Delivery.LATEST,
    rate_hz=30,
    maximum_age_ms=200,
    never_later=True,
    every_frame=True,
)
CALIBRATION = Topic("camera", "calibration", StereoCalibration, Delivery.STATE)
OBSERVATIONS = Topic(
    "perception",
    "observations",
    ThreadObservations,
    Delivery.LATEST,
    rate_hz=30,
    maximum_age_ms=1000,
    made_from=FRAMES,
    every_frame=True,
)
SURFACE = Topic(
    "perception",
    "surface",
    TissueSurface,
    Delivery.LATEST,
    rate_hz=3,
    maximum_age_ms=3000,
    made_from=FRAMES,
    steady=False,
)
NEEDLE_SEEN = Topic(
    "perception",
    "needle_lines",
    NeedleObservations,
    Delivery.LATEST,
    rate_hz=2,
    maximum_age_ms=3000,
    made_from=FRAMES,
    steady=False,
)
TOOL = Topic(
    "tool_tracker",
    "correction",
    ToolCorrection,
    Delivery.LATEST,
    rate_hz=5,
    maximum_age_ms=1000,
    per_arm=True,
    made_from=FRAMES,
    steady=False,
)
THREAD = Topic(
    "reconstruction",
    "thread",
    ThreadReconstruction,
    Delivery.LATEST,
    rate_hz=30,
    maximum_age_ms=1000,
    made_from=OBSERVATIONS,
    every_frame=True,
)
NEEDLE = Topic(
    "needle",
    "pose",
    NeedlePose,
    Delivery.LATEST,
    rate_hz=2,
    maximum_age_ms=3000,
    made_from=NEEDLE_SEEN,
    steady=False,
)
GOAL = Topic("operator", "goal", GraspGoal, Delivery.COMMAND, receiver="planner")
PULL_GOAL = Topic("operator", "pull", PullGoal, Delivery.COMMAND, receiver="planner")
ARM = Topic("operator", "arm", Arm, Delivery.COMMAND, receiver="robot_bridge", per_arm=True)
HOLD = Topic("operator", "hold", Hold, Delivery.COMMAND, receiver="robot_bridge", per_arm=True, good_when_late=True)
CHANGE_STATE = Topic("operator", "state", ChangeState, Delivery.COMMAND, receiver="robot_bridge", per_arm=True)
PROMPT = Topic("operator", "prompt", Prompt, Delivery.COMMAND, receiver="perception")
HEARTBEAT = Topic(
    "operator",
    "heartbeat",
    Heartbeat,
    Delivery.LATEST,
    rate_hz=20,
    maximum_age_ms=200,
    per_arm=True,
    never_later=True,
    steady=False,
)
PLAN = Topic("planner", "plan", GraspPlan, Delivery.EVENT, made_from=THREAD)
CHECK = Topic("planner", "check", GraspCheck, Delivery.EVENT)
TAIL = Topic(
    "planner",
    "tail",
    Tail,
    Delivery.LATEST,
    rate_hz=30,
    maximum_age_ms=1000,
    never_later=True,
    made_from=THREAD,
    steady=False,
)
CLOCKS = Topic("planner", "clocks", HostClocks, Delivery.STATE)
ROBOT_STATE = Topic(
    "robot_bridge",
    "state",
    RobotState,
    Delivery.LATEST,
    rate_hz=100,
    resting_hz=5,
    maximum_age_ms=100,
    per_arm=True,
    never_later=True,
)
EXECUTION = Topic("robot_bridge", "execution", ExecutionEvent, Delivery.EVENT, per_arm=True)
SIMULATOR_STATE = Topic("simulator", "state", SimulatorState, Delivery.LATEST, rate_hz=60, resting_hz=5)
JUDGEMENT = Topic("simulator", "judgement", GraspJudgement, Delivery.EVENT)
REPLAY_CLOCK = Topic("replay", "clock", ReplayClock, Delivery.LATEST, recorded=False)
COMMANDS = Topic(ANY_AGENT, "command", CommandRecord, Delivery.EVENT)
HEALTH = Topic(ANY_AGENT, "health", AgentHealth, Delivery.LATEST, rate_hz=1, maximum_age_ms=3000, steady=False)
LOG = Topic(ANY_AGENT, "log", LogRecord, Delivery.EVENT)
CONFIGURATION = Topic(ANY_AGENT, "configuration", AgentConfiguration, Delivery.STATE)
SET = Topic(ANY_AGENT, "set", SetParameter, Delivery.COMMAND, receiver=ANY_AGENT)

TOPICS = (
    FRAMES,
    FRAME_NOTICE,
    CALIBRATION,
    OBSERVATIONS,
    SURFACE,
    NEEDLE_SEEN,
    TOOL,
    THREAD,
    NEEDLE,
    GOAL,
    PULL_GOAL,
    ARM,
    HOLD,
    CHANGE_STATE,
    PROMPT,
    HEARTBEAT,
    PLAN,
    CHECK,
    TAIL,
    CLOCKS,
    ROBOT_STATE,
    EXECUTION,
    SIMULATOR_STATE,
    JUDGEMENT,
    REPLAY_CLOCK,
    COMMANDS,
    HEALTH,
    LOG,
    CONFIGURATION,
    SET,
)


def key(rig: str, topic: Topic, instance: str = MAIN, agent: str = "") -> str:
    """The key of a topic; `agent` says whose, where every agent has one of its own."""
    return f"{key_root(rig, instance, agent or topic.agent)}/{topic.name}"


def key_root(rig: str, instance: str, agent: str) -> str:
    """What all keys of one agent begin with."""
    return f"{ROOT}/{rig}/{agent}/{instance}"


def topic_of(key_expression: str) -> Topic:
    """The row of the table that a concrete key belongs to.

    Raises:
        KeyError: where the table has none; the text names the key.
    """
    parts = key_expression.split("/")
    if len(parts) == 5 and parts[0] == ROOT:
        _, _, agent, _, name = parts
        for topic in TOPICS:
            if topic.name == name and topic.agent in (agent, ANY_AGENT):
                return topic
    raise KeyError(f"no topic of the table has the key {key_expression!r}")


def known_topic(key_expression: str) -> Topic | None:
    """The same; None where the table has none, since another version may have others."""
    try:
        return topic_of(key_expression)
    except KeyError:
        return None


def is_known(key_expression: str) -> bool:
    """Whether the table has a row for a concrete key."""
    return known_topic(key_expression) is not None
