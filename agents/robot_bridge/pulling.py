"""A pull that is armed: its bounds, judged for each segment by the motion itself, and the planner's word while it runs.

The planner proposes segments; nothing that it says of them is believed. What closed jaws travel is added up over all
segments, and where they come to is looked at in every sample: jaws count as closed from the grasp on until they are
told open so wide that they are measured open, however far a jaw may lag. Phases must fit what the jaws hold. A segment
that only lets go is held back by none of it.

While the jaws pull, the newest tail must be measured and no older than a thread may be that is planned from; otherwise
the arm holds. The planner's word to stop ends the segment where it is, and the arm rests with the thread held, so that
it can let go under the same press. The word can end a motion and never lengthen one, and silence ends it too.
"""

import numpy as np
from jaxtyping import Bool, Float64

from agents.robot_bridge.arm_status import too_old
from agents.robot_bridge.jaw import FOLLOWING_JAW_RAD
from agents.robot_bridge.limits import PullLimits, Setup
from agents.robot_bridge.motion import Trajectory
from agents.robot_bridge.plans import Code, Refusal, taken_ns
from schemas.messages import Arm, GraspPlan, Phase, PullBounds, Status, Tail
from shared.kinematics.psm import FINGER_M
from shared.rigid_transforms import angle_between, apply

LETS_GO_RAD = 2.0 * FOLLOWING_JAW_RAD
"""A jaw that is told to be so far open is measured open by more than thread explains: it lags by half of it at most."""
STAYS_M = 1e-3
"""An arm that stays is so near to where it was: at either end as near as one has to come to have arrived, 0.5 mm."""
TURNS_RAD = 0.2
"""Jaws that hold thread keep their attitude as well as an arm that follows does."""
GOES_BACK_M = 0.03
"""Letting go ends so near to where it began: twice as far as an approach begins before the thread."""
BEFORE, AFTER = (Phase.APPROACH, Phase.CAPTURE, Phase.GRASP, Phase.PULL, Phase.RELEASE), (Phase.PULL, Phase.RELEASE)
"""What jaws that hold nothing may do, and those that hold thread."""
MM = 1e3


