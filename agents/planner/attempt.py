"""The how many-th attempt at a goal a plan is, and what earlier ones have told."""

from dataclasses import dataclass

from agents.planner.config import PlannerConfig
from agents.planner.errors import Offset, unknown_offset
from agents.planner.learning import after_miss, offset_of
from schemas.messages import Checked, GraspGoal, GraspPlan


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
