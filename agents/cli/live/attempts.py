"""What a planner's own check says of a grasp that was carried out, and the plan for the next attempt."""

import contextlib
from collections.abc import Generator

from agents.operator.operator import Events, events_of
from schemas.messages import GraspCheck, GraspPlan, Status
from schemas.topics import CHECK, PLAN
from shared.clock import monotonic_s
from shared.runtime.connection import Connection

CHECK_S, NEXT_PLAN_S = 5.0, 2.0
"""How long a check may take after the end of a grasp: the planner waits 2 s for a frame that tells."""


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
        deadline_s = monotonic_s() + CHECK_S
        while (left_s := deadline_s - monotonic_s()) > 0:
            check = self._checks.next(left_s)
            if isinstance(check, GraspCheck) and check.plan_id == plan_id:
                return check
        return None

    def plan_after(self, check: GraspCheck | None) -> GraspPlan | None:
        """The plan that follows from a check; None where there is none, or it is a rejection."""
        if check is None or not check.next_plan_id:
            return None
        deadline_s = monotonic_s() + NEXT_PLAN_S
        while (left_s := deadline_s - monotonic_s()) > 0:
            plan = self._plans.next(left_s)
            if isinstance(plan, GraspPlan) and plan.plan_id == check.next_plan_id:
                return plan if plan.status is Status.OK else None
        return None
