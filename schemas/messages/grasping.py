"""What is to be grasped, how, and what the robot did. SI units; angles in radians."""

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float64

from schemas.checks import Number, UInt32, UInt64, check_message, require
from schemas.messages.imaging import FrameStamp
from schemas.messages.pulling import Pull, PullBounds
from schemas.messages.running import CommandHeader, Consumed
from schemas.messages.thread import Status

POSE_TOLERANCE = 1e-6
"""Poses are computed, not typed in, so their rotations are orthonormal to rounding."""


class Policy(enum.Enum):
    """How a grasp is made: at the goal itself, or captured where the thread is known best and slid to the goal."""

    DIRECT = 1
    CAPTURE_SLIDE_GRASP = 2


@dataclass(frozen=True)
class GraspGoal:
    """Where to grasp: exactly one of s along the thread, a rectified left-image pixel, a point in the camera frame, or
    so much thread from the needle.

    Fields:
        attempts: how often the planner may plan for it, the first plan included; None for what it is set to.
        from_swage_m: how much thread lies between the needle's swage and the goal.
    """

    header: CommandHeader
    arm: str
    policy: Policy
    s: float | None
    pixel: Float64[np.ndarray, "2"] | None
    point_camera: Float64[np.ndarray, "3"] | None
    attempts: UInt32 | None = None
    from_swage_m: float | None = None

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)
        given = sum(value is not None for value in (self.s, self.pixel, self.point_camera, self.from_swage_m))
        require(given == 1, f"a goal names one of s, pixel, point and length from the swage, not {given} of them")
        require(self.from_swage_m is None or self.from_swage_m >= 0, "a length of thread is not negative")
        require(self.s is None or 0 <= self.s <= 1, f"a goal's s must lie within 0 and 1, and is {self.s}")
        require(self.attempts is None or self.attempts >= 1, "a goal has at least one attempt")


@dataclass(frozen=True)
class Arm:
    """The operator's consent that one arm carries out one plan, while the heartbeat lasts.

    Fields:
        challenge_ns: the newest challenge of the arm's bridge that its sender had heard; 0 from those who echo none.
        pressed: a person presses the page's button; False from a process that beats by itself.
        segments: into how many segments a long motion may be cut, each planned anew; 0 for one motion.
        pull: within which bounds thread may be pulled, for a plan that pulls; None for all others.
    """

    header: CommandHeader
    arm: str
    plan_id: str
    challenge_ns: int = 0
    pressed: bool = False
    segments: UInt32 = 0
    pull: PullBounds | None = None

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)
        require(self.plan_id != "", "arming names a plan")


@dataclass(frozen=True)
class Hold:
    """Stop where you are, disarmed."""

    header: CommandHeader
    arm: str

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)


class StateWord(enum.Enum):
    """What a person has a real arm's console do with its state (CRTK's state_command)."""

    ENABLE = 1
    DISABLE = 2
    PAUSE = 3
    RESUME = 4
    HOME = 5


@dataclass(frozen=True)
class ChangeState:
    """Have the console of an arm that is disarmed change its state; homing moves the arm.

    Fields:
        challenge_ns, pressed: as of Arm: who has a real arm enabled, homed or resumed must stand by.
    """

    header: CommandHeader
    arm: str
    word: StateWord
    challenge_ns: int = 0
    pressed: bool = False

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)


@dataclass(frozen=True)
class Prompt:
    """Which thread is meant: the one at a pixel (u, v) of the rectified left image; None for any again."""

    header: CommandHeader
    pixel: Float64[np.ndarray, "2"] | None

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class Heartbeat:
    """The operator is there and wants the armed plan to go on.

    Fields:
        arming_id: the id of the Arm command, so that a heartbeat of one arming is none of another.
        challenge_ns: the challenge of the arm's bridge that it answers; 0 from those who answer none.
        guard_challenge: that of the guard beside the console, which came with it; 0 where there is no guard.
        pressed: a person presses the page's button; False from a process that beats by itself.
    """

    arm: str
    plan_id: str
    at_ns: int
    arming_id: str
    challenge_ns: int = 0
    guard_challenge: UInt64 = 0
    pressed: bool = False

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)
        require(self.arming_id != "", "a heartbeat names its arming")


