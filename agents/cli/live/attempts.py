"""What a planner's own check says of a grasp that was carried out, and the plan for the next attempt."""

import contextlib
from collections.abc import Callable, Generator
from typing import TypeVar

from agents.operator.operator import Events, events_of
from schemas.messages import GraspCheck, GraspPlan, Status
from schemas.topics import CHECK, PLAN
from shared.clock import monotonic_s
from shared.runtime.connection import Connection

CHECK_S, NEXT_PLAN_S = 5.0, 2.0
"""How long a check may take after the end of a grasp: the planner waits 2 s for a frame that tells."""

Message = TypeVar("Message")


def awaited(events: Events, kind: type[Message], within_s: float, wanted: Callable[[Message], bool]) -> Message | None:
    """The next message that is wanted; None where none comes in time."""
    deadline_s = monotonic_s() + within_s
    while (left_s := deadline_s - monotonic_s()) > 0:
        message = events.next(left_s)
        if isinstance(message, kind) and wanted(message):
            return message
    return None


@contextlib.contextmanager
def attempts_on(connection: Connection) -> Generator["Attempts"]:
    """Checks and plans from now on, for as long as they are listened to: before anything is armed."""
    with events_of(connection, CHECK) as checks, events_of(connection, PLAN) as plans:
        yield Attempts(checks, plans)


class Attempts:
    """Checks and plans as they come."""

    def __init__(self, checks: Events, plans: Events) -> None:
        self._checks, self._plans = checks, plans

    def check_of(self, plan_id: str) -> GraspCheck | None:
        """What was seen after a plan; None where nothing comes."""
        return awaited(self._checks, GraspCheck, CHECK_S, lambda check: check.plan_id == plan_id)

    def plan_after(self, check: GraspCheck | None) -> GraspPlan | None:
        """The plan that follows from a check; None where there is none, or it is a rejection."""
        if check is None or not check.next_plan_id:
            return None
        plan = awaited(self._plans, GraspPlan, NEXT_PLAN_S, lambda plan: plan.plan_id == check.next_plan_id)
        return plan if plan is not None and plan.status is Status.OK else None
