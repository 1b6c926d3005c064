"""What a miss tells of the constant error between where fingers are measured to be and where they are.

Had the fingers been where they were taken to be, the grasp would have held with some probability P; so offsets h at
which it would likely have missed gain weight: w ∝ N(h) · (ε + (1 − ε)(1 − P(h))), where ε is how often a grasp fails
for another reason. The weighted draws are put back together as one normal distribution, with which the next attempt is
planned. Where the reconstruction is so unsure that any offset would have missed, nothing is learned.
"""

import functools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.wedge import Offset, across_jaw, tool_covariance, unknown_offset, wedge_probability
from schemas.messages import Checked, GraspGoal, GraspPlan, Phase, Waypoint
from shared.kinematics.psm import FINGER_M

DRAWS, SEED = 2048, 20251122
OTHERWISE = 0.02
"""ε."""


def offset_of(plan: GraspPlan, config: PlannerConfig) -> Offset:
    """With which a plan was made."""
    if plan.offset_camera is None or plan.offset_covariance is None:
        return unknown_offset(config)
    return Offset(plan.offset_camera, plan.offset_covariance)


def after_miss(plan: GraspPlan, config: PlannerConfig) -> Offset:
    """What is known once a plan has missed."""
    prior = offset_of(plan, config)
    if plan.around is None or not plan.waypoints:
        return prior
    root = np.linalg.cholesky(prior.covariance + 1e-14 * np.eye(3))
    drawn = prior.mean_camera + _normals() @ root.T
    # the plan was aimed so that the fingers would be right with what was known before
    off = drawn - prior.mean_camera
    held = np.min([_held(off, plan, *stand, config) for stand in _stands(plan, config)], axis=0)
    weight = OTHERWISE + (1.0 - OTHERWISE) * (1.0 - held)
    weight = weight / weight.sum()
    mean = weight @ drawn
    off = drawn - mean
    return Offset(mean, (off * weight[:, None]).T @ off)


def _stands(plan: GraspPlan, config: PlannerConfig) -> list[tuple[Waypoint, float, float]]:
    """Where the thread had to be between the fingers: waypoint, opening, and by how much it gives way."""
    captured = next(waypoint for waypoint in plan.waypoints if waypoint.phase is Phase.CAPTURE)
    opened = max(waypoint.jaw_rad for waypoint in plan.waypoints)
    slid = [waypoint for waypoint in plan.waypoints if waypoint.phase is Phase.SLIDE]
    stands = [(captured, opened, 0.0)]
    return stands + [(waypoint, waypoint.jaw_rad, config.give_m) for waypoint in (captured, *slid[-1:]) if slid]


def _held(
    off: Float64[np.ndarray, "m 3"],
    plan: GraspPlan,
    waypoint: Waypoint,
    opening_rad: float,
    give_m: float,
    config: PlannerConfig,
) -> Float64[np.ndarray, "m"]:
    """How likely the thread was between the fingers there, had they been off by so much."""
    assert plan.around is not None  # noqa: S101 - looked at before
    nearest = int(np.argmin(np.abs(plan.around.s - (waypoint.s or 0.0))))
    R = waypoint.T_camera_tool[:3, :3]
    covariance = plan.around.covariance[nearest] + tool_covariance(config)
    across = across_jaw(R, covariance)
    mean = np.array([0.0, FINGER_M - (plan.depth_m or 0.0)]) - off @ R[:, 1:]
    return wedge_probability(mean, np.broadcast_to(across, (len(off), 2, 2)), opening_rad, give_m)


@functools.cache
def _normals() -> Float64[np.ndarray, "m 3"]:
    drawn = np.random.default_rng(SEED).standard_normal((DRAWS // 2, 3))
    return np.concatenate((drawn, -drawn))


@dataclass(frozen=True)
class Attempt:
    """One of several.

    Fields:
        offset: what is known of the fingers; None where nothing was learned yet.
    """

    number: int
    of: int
    offset: Offset | None = None


def first_attempt(goal: GraspGoal, config: PlannerConfig) -> Attempt:
    """The first one at a goal."""
    return Attempt(1, goal.attempts or config.attempts)


def next_attempt(plan: GraspPlan, verdict: Checked, config: PlannerConfig) -> Attempt | None:
    """After a plan that missed, or may have; None where it was the last, or its goal is not known."""
    if plan.goal is None or plan.attempt >= plan.attempts:
        return None
    # what cannot be told teaches nothing
    offset = after_miss(plan, config) if verdict is Checked.MISSED else offset_of(plan, config)
    return Attempt(plan.attempt + 1, plan.attempts, offset)


def same_attempt(plan: GraspPlan, config: PlannerConfig) -> Attempt:
    """The attempt that a plan is, to be gone on with from where the arm is now."""
    return Attempt(plan.attempt, plan.attempts, offset_of(plan, config))


def offset_for(attempt: Attempt, config: PlannerConfig) -> Offset:
    """Of the fingers, as far as it is known."""
    return attempt.offset or unknown_offset(config)


def plan_id(goal: GraspGoal, attempt: Attempt) -> str:
    """The name of a plan for a goal, of which there is one for each attempt."""
    return f"plan-{goal.header.id}" + (f"-{attempt.number}" if attempt.number > 1 else "")