class Phase(enum.Enum):
    """The parts of a grasp, in their order; a pull has PULL and RELEASE, with jaws that open and go back, after it."""

    APPROACH = 1
    CAPTURE = 2
    SLIDE = 3
    GRASP = 4
    RETREAT = 5
    PULL = 6
    RELEASE = 7


@dataclass(frozen=True)
class Waypoint:
    """Where the tool is to be, with which jaw angle, and in which part of the grasp; s where it is on the thread."""

    T_camera_tool: Float64[np.ndarray, "4 4"]
    jaw_rad: float
    phase: Phase
    s: float | None

    def __post_init__(self) -> None:
        check_message(self)
        check_pose("Waypoint.T_camera_tool", self.T_camera_tool)


@dataclass(frozen=True)
class Alternative:
    """A capture point that was considered, and what spoke against it."""

    s_capture: float
    probability: float
    reason: str

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class TissueClearance:
    """How the jaws of a plan, or of the best that was rejected, stand to the tissue that perception saw.

    Fields:
        stamp: of the frame whose surface was looked at; None where there was none to look at.
        unchecked: why not all of the way was checked against tissue; empty where all of it was.
        known_share: of the places that the jaws pass, those with known tissue before or behind them.
        clearance_m: the least of a jaw before the tissue, along the viewing ray; negative where it presses in, None
            where nothing was checked.
        deviation_m: its standard deviation.
        place_camera: the place of the jaw that it is of, with the phase, and the s that the jaws are at.
    """

    stamp: FrameStamp | None
    unchecked: str
    known_share: float
    clearance_m: float | None = None
    deviation_m: float | None = None
    place_camera: Float64[np.ndarray, "3"] | None = None
    phase: Phase | None = None
    s: float | None = None

    def __post_init__(self) -> None:
        check_message(self)
        require(0 <= self.known_share <= 1, f"known_share must lie within 0 and 1, and is {self.known_share}")
        require(self.deviation_m is None or self.deviation_m >= 0, "deviation_m must not be negative")
        told = [v is None for v in (self.clearance_m, self.deviation_m, self.place_camera, self.phase, self.s)]
        require(all(told) or not any(told), "a clearance comes with its deviation, place, phase and s")
        require(all(told) == (self.known_share == 0), "a clearance is told where anything is known, else none")
        require(not all(told) or self.unchecked != "", "where nothing was checked there is a reason")

    @property
    def sentence(self) -> str:
        """The least clearance with its deviation, place and phase, and what was not checked."""
        if self.clearance_m is None or self.deviation_m is None or self.phase is None or self.s is None:
            return self.unchecked
        off, sure = 1e3 * self.clearance_m, 1e3 * self.deviation_m
        where = f"in {self.phase.name.lower()} at {self.s:.0%}"
        near = f"jaws {abs(off):.1f} ± {sure:.1f} mm {'before' if off >= 0 else 'into'} the tissue, {where}"
        return f"{near}; {self.unchecked}" if self.unchecked else near


@dataclass(frozen=True)
class ThreadClearance:
    """How the instrument of a plan stands to the thread outside of the grasp, before, during and after it.

    Fields:
        obstructed: where the instrument cannot keep clear of it, and what that may do; empty where it does.
        clearance_m: the least between the surfaces of both on the way; negative where they overlap, None where no
            thread lies outside of the grasp.
        place_camera: the place on the thread that is nearest, with the phase, and its share s of the thread's length.
    """

    obstructed: str
    clearance_m: float | None = None
    place_camera: Float64[np.ndarray, "3"] | None = None
    phase: Phase | None = None
    s: float | None = None

    def __post_init__(self) -> None:
        check_message(self)
        told = [value is None for value in (self.clearance_m, self.place_camera, self.phase, self.s)]
        require(all(told) or not any(told), "a clearance comes with its place, phase and s")