class Pulling:
    """One pull, from its arming on.

    Fields:
        held, holds: the jaws held thread before the segment that is carried out; they will at its end.
        travelled_m: by closed jaws in all segments so far, the one that is carried out included.
        says_stop: whether a word of the planner has, since the segment began.
    """

    def __init__(self, plan: GraspPlan, bounds: PullBounds | None) -> None:
        self.held = self.holds = self.says_stop = False
        self.travelled_m = 0.0
        self._bounds, self._began_ns = bounds, 0
        entry = plan.pull.entry if plan.pull is not None else None
        self._entry_camera = None if entry is None else entry.point_camera
        self._newest: Tail | None = None

    def hear(self, tail: Tail) -> None:
        """Take the newest tail that was measured; one that could not be grows old, and may say to stop.

        Of several between two turns of the bridge, one word to stop is enough.
        """
        self.says_stop = self.says_stop or tail.stop is not None
        if tail.status is Status.OK and (self._newest is None or _seen_ns(tail) >= _seen_ns(self._newest)):
            self._newest = tail

    def refusal(self, plan: GraspPlan, planned: Trajectory, setup: Setup, drift_m: float) -> Refusal | None:
        """Why a segment must not be carried out.

        Args:
            planned: its motion.
            drift_m: how far the entry may be from where it was armed.
        """
        if why := self._out_of_order(plan):
            return why
        tips = apply(planned_poses(planned, setup), np.array([[0.0, 0.0, FINGER_M]]))[:, 0]
        if lets_go_only(plan):
            return _drags(tips, _told_closed(planned, setup))
        if why := self._loses_thread(planned, tips, setup):
            return why
        bounds = self._bounds
        if bounds is None or self._entry_camera is None:
            return Refusal(Code.PULL_BOUNDS, "nobody has armed a pull, or its plan does not tell where the entry is")
        entry = plan.pull.entry if plan.pull is not None else None
        off_m = np.inf if entry is None else _from(entry.point_camera, self._entry_camera)
        if off_m > drift_m:
            off = "the entry is not told of" if entry is None else f"the entry is {MM * off_m:.1f} mm from where it was"
            return Refusal(Code.PULL_REGION, f"{off}, and {MM * drift_m:g} mm are allowed: arm again")
        closed = self._closed(planned, setup)
        from_entry_m = np.linalg.norm(tips - self._entry_camera, axis=1)
        if closed.any() and (farthest_m := float(from_entry_m[closed].max())) > bounds.radius_m:
            away = f"closed jaws would be {MM * farthest_m:.1f} mm from the entry"
            return Refusal(Code.PULL_REGION, f"{away}, and the pull was armed for {MM * bounds.radius_m:g} mm")
        travels_m = self.travelled_m + _travelled(tips, closed)
        if travels_m > bounds.length_m:
            would = f"closed jaws would have travelled {MM * travels_m:.1f} mm"
            return Refusal(Code.PULL_LENGTH, f"{would}, and the pull was armed for {MM * bounds.length_m:g} mm")
        return None

    def follow(self, plan: GraspPlan, planned: Trajectory, setup: Setup) -> None:
        """A segment begins that nothing speaks against."""
        tips = apply(planned_poses(planned, setup), np.array([[0.0, 0.0, FINGER_M]]))[:, 0]
        self.travelled_m += _travelled(tips, self._closed(planned, setup))
        phases = {waypoint.phase for waypoint in plan.waypoints}
        self.held, self.says_stop = self.holds, False
        self.holds = Phase.RELEASE not in phases and (self.holds or Phase.GRASP in phases)

    def overdue(self, plan: GraspPlan, now_ns: int) -> Refusal | None:
        """Why the pull must not go on: it has lasted longer than it was armed for."""
        self._began_ns = self._began_ns or now_ns
        bounds = self._bounds
        if bounds is None or lets_go_only(plan) or now_ns - self._began_ns <= bounds.time_s * 1e9:
            return None
        return Refusal(Code.PULL_TIME, f"the pull has lasted longer than the {bounds.time_s:g} s that it was armed for")

    def unwatched(self, plans: set[str], arm: str, is_real: bool, now_ns: int, maximum_age_s: float) -> Refusal | None:
        """Why jaws must not pull now: no tail was measured lately."""
        newest = self._newest
        if newest is None or newest.plan_id not in plans:
            return Refusal(Code.TAIL_LOST, "the tail was not measured since the pull was armed: see why (planner/tail)")
        old = too_old(newest.stamp, arm, is_real, now_ns, maximum_age_s, "the newest frame with a tail")
        return None if old is None else Refusal(Code.TAIL_LOST, old.sentence)

    def _out_of_order(self, plan: GraspPlan) -> Refusal | None:
        phases = [waypoint.phase for waypoint in plan.waypoints]
        if plan.pull is None:
            return Refusal(Code.PULL_ORDER, f"plan {plan.plan_id} continues a pull and is none")
        if len(set(phases)) > 1 and Phase.RELEASE in phases:
            return Refusal(Code.PULL_ORDER, f"plan {plan.plan_id} lets go and does more than that")
        pulls_first = Phase.PULL in phases and not self.holds and Phase.GRASP not in phases
        if set(phases) <= set(AFTER if self.holds else BEFORE) and not pulls_first:
            return None
        holds = "hold thread" if self.holds else "hold nothing"
        return Refusal(Code.PULL_ORDER, f"the jaws {holds}, and plan {plan.plan_id} begins with {phases[0].name}")

    def _loses_thread(self, planned: Trajectory, tips: Float64[np.ndarray, "n 3"], setup: Setup) -> Refusal | None:
        """Why thread would not be grasped where the fingers come to it, or not be kept as it was grasped."""
        captured, grasped = (
            next((stop.sample for stop in planned.stops if stop.phase is phase), 0)
            for phase in (Phase.CAPTURE, Phase.GRASP)
        )
        closes_m = float(np.linalg.norm(np.diff(tips[captured : grasped + 1], axis=0), axis=1).sum())
        if not self.holds and closes_m > STAYS_M:
            return Refusal(Code.PULL_ORDER, f"the jaws would move by {MM * closes_m:.1f} mm while they close")
        kept = 0 if self.holds else grasped
        if not _told_closed(planned, setup)[kept:].all():
            return Refusal(Code.PULL_ORDER, "jaws that hold thread would open on the way")
        turns = setup.kinematics.forward(planned.joints[kept:])[:, :3, :3]
        if (turned_rad := float(np.max(angle_between(turns[:1], turns)))) > TURNS_RAD:
            return Refusal(
                Code.PULL_ORDER, f"jaws that hold thread would be turned by {np.degrees(turned_rad):.0f} degrees"
            )
        return None

    def _closed(self, planned: Trajectory, setup: Setup) -> Bool[np.ndarray, "n"]:
        """In which samples the jaws may hold thread."""
        grasped = next((stop.sample for stop in planned.stops if stop.phase is Phase.CAPTURE), 0)
        closed = _told_closed(planned, setup)
        if not self.holds:
            closed[:grasped] = False
        return closed


