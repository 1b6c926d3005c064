"""A plan for a goal: where to capture, how to hold the tool, and the waypoints; or why there is none."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, ThreadCurve, curve_of, seen, strand_distance
from agents.planner.goal import goal_on_thread
from agents.planner.policy import (
    Against,
    alternatives,
    candidates,
    capture_probability,
    counted_reasons,
    first_against,
    grasp_probability,
    least_on_the_way,
    most_likely,
    reason_of,
)
from agents.planner.poses import turn_between
from agents.planner.waypoints import waypoints
from agents.planner.ways import Reachable, Ways, along_slide, reached, steps_along_slide, ways_along
from schemas.messages import Alternative, GraspGoal, GraspPlan, Policy, Status, ThreadReconstruction
from shared.kinematics.psm import FINGER_M


@dataclass(frozen=True)
class ArmView:
    """An arm as a plan needs it: where its base and its tool are, and what it can reach."""

    T_camera_base: Float64[np.ndarray, "4 4"]
    T_camera_tool: Float64[np.ndarray, "4 4"]
    reachable: Reachable


@dataclass(frozen=True)
class _Captures:
    """All captures for one goal.

    Fields:
        likelihood: of the whole grasp as the paper has it, by which captures are chosen.
        probability: of the whole grasp with the least confidence on the way, which is stated.
        against: what speaks against each, as in `first_against`.
        passable: for each way to hold the tool, whether it leads from the capture to the goal.
    """

    s: Float64[np.ndarray, "n"]
    goal: int
    likelihood: Float64[np.ndarray, "n"]
    probability: Float64[np.ndarray, "n"]
    against: Int64[np.ndarray, "n"]
    ways: Ways
    passable: Bool[np.ndarray, "2 2 n"]


def plan_grasp(goal: GraspGoal, thread: ThreadReconstruction, arm: ArmView, config: PlannerConfig) -> GraspPlan:
    """The grasp that most likely succeeds, or a rejection with its reason. Never raises for valid messages."""
    try:
        curve = curve_of(thread)
        s_goal = goal_on_thread(goal, curve, config)
        captures = _captures(curve, s_goal, thread, arm, config)
    except NoGraspError as error:
        return _rejected(goal, thread, str(error))
    return _best(goal, thread, arm, config, curve, captures)


def plan_id(goal: GraspGoal) -> str:
    """The name of the plan for a goal, of which there is one."""
    return f"plan-{goal.header.id}"


def _captures(
    curve: ThreadCurve, s_goal: float, thread: ThreadReconstruction, arm: ArmView, config: PlannerConfig
) -> _Captures:
    s, goal = candidates(s_goal, config.samples)
    points, tangents = curve.points(s), curve.tangents(s)
    ways = ways_along(points, tangents, arm.T_camera_base[:3, 3], config)
    beside = strand_distance(curve, s, FINGER_M)
    clear = along_slide(ways.clear, goal)
    steady = clear & steps_along_slide(ways.steady, goal)
    passable = steady[:, None] & reached(ways, goal, arm.reachable)
    captured, is_seen = capture_probability(thread, s), seen(curve, s)
    known = is_seen & (captured >= config.least_probability)
    against = first_against(
        {
            Against.UNSEEN: ~is_seen,
            Against.UNKNOWN_ON_THE_WAY: ~along_slide(known, goal),
            Against.STRAND_BESIDE: beside < config.half_opening_m(config.open_deg),
            Against.STRAND_ON_THE_WAY: ~along_slide(beside >= config.half_opening_m(config.slide_deg), goal),
            Against.ALONG_APPROACH: ~clear.any(axis=0),
            Against.TURNS_TOO_SHARPLY: ~steady.any(axis=0),
            Against.UNREACHABLE: ~passable.any(axis=(0, 1)),
        }
    )
    likelihood = grasp_probability(captured, goal, config.keep_probability)
    probability = grasp_probability(least_on_the_way(captured, goal), goal, config.keep_probability)
    return _Captures(s, goal, likelihood, probability, against, ways, passable)


def _best(
    goal: GraspGoal,
    thread: ThreadReconstruction,
    arm: ArmView,
    config: PlannerConfig,
    curve: ThreadCurve,
    captures: _Captures,
) -> GraspPlan:
    s, at_goal, probability, against = captures.s, captures.goal, captures.probability, captures.against
    direct = goal.policy is Policy.DIRECT
    allowed = (against < 0) & ((np.arange(len(s)) == at_goal) | (not direct))
    chosen = most_likely(captures.likelihood, allowed & (probability >= config.least_probability), at_goal)
    if chosen is None:
        chosen = most_likely(probability, allowed, at_goal)
    others = () if direct else alternatives(s, probability, against, at_goal, chosen, config.alternatives)
    s_goal = float(s[at_goal])
    if chosen is None and direct:
        reason = f"the thread cannot be grasped directly at s = {s_goal:.3f}: {reason_of(int(against[at_goal]))}"
        return _rejected(goal, thread, reason, s_goal)
    if chosen is None:
        reason = (
            f"the thread cannot be captured anywhere for a goal at s = {s_goal:.3f}; "
            f"of {len(s)} places: {counted_reasons(against)}"
        )
        return _rejected(goal, thread, reason, s_goal, 0.0, others)
    likely = float(probability[chosen])
    if likely < config.least_probability:
        reason = (
            f"the best capture, at s = {s[chosen]:.3f}, succeeds with a probability of {likely:.2f}, "
            f"and {config.least_probability:.2f} is asked for"
        )
        return _rejected(goal, thread, reason, s_goal, likely, others)
    return GraspPlan(
        plan_id=plan_id(goal),
        arm=goal.arm,
        goal_id=goal.header.id,
        stamp=thread.stamp,
        status=Status.OK,
        reason="",
        policy=goal.policy,
        s_goal=s_goal,
        s_capture=float(s[chosen]),
        probability=likely,
        slide_m=float(abs(s[chosen] - s_goal) * curve.length_m),
        waypoints=waypoints(captures.ways, _way(captures, chosen, arm), s, chosen, at_goal, config),
        alternatives=others,
    )


def _way(captures: _Captures, capture: int, arm: ArmView) -> tuple[int, int]:
    """The viewing ray before the base's, and of the jaws' sides that to which the tool has to turn least."""
    passable = captures.passable[:, :, capture]
    ray = int(np.argmax(passable.any(axis=1)))
    R_camera_tool = captures.ways.standoff[ray, :, capture, :3, :3]
    turn = np.where(passable[ray], turn_between(R_camera_tool, arm.T_camera_tool[:3, :3]), np.inf)
    return ray, int(np.argmin(turn))


def _rejected(
    goal: GraspGoal,
    thread: ThreadReconstruction,
    reason: str,
    s_goal: float | None = None,
    probability: float = 0.0,
    others: tuple[Alternative, ...] = (),
) -> GraspPlan:
    return GraspPlan(
        plan_id=plan_id(goal),
        arm=goal.arm,
        goal_id=goal.header.id,
        stamp=thread.stamp,
        status=Status.FAILED,
        reason=reason,
        policy=goal.policy,
        s_goal=s_goal,
        s_capture=None,
        probability=probability,
        slide_m=0.0,
        waypoints=(),
        alternatives=others,
    )
