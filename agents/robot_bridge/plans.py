"""The last few plans of an arm: which it could be armed with, and why not with the others.

Each reason is a code for programs and a sentence for people.
"""

import enum
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from schemas.messages import FrameStamp, GraspPlan, Status


class Code(enum.StrEnum):
    """What can speak against a motion. docs/robot_bridge.md says what to do about each."""

    OTHER_ARM = "other_arm"
    UNKNOWN_PLAN = "unknown_plan"
    CARRIED_OUT = "carried_out"
    REJECTED_PLAN = "rejected_plan"
    BUSY = "busy"
    NOT_READY = "not_ready"
    NOT_ENABLED = "not_enabled"
    NOT_HOMED = "not_homed"
    ERROR_STATE = "error_state"
    WRONG_TOOL = "wrong_tool"
    OTHER_POSE = "other_pose"
    OTHER_OWNER = "other_owner"
    OTHER_SET_POINT = "other_set_point"
    STALE_STATE = "stale_state"
    GOAL_NOT_REACHED = "goal_not_reached"
    STALE = "stale"
    CLOCK = "clock"
    MOVED = "moved"
    OUT_OF_ORDER = "out_of_order"
    WRONG_FRAME = "wrong_frame"
    REPLAY = "replay"
    NOT_FINITE = "not_finite"
    NOT_A_POSE = "not_a_pose"
    WORKSPACE = "workspace"
    UNREACHABLE = "unreachable"
    REMOTE_CENTRE = "remote_centre"
    SINGULAR = "singular"
    TISSUE = "tissue"
    WRIST_FLIP = "wrist_flip"
    JAW_LIMIT = "jaw_limit"
    TOO_LONG = "too_long"
    HEARTBEAT_LOST = "heartbeat_lost"
    HOLD_COMMAND = "hold_command"
    NOT_FOLLOWING = "not_following"
    JAW_OPEN = "jaw_open"
    STATE_NOT_REACHED = "state_not_reached"
    CORRECTION_LOST = "correction_lost"
    CORRECTION_JUMPED = "correction_jumped"
    CORRECTION_LIMIT = "correction_limit"
    NO_PRESENCE = "no_presence"
    ROUND_TRIP = "round_trip"
    NO_GUARD = "no_guard"
    FRAME_AGE = "frame_age"
    UNKNOWN = "unknown"
    SEGMENT = "segment"
    PULL_BOUNDS = "pull_bounds"
    PULL_LENGTH = "pull_length"
    PULL_TIME = "pull_time"
    PULL_REGION = "pull_region"
    PULL_ORDER = "pull_order"
    TAIL_LOST = "tail_lost"
    FAULT = "fault"
    DRY_RUN = "dry_run"
    NO_STATES = "no_states"


AGAINST_PLAN = frozenset(
    {
        Code.REJECTED_PLAN,
        Code.NOT_FINITE,
        Code.NOT_A_POSE,
        Code.WORKSPACE,
        Code.UNREACHABLE,
        Code.REMOTE_CENTRE,
        Code.SINGULAR,
        Code.TISSUE,
        Code.WRIST_FLIP,
        Code.JAW_LIMIT,
        Code.TOO_LONG,
    }
)
"""What speaks against a plan itself; all others speak against the moment, and the same plan may do later."""


@dataclass(frozen=True)
class Refusal:
    """One reason not to move."""

    code: Code
    sentence: str


REPLAYED = Refusal(
    Code.REPLAY, "a recording is replayed on this rig, and this arm is real: end the replay, then set a goal and arm"
)
UNMEASURED = Refusal(Code.NOT_READY, "the arm has not been measured yet")


def other_arm(mine: str, *named: str) -> Refusal | None:
    """Why a command is not for this arm; None where all that it names is."""
    other = next((name for name in named if name != mine), None)
    return None if other is None else Refusal(Code.OTHER_ARM, f"the command is for {other}, and this is {mine}")


KEPT_PLANS = 8
CLOCK_TOLERANCE_S = 0.5
"""How far a plan's frame may lie in the future, or a heartbeat off its time, before clocks are said to disagree."""


class Begun(NamedTuple):
    """A motion of an arm: which plan's, when it began, and whether the fingers came as far as the thread.

    A bridge that begins has no plan's: whatever came before, it does not know what the fingers did then.
    """

    plan_id: str
    at_ns: int
    touched: bool = False


