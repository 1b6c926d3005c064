"""A plan for a goal: where to capture, how to hold the tool, and the waypoints; or why there is none."""

import numpy as np
from jaxtyping import Float64

from agents.planner.captures import ArmView, Captures, Choice, best_choice, least_pressed
from agents.planner.chances import PAPER, Known, known_along
from agents.planner.check import SAMPLES_BEFORE, around
from agents.planner.clear_way import clear_way
from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, ThreadCurve, curve_of
from agents.planner.goal import goal_on_thread
from agents.planner.learning import Attempt, first_attempt, offset_for, plan_id
from agents.planner.needle import NeedleAround
from agents.planner.places import asked_of, places_along
from agents.planner.policy import Against, alternatives, candidates, counted_reasons, reason_of
from agents.planner.retreat import NOWHERE, aside_of, with_aside
from agents.planner.tissue_clearance import NOTHING_SEEN, SeenTissue, clearance_of, pressed_sentence
from schemas.messages import (
    Alternative,
    GraspGoal,
    GraspPlan,
    Policy,
    Status,
    ThreadReconstruction,
    TissueClearance,
)


def plan_grasp(
    goal: GraspGoal,
    thread: ThreadReconstruction,
    arm: ArmView,
    config: PlannerConfig,
    tissue: SeenTissue = NOTHING_SEEN,
    attempt: Attempt | None = None,
    needle: NeedleAround | None = None,
    beside: Float64[np.ndarray, "k 3"] | None = None,
) -> GraspPlan:
    """The grasp that most likely succeeds, or a rejection with its reason. Never raises for valid messages.

    Args:
        beside: places in the camera frame, in metres, along another strand, which counts as one of the thread's own.
    """
    attempt = attempt or first_attempt(goal, config)
    try:
        curve = curve_of(thread)
        s_goal = goal_on_thread(goal, curve, config, needle)
        s, at_goal = candidates(s_goal, config.samples)
        asked = asked_of(at_goal, goal.policy)
        known = known_along(thread, curve, s, config, offset_for(attempt, config), asked)
        places = places_along(curve, s, at_goal, goal.policy, known, needle, beside)
        choice = best_choice(places, goal.policy, arm, config, tissue)
    except NoGraspError as error:
        return _rejected(goal, thread, attempt, str(error))
    return _best(goal, thread, attempt, arm, curve, known, choice, tissue, needle, beside)


def _best(
    goal: GraspGoal,
    thread: ThreadReconstruction,
    attempt: Attempt,
    arm: ArmView,
    curve: ThreadCurve,
    known: Known,
    choice: Choice,
    tissue: SeenTissue,
    needle: NeedleAround | None,
    beside: Float64[np.ndarray, "k 3"] | None,
) -> GraspPlan:
    captures, chosen, config = choice.captures, choice.chosen, choice.config
    s, at_goal, probability, against = captures.s, captures.goal, captures.probability, captures.against
    direct = goal.policy is Policy.DIRECT
    others = () if direct else alternatives(s, probability, against, at_goal, chosen, config.alternatives)
    s_goal = float(s[at_goal])
    if chosen is None:
        reason = f"the thread cannot be grasped directly at s = {s_goal:.3f}: {reason_of(int(against[at_goal]))}"
        if not direct:
            nowhere = f"the thread cannot be captured anywhere for a goal at s = {s_goal:.3f}"
            reason = f"{nowhere}; of {len(s)} places: {counted_reasons(against)}"
        if (against == list(Against).index(Against.UNKNOWN_ON_THE_WAY)).any():
            reason += f" (known enough is what is grasped with a probability of {config.least_probability:g} at least)"
        pressed, why = _at_tissue(captures, config, tissue)
        return _rejected(goal, thread, attempt, reason + why, s_goal, 0.0, others, pressed)
    likely = float(probability[chosen])
    if likely < config.least_probability:
        reason = (
            f"the best capture, at s = {s[chosen]:.3f}, succeeds with a probability of {likely:.2f}, "
            f"and {config.least_probability:.2f} is asked for"
        )
        return _rejected(goal, thread, attempt, reason, s_goal, likely, others)
    led = clear_way(choice, chosen, curve, arm, needle, beside)
    if known.model != PAPER:
        led = with_aside(led, s_goal, curve, arm, config, tissue, needle, beside)
    return GraspPlan(
        plan_id=plan_id(goal, attempt),
        arm=goal.arm,
        goal_id=goal.header.id,
        stamp=thread.stamp,
        status=Status.OK,
        reason="",
        policy=goal.policy,
        s_goal=s_goal,
        s_capture=float(s[led.capture]),
        probability=min(led.probability, 1.0),
        slide_m=float(abs(s[led.capture] - s_goal) * curve.length_m),
        waypoints=led.waypoints,
        alternatives=others,
        tissue=clearance_of(tissue, captures.ways, led.way[0], s, led.capture, at_goal, config, aside_of(led)),
        thread=led.thread,
        policy_model=known.model,
        goal=goal,
        depth_m=config.depth_m,
        around=around(thread, SAMPLES_BEFORE),
        attempt=attempt.number,
        attempts=attempt.of,
        offset_camera=attempt.offset.mean_camera if attempt.offset else None,
        offset_covariance=attempt.offset.covariance if attempt.offset else None,
    )


def _at_tissue(captures: Captures, config: PlannerConfig, tissue: SeenTissue) -> tuple[TissueClearance | None, str]:
    """How the least bad of the captures that tissue forbids stands to it, and what to add to the reason for that."""
    if np.equal(captures.against, list(Against).index(Against.TISSUE_UNKNOWN)).any():
        why = tissue.unchecked or "look at it so that both eyes see it, or set tissue_required to false"
        return None, f" ({why})"
    pressed = least_pressed(captures)
    if pressed is None:
        return None, ""
    found = clearance_of(tissue, captures.ways, pressed[0], captures.s, pressed[1], captures.goal, config, NOWHERE)
    return found, f"; at best, captured at s = {captures.s[pressed[1]]:.3f}, {pressed_sentence(found, config)}"


def _rejected(
    goal: GraspGoal,
    thread: ThreadReconstruction,
    attempt: Attempt,
    reason: str,
    s_goal: float | None = None,
    probability: float = 0.0,
    others: tuple[Alternative, ...] = (),
    tissue: TissueClearance | None = None,
) -> GraspPlan:
    return GraspPlan(
        plan_id=plan_id(goal, attempt),
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
        tissue=tissue,
        goal=goal,
        attempt=attempt.number,
        attempts=attempt.of,
    )