@dataclass(frozen=True)
class ThreadAround:
    """The thread about the goal as it was planned on, in metres, so that it can be told whether it moved afterwards.

    Fields:
        s: shares of the thread's length, increasing; points_camera and covariance are of the points there.
    """

    s: Float64[np.ndarray, "n"]
    points_camera: Float64[np.ndarray, "n 3"]
    covariance: Float64[np.ndarray, "n 3 3"]

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class GraspPlan:
    """A grasp as tool poses in the camera frame, or why there is none (status FAILED with a reason).

    `stamp` is that of the frame whose thread the plan was made from; `tissue` is None where a rejection came before
    tissue was looked at, and from planners that never look at it, and so is `thread`.

    Fields:
        attempt: the how many-th for its goal, of at most `attempts`; 0 from planners that do not count them.
        policy_model: what the probability comes from, `paper` or `geometric`; empty from planners that do not tell.
        goal: that it answers; around: the thread near that. None from planners that do not tell.
        depth_m: how far the tips of the closed fingers reach beyond the thread; None for a rejection.
        offset_camera, offset_covariance: what earlier misses told of where the fingers are, against where they are
            measured to be; None for a first attempt.
        maximum_frame_age_s: its motion holds where the newest camera frame is older; 0 where the bridge does not tell.
        continues: the plan whose next segment this one is; empty for one that begins a motion.
        pull: what it is a segment of, where it pulls thread or lets go of it; None for a grasp.
    """

    plan_id: str
    arm: str
    goal_id: str
    stamp: FrameStamp
    status: Status
    reason: str
    policy: Policy
    s_goal: float | None
    s_capture: float | None
    probability: float
    slide_m: float
    waypoints: tuple[Waypoint, ...]
    alternatives: tuple[Alternative, ...]
    tissue: TissueClearance | None = None
    consumed: Annotated[tuple[Consumed, ...], Number(14)] = ()
    thread: ThreadClearance | None = None
    attempt: UInt32 = 0
    attempts: UInt32 = 0
    policy_model: str = ""
    goal: GraspGoal | None = None
    around: ThreadAround | None = None
    depth_m: float | None = None
    offset_camera: Float64[np.ndarray, "3"] | None = None
    offset_covariance: Float64[np.ndarray, "3 3"] | None = None
    maximum_frame_age_s: float = 0.0
    continues: str = ""
    pull: Pull | None = None

    @property
    def in_words(self) -> str:
        """What it is to do, in a few words; why there is none stands in its reason."""
        if self.reason:
            return "none"
        if self.pull is not None:
            return self.pull.sentence
        capture, goal = (f"{s:.3f}" if s is not None else "?" for s in (self.s_capture, self.s_goal))
        slide_mm = self.slide_m * 1e3
        return f"capture {capture}, slide {slide_mm:.1f} mm, grasp {goal}, success {self.probability:.0%}"

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)
        require(
            (self.status is Status.OK) == (self.reason == ""), "a rejected grasp needs a reason, and a plan has none"
        )
        require((self.status is Status.OK) == (len(self.waypoints) > 0), "a plan has waypoints, and a rejection none")
        require(0 <= self.probability <= 1, f"a probability must lie within 0 and 1, and is {self.probability}")
        require(self.attempt <= self.attempts, f"attempt {self.attempt} of {self.attempts}")
        phases = [waypoint.phase.value for waypoint in self.waypoints]
        require(phases == sorted(phases), "the phases of a plan must follow each other in order")


class Checked(enum.Enum):
    """What the planner saw after a grasp: the thread moved with the tool, stayed behind, or cannot be told."""

    HELD = 1
    MISSED = 2
    UNKNOWN = 3


@dataclass(frozen=True)
class GraspCheck:
    """Whether the thread moved with the tool after the jaws had closed, as two reconstructions tell.

    Fields:
        before, after: the frames that are compared; None where there was none.
        tool_moved_m: how far the tool moved between the two with the jaws closed.
        thread_moved_m: how far the thread near the jaws moved the same way; None where it was not seen.
        deviation_m: the standard deviation of that.
        held_probability: that the thread moved with the tool rather than stayed; None where nothing was compared.
        attempt, attempts: as in the plan.
        next_plan_id: the plan, or rejection, that follows a miss, or what cannot be told; empty where none does.
        sentence: the same in plain words.
    """

    plan_id: str
    arm: str
    goal_id: str
    verdict: Checked
    before: FrameStamp | None
    after: FrameStamp | None
    tool_moved_m: float | None
    thread_moved_m: float | None
    deviation_m: float | None
    held_probability: float | None
    attempt: UInt32
    attempts: UInt32
    next_plan_id: str
    sentence: str
    consumed: tuple[Consumed, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)
        require(self.attempt <= self.attempts, f"attempt {self.attempt} of {self.attempts}")
        require(self.deviation_m is None or self.deviation_m >= 0, "deviation_m must not be negative")
        likely = self.held_probability
        require(likely is None or 0 <= likely <= 1, f"a probability must lie within 0 and 1, and is {likely}")
        told = None not in (self.tool_moved_m, self.thread_moved_m, self.deviation_m, self.held_probability)
        require(told or self.verdict is Checked.UNKNOWN, "what was not compared is unknown")