class Plans:
    """Plans as they came, by their id; the newest of an id counts.

    Fields:
        last: the last motion that began.
    """

    def __init__(self, arm: str) -> None:
        self._arm = arm
        self._plans: dict[str, GraspPlan] = {}
        self._unusable: dict[str, Refusal] = {}
        self.last = Begun("", 0)

    def keep(self, plan: GraspPlan, now_ns: int | None, replayed: bool) -> None:
        """Keep a plan that this arm could be armed with, or else why it could not.

        Args:
            now_ns: None where the bridge has not begun.
            replayed: whether it is one of a recording.
        """
        self._plans.pop(plan.plan_id, None)
        self._unusable.pop(plan.plan_id, None)
        if plan.arm != self._arm:
            sentence = f"plan {plan.plan_id} is for {plan.arm}, and this is {self._arm}"
            _keep_few(self._unusable, plan.plan_id, Refusal(Code.OTHER_ARM, sentence))
        elif plan.status is not Status.OK:
            sentence = f"the planner rejected plan {plan.plan_id}: {plan.reason}"
            _keep_few(self._unusable, plan.plan_id, Refusal(Code.REJECTED_PLAN, sentence))
        elif replayed:
            _keep_few(self._unusable, plan.plan_id, REPLAYED)
        elif now_ns is not None and (future := _of_the_future(plan, now_ns)):
            # a time to come would make it young then
            _keep_few(self._unusable, plan.plan_id, future)
        else:
            _keep_few(self._plans, plan.plan_id, plan)

    def begins(self, now_ns: int) -> None:
        """Nothing of before counts: the bridge began now, or its clock was set."""
        self._plans.clear()
        self.last = Begun("", now_ns, touched=True)

    def moves(self, plan_id: str, now_ns: int, touched: bool) -> None:
        """Note that a plan is carried out; again after a hold before the thread it is still the same motion."""
        if self.last.plan_id != plan_id or touched:
            self.last = Begun(plan_id, now_ns, touched)

    def forget(self, plan_id: str) -> None:
        """A plan that was carried out is so once."""
        if self._plans.pop(plan_id, None) is not None:
            sentence = f"plan {plan_id} was carried out already: set a goal again"
            _keep_few(self._unusable, plan_id, Refusal(Code.CARRIED_OUT, sentence))

    def unusable(self, plan_id: str) -> Refusal | None:
        """Why the arm cannot be armed with a plan that came; None where nothing speaks against it, or none came."""
        return self._unusable.get(plan_id)

    def find(self, plan_id: str) -> GraspPlan | Refusal:
        """A plan that the arm could be armed with."""
        plan = self._plans.get(plan_id)
        if plan is None:
            return Refusal(Code.UNKNOWN_PLAN, f"no plan {plan_id} is among the last {KEPT_PLANS}: set a goal again")
        return plan


def untimely(plan: GraspPlan, now_ns: int, still_since_ns: int, last: Begun, maximum_age_s: float) -> Refusal | None:
    """Why a plan comes too late, too early or out of order; None where it does none of it.

    Args:
        still_since_ns: what was captured before is elsewhere now.
        last: what a motion has touched may be elsewhere, and in the fingers. So the same plan may go on after a hold on
            its approach, and no later: it would begin anew, with jaws that may hold thread.
    """
    captured_ns = taken_ns(plan.stamp, plan.arm)
    age_s = (now_ns - captured_ns) * 1e-9
    if age_s > maximum_age_s:
        allowed = f"more than the {maximum_age_s:g} s allowed: plan again"
        return Refusal(Code.STALE, f"the frame of plan {plan.plan_id} is {age_s:.1f} s old, {allowed}")
    if captured_ns < still_since_ns:
        moved = "camera, set-up joints or arm were moved by hand"
        return Refusal(Code.MOVED, f"{moved} after the frame of plan {plan.plan_id} was captured: plan again")
    if captured_ns < last.at_ns and (plan.plan_id != last.plan_id or last.touched):
        motion = f"the motion of plan {last.plan_id} began, which may have moved the thread"
        before = motion if last.plan_id else "this bridge began, or its clock was set: the jaws may hold thread since"
        return Refusal(Code.OUT_OF_ORDER, f"the frame of plan {plan.plan_id} was captured before {before}: plan again")
    return _of_the_future(plan, now_ns)


def _of_the_future(plan: GraspPlan, now_ns: int) -> Refusal | None:
    ahead_s = (taken_ns(plan.stamp, plan.arm) - now_ns) * 1e-9
    if ahead_s <= CLOCK_TOLERANCE_S:
        return None
    future = f"the frame of plan {plan.plan_id} was captured {ahead_s:.1f} s in the future"
    return Refusal(Code.CLOCK, f"{future}: set the clocks of camera and bridge by each other")


def taken_ns(stamp: FrameStamp, arm: str) -> int:
    """When a frame was taken at the earliest, by the clock of the arm's bridge where it echoes that."""
    return stamp.echo_of(arm) or min(stamp.capture_left_ns, stamp.capture_right_ns)


def wrong_frame(plan: GraspPlan, others: Iterable[tuple[str, str]]) -> Refusal | None:
    """Why a plan is not in the camera frame that it would be carried out in; None where it is, or nothing is told.

    Args:
        others: what else is told in a rectified camera's frame, and the id of that camera's calibration; empty where
            that is not known.
    """
    own = plan.stamp.calibration_id
    other = next(((what, of) for what, of in others if of and of != own), None)
    if other is None:
        return None
    apart = f"plan {plan.plan_id} is in the frame of camera calibration {own}, and {other[0]} in that of {other[1]}"
    return Refusal(Code.WRONG_FRAME, f"{apart}: plan again, with the calibration that the arm was registered with")


def _keep_few(kept: dict[str, Any], plan_id: str, value: Any) -> None:
    """Keep the newest ones; a dict remembers in which order they came."""
    kept[plan_id] = value
    if len(kept) > KEPT_PLANS:
        del kept[next(iter(kept))]
