"""The how many-th attempt at a goal a plan is, and what earlier ones have told."""

from dataclasses import dataclass

from agents.planner.config import PlannerConfig
from agents.planner.errors import Offset, unknown_offset
from agents.planner.learning import after_miss
from schemas.messages import GraspGoal, GraspPlan


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


def next_attempt(missed: GraspPlan, config: PlannerConfig) -> Attempt | None:
    """After a plan that missed; None where it was the last, or its goal is not known."""
    if missed.goal is None or missed.attempt >= missed.attempts:
        return None
    return Attempt(missed.attempt + 1, missed.attempts, after_miss(missed, config))


def offset_for(attempt: Attempt, config: PlannerConfig) -> Offset:
    """Of the fingers, as far as it is known."""
    return attempt.offset or unknown_offset(config)


def plan_id(goal: GraspGoal, attempt: Attempt) -> str:
    """The name of a plan for a goal, of which there is one for each attempt."""
    return f"plan-{goal.header.id}" + (f"-{attempt.number}" if attempt.number > 1 else "")