def pulling_of(plan: GraspPlan, message: Arm, limits: PullLimits) -> Pulling | Refusal | None:
    """The pull that is armed with a plan; None where it is a grasp.

    Jaws that only let go need no bounds.
    """
    pulls = any(waypoint.phase in AFTER for waypoint in plan.waypoints)
    if plan.pull is None or not pulls:
        if plan.pull is not None or pulls:
            unclear = f"plan {plan.plan_id} does not both pull and tell what: see to the planner"
            return Refusal(Code.PULL_ORDER, unclear)
        grasp = f"plan {plan.plan_id} is a grasp, and bounds of a pull were stated: arm it without"
        return None if message.pull is None else Refusal(Code.PULL_BOUNDS, grasp)
    if lets_go_only(plan) and plan.pull.last:
        return Pulling(plan, None)
    bounds = message.pull
    if bounds is None:
        return Refusal(
            Code.PULL_BOUNDS,
            f"plan {plan.plan_id} pulls thread: state with the arming how much at most, for how long, and how far from "
            "the entry",
        )
    for what, stated, allowed in (
        ("mm of thread", MM * bounds.length_m, MM * limits.length_m),
        ("s", bounds.time_s, limits.time_s),
        ("mm from the entry", MM * bounds.radius_m, MM * limits.radius_m),
    ):
        if stated > allowed:
            return Refusal(Code.PULL_BOUNDS, f"a pull is armed for {allowed:g} {what} at most, not for {stated:g}")
    return Pulling(plan, bounds)


def lets_go_only(plan: GraspPlan) -> bool:
    """Whether a plan does nothing but open the jaws and go back."""
    return all(waypoint.phase is Phase.RELEASE for waypoint in plan.waypoints)


def planned_poses(planned: Trajectory, setup: Setup) -> Float64[np.ndarray, "n 4 4"]:
    """`T_camera_tool` of every sample of a motion."""
    return setup.T_camera_base @ setup.kinematics.forward(planned.joints)


def _told_closed(planned: Trajectory, setup: Setup) -> Bool[np.ndarray, "n"]:
    """In which samples the jaw is told to be less open than lets go for certain."""
    return planned.jaw_rad - setup.jaw.told_rad < LETS_GO_RAD


def _drags(tips: Float64[np.ndarray, "n 3"], closed: Bool[np.ndarray, "n"]) -> Refusal | None:
    """Why jaws that are to let go would take thread along instead; None where they open before they move."""
    if closed[-1] or (np.diff(closed.astype(int)) > 0).any():
        return Refusal(Code.PULL_ORDER, "jaws that are to let go would not open, or close again")
    if (away_m := float(np.linalg.norm(tips - tips[0], axis=1).max())) > GOES_BACK_M:
        far = f"jaws that are to let go would go {MM * away_m:.0f} mm away, and {MM * GOES_BACK_M:.0f} mm are allowed"
        return Refusal(Code.PULL_ORDER, far)
    if (dragged_m := _travelled(tips, closed)) > STAYS_M:
        return Refusal(
            Code.PULL_ORDER, f"jaws that are to let go would move by {MM * dragged_m:.1f} mm before they open"
        )
    return None


def _travelled(tips: Float64[np.ndarray, "n 3"], closed: Bool[np.ndarray, "n"]) -> float:
    """How far the tips go while the jaws are closed."""
    return float((np.linalg.norm(np.diff(tips, axis=0), axis=1) * closed[1:]).sum())


def _seen_ns(tail: Tail) -> int:
    return taken_ns(tail.stamp, tail.arm)


def _from(a: Float64[np.ndarray, "3"], b: Float64[np.ndarray, "3"]) -> float:
    return float(np.linalg.norm(a - b))
