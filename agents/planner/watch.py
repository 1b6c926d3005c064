"""What follows from the end of a grasp: a check as soon as the thread was seen after it, and another plan after a miss,
or where that is likelier than not. And between two segments of a long motion a plan from a fresh image, to go on by.

Nothing moves by itself: each plan has to be armed.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from agents.planner.check import Seen, around, checked
from agents.planner.config import PlannerConfig
from agents.planner.learning import next_attempt, plan_id
from schemas.messages import (
    Checked,
    ExecutionEvent,
    ExecutionKind,
    GraspCheck,
    GraspGoal,
    GraspPlan,
    Phase,
    Status,
)
from schemas.messages import ThreadReconstruction as Thread

REMEMBERED_PLANS, ENDS = 16, 2
NS_PER_MS = 1e6


@dataclass(frozen=True)
class Ended:
    """A plan that was carried out to its end, and when that was."""

    plan: GraspPlan
    at_ns: int


class Watch:
    """Plans that may be carried out, and those that were and are not checked yet."""

    def __init__(self) -> None:
        self._plans: dict[str, GraspPlan] = {}
        self._ended: dict[str, Ended] = {}
        self._resting: dict[str, Ended] = {}
        self._pulls: dict[str, tuple[GraspPlan, Phase | None]] = {}

    def planned(self, plan: GraspPlan) -> None:
        """Remember a plan, as one of the newest; one that goes on with a pull is carried out at once."""
        if plan.status is Status.OK:
            self._plans[plan.plan_id] = plan
            if plan.pull is not None and plan.continues:
                self._pulls[plan.arm] = plan, None
            while len(self._plans) > REMEMBERED_PLANS:
                del self._plans[next(iter(self._plans))]

    def told(self, event: ExecutionEvent) -> None:
        """Take in what an arm does: a plan that is finished is to be checked; another one begun makes that moot."""
        plan = self._plans.get(event.plan_id)
        self._pulls_on(plan, event)
        if event.kind is ExecutionKind.FINISHED and plan is not None and plan.pull is None:
            self._ended[event.arm] = Ended(plan, event.at_ns)
        elif event.kind is ExecutionKind.ACCEPTED:
            self._ended.pop(event.arm, None)
        if event.kind is ExecutionKind.SEGMENT_ENDED and plan is not None:
            self._resting[event.arm] = Ended(plan, event.at_ns)
        elif event.kind is not ExecutionKind.PHASE_REACHED:
            self._resting.pop(event.arm, None)

    def _pulls_on(self, plan: GraspPlan | None, event: ExecutionEvent) -> None:
        """Which pull an arm carries out, and which of its phases was reached last."""
        if event.kind is ExecutionKind.ACCEPTED and plan is not None and plan.pull is not None and plan.pull.tail_m:
            self._pulls[event.arm] = plan, None
        elif event.kind is ExecutionKind.PHASE_REACHED and (pulls := self._pulls.get(event.arm)) is not None:
            self._pulls[event.arm] = pulls[0], event.phase
        elif event.kind in (ExecutionKind.FINISHED, ExecutionKind.HELD, ExecutionKind.ACCEPTED):
            self._pulls.pop(event.arm, None)

    @property
    def waits(self) -> bool:
        """Whether a grasp has ended that is not checked yet, a segment that is not planned on from, or thread runs."""
        return bool(self._ended or self._resting or self._pulls)

    @property
    def pulls(self) -> list[tuple[GraspPlan, Phase | None]]:
        """The plans by which arms pull, each with its phase that was reached last."""
        return list(self._pulls.values())

    def resting(self, thread: Thread) -> list[tuple[GraspPlan, float]]:
        """The plans of which a segment has ended before this thread was seen, by the clock of the arm's own bridge, and
        how many milliseconds before.
        """
        rests = [(ended.plan, 1e-6 * (_seen_ns(thread, arm) - ended.at_ns)) for arm, ended in self._resting.items()]
        return [(plan, since_ms) for plan, since_ms in rests if since_ms >= 0]

    def goes_on(self, plan: GraspPlan) -> None:
        """A plan to go on by was made."""
        self._resting.pop(plan.arm, None)

    def due(self, thread: Thread, config: PlannerConfig) -> list[Ended]:
        """What can be checked now that a thread was seen."""
        return [ended for ended in self._ended.values() if _age_ms(ended, thread) >= config.check_after_ms]

    def done(self, ended: Ended) -> None:
        """It was checked."""
        self._ended.pop(ended.plan.arm, None)


def check_of(
    ended: Ended, thread: Thread, T_camera_tool: Float64[np.ndarray, "4 4"] | None, config: PlannerConfig
) -> GraspCheck | None:
    """What the thread after a grasp tells; None where it tells nothing and later frames still may."""
    plan = ended.plan
    if T_camera_tool is None:
        seen = Seen(Checked.UNKNOWN, "cannot be told: the arm does not report where its tool is")
    else:
        seen = checked(plan, thread, T_camera_tool, config)
    if seen.verdict is Checked.UNKNOWN and _age_ms(ended, thread) < config.check_within_ms:
        return None
    again = next_attempt(plan, seen.verdict, config) if seen.verdict is Checked.MISSED or seen.doubtful else None
    return GraspCheck(
        plan_id=plan.plan_id,
        arm=plan.arm,
        goal_id=plan.goal_id,
        verdict=seen.verdict,
        before=plan.stamp,
        after=thread.stamp,
        tool_moved_m=seen.motion.tool_m if seen.motion else None,
        thread_moved_m=seen.motion.thread_m if seen.motion else None,
        deviation_m=seen.motion.deviation_m if seen.motion else None,
        held_probability=seen.held_probability,
        attempt=plan.attempt,
        attempts=plan.attempts,
        next_plan_id=plan_id(plan.goal, again) if plan.goal is not None and again is not None else "",
        sentence=seen.sentence + _what_now(seen, plan, again is not None),
    )


def goal_again(plan: GraspPlan, thread: Thread) -> GraspGoal | None:
    """The goal of a plan on another reconstruction, which may count s from the other end."""
    goal, now = plan.goal, around(thread, ENDS)
    if goal is None or goal.s is None or plan.around is None or now is None:
        return goal
    ends = plan.around.points_camera[[0, -1]]
    same, turned = (np.linalg.norm(now.points_camera[[i, -1 - i]] - ends, axis=1).sum() for i in (0, -1))
    return goal if same <= turned else replace(goal, s=1.0 - goal.s)


def _seen_ns(thread: Thread, arm: str) -> int:
    """When a thread was seen at the latest, by the bridge's clock where its frame echoes that."""
    stamp = thread.stamp
    return stamp.echo_of(arm) or min(stamp.capture_left_ns, stamp.capture_right_ns)


def _age_ms(ended: Ended, thread: Thread) -> float:
    """How long after the end of a grasp the older of both images was captured."""
    return (min(thread.stamp.capture_left_ns, thread.stamp.capture_right_ns) - ended.at_ns) / NS_PER_MS


def _what_now(seen: Seen, plan: GraspPlan, again: bool) -> str:
    if seen.verdict is Checked.HELD or (seen.verdict is Checked.UNKNOWN and not seen.doubtful):
        return ""
    if again and seen.verdict is Checked.UNKNOWN:
        return f"; look at it: attempt {plan.attempt} of {plan.attempts}, another one is planned, and lets go first"
    if again:
        return f"; attempt {plan.attempt} of {plan.attempts}, another one is planned"
    return f"; attempt {plan.attempt} of {plan.attempts} was the last"
