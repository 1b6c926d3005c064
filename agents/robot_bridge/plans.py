"""The last few plans of an arm: which it could be armed with, and why not with the others."""

from typing import Any

from agents.robot_bridge.refusals import REPLAYED, Code, Refusal
from schemas.messages import GraspPlan, Status

KEPT_PLANS = 8
CLOCK_TOLERANCE_S = 0.5
"""How far a plan's frame may lie in the future, or a heartbeat off its time, before clocks are said to disagree."""


class Plans:
    """Plans as they came, by their id; the newest of an id counts."""

    def __init__(self, arm: str) -> None:
        self._arm = arm
        self._plans: dict[str, GraspPlan] = {}
        self._unusable: dict[str, Refusal] = {}

    def keep(self, plan: GraspPlan, replayed: bool) -> None:
        """Keep a plan that this arm could be armed with, or else why it could not; `replayed` is one of a recording."""
        self.forget(plan.plan_id)
        self._unusable.pop(plan.plan_id, None)
        if plan.arm != self._arm:
            sentence = f"plan {plan.plan_id} is for {plan.arm}, and this is {self._arm}"
            _keep_few(self._unusable, plan.plan_id, Refusal(Code.OTHER_ARM, sentence))
        elif plan.status is not Status.OK:
            sentence = f"the planner rejected plan {plan.plan_id}: {plan.reason}"
            _keep_few(self._unusable, plan.plan_id, Refusal(Code.REJECTED_PLAN, sentence))
        elif replayed:
            _keep_few(self._unusable, plan.plan_id, REPLAYED)
        else:
            _keep_few(self._plans, plan.plan_id, plan)

    def forget(self, plan_id: str) -> None:
        """A plan that was carried out is so once."""
        self._plans.pop(plan_id, None)

    def unusable(self, plan_id: str) -> Refusal | None:
        """Why the arm cannot be armed with a plan that came; None where nothing speaks against it, or none came."""
        return self._unusable.get(plan_id)

    def find(self, plan_id: str) -> GraspPlan | Refusal:
        """A plan that the arm could be armed with."""
        plan = self._plans.get(plan_id)
        if plan is None:
            return Refusal(Code.UNKNOWN_PLAN, f"no plan {plan_id} is among the last {KEPT_PLANS}: set a goal again")
        return plan


def untimely(plan: GraspPlan, now_ns: int, still_since_ns: int, maximum_age_s: float) -> Refusal | None:
    """Why a plan comes too late or too early; None where it does neither.

    Args:
        still_since_ns: what was captured before is elsewhere now.
    """
    captured_ns = min(plan.stamp.capture_left_ns, plan.stamp.capture_right_ns)
    age_s = (now_ns - captured_ns) * 1e-9
    if age_s > maximum_age_s:
        allowed = f"more than the {maximum_age_s:g} s allowed: plan again"
        return Refusal(Code.STALE, f"the frame of plan {plan.plan_id} is {age_s:.1f} s old, {allowed}")
    if captured_ns < still_since_ns:
        moved = "camera, set-up joints or arm were moved by hand"
        return Refusal(Code.MOVED, f"{moved} after the frame of plan {plan.plan_id} was captured: plan again")
    if age_s < -CLOCK_TOLERANCE_S:
        future = f"the frame of plan {plan.plan_id} was captured {-age_s:.1f} s in the future"
        return Refusal(Code.CLOCK, f"{future}: set the clocks of camera and bridge by each other")
    return None


def _keep_few(kept: dict[str, Any], plan_id: str, value: Any) -> None:
    """Keep the newest ones; a dict remembers in which order they came."""
    kept[plan_id] = value
    if len(kept) > KEPT_PLANS:
        del kept[next(iter(kept))]