class RobotMode(enum.Enum):
    """What the robot bridge is doing with an arm."""

    DISABLED = 1
    IDLE = 2
    MOVING = 3
    HOLDING = 4
    FAULT = 5


@dataclass(frozen=True)
class RobotState:
    """An arm as measured, in its base frame, with where the bridge takes the base to be.

    Fields:
        T_camera_base_registered: where its registration has the base, where the bridge corrects that by images; else
            None.
        kinematics: what kind of arm it is; empty for a PSM.
        correction_looked_ns: when the newest frame was captured by which images correct the base; 0 where none does.
        challenge_ns: what whoever stands by, and the camera, are to echo: the time of this state by the bridge's clock.
        guard_challenge: the newest of the guard beside the console; 0 where there is none.
        maximum_frame_age_s: a motion holds where the newest camera frame is older; 0 from those who do not tell.
        is_real: it moves something real, so that a process that beats by itself cannot arm it.
        jaw_rad: how far the jaw is open: as measured, less `jaw_zero_rad`, the measured angle at which it closes by its
            calibration; 0 where there is none.
        jaw_set_point_rad, jaw_effort: where its console has the jaw head, by the angles that the console measures, and
            with which effort (N m); None where it does not tell.
        instrument: the tool that its console has on it; empty where it does not tell.
    """

    arm: str
    measured_ns: int
    mode: RobotMode
    T_base_tool: Float64[np.ndarray, "4 4"]
    joints: Float64[np.ndarray, "6"]
    jaw_rad: float
    T_camera_base: Float64[np.ndarray, "4 4"]
    plan_id: str
    consumed: tuple[Consumed, ...] = ()
    T_camera_base_registered: Float64[np.ndarray, "4 4"] | None = None
    kinematics: str = ""
    correction_looked_ns: int = 0
    challenge_ns: int = 0
    guard_challenge: UInt64 = 0
    maximum_frame_age_s: float = 0.0
    is_real: bool = False
    jaw_zero_rad: float = 0.0
    jaw_set_point_rad: float | None = None
    jaw_effort: float | None = None
    instrument: str = ""

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)
        check_pose("RobotState.T_base_tool", self.T_base_tool)
        check_pose("RobotState.T_camera_base", self.T_camera_base)
        if self.T_camera_base_registered is not None:
            check_pose("RobotState.T_camera_base_registered", self.T_camera_base_registered)


class ExecutionKind(enum.Enum):
    """What happened to a plan."""

    ACCEPTED = 1
    PHASE_REACHED = 2
    FINISHED = 3
    REFUSED = 4
    HELD = 5
    SEGMENT_ENDED = 6


@dataclass(frozen=True)
class ExecutionEvent:
    """One event in the carrying out of a plan; REFUSED and HELD have a code and a reason.

    Fields:
        arming_id: the id of the Arm command that the event is of.
    """

    plan_id: str
    arm: str
    at_ns: int
    kind: ExecutionKind
    phase: Phase | None
    code: str
    reason: str
    arming_id: str = ""
    consumed: tuple[Consumed, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)
        stopped = self.kind in (ExecutionKind.REFUSED, ExecutionKind.HELD)
        require(stopped == (self.code != ""), "what is refused or held has a code, and nothing else has")


def check_pose(where: str, T: Float64[np.ndarray, "4 4"]) -> None:
    """Require a rigid transform."""
    # by Python's own numbers: NumPy takes ten times as long for one small matrix, and poses come 100 times a second
    *rows, last = T.tolist()
    require(last == [0, 0, 0, 1], f"the last row of {where} must be 0 0 0 1")
    x, y, z = (row[:3] for row in rows)
    off = (_dot(x, x) - 1, _dot(y, y) - 1, _dot(z, z) - 1, _dot(x, y), _dot(x, z), _dot(y, z))
    cross = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    orthonormal = all(abs(one) < POSE_TOLERANCE for one in off) and _dot(cross, z) > 0
    require(orthonormal, f"{where} holds no rotation")


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def check_arm(arm: str) -> None:
    require(arm != "" and "/" not in arm and "*" not in arm, f"{arm!r} is no name of an arm")
