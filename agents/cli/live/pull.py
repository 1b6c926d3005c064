"""Thread pulled through tissue until its tail is so long: ask for it, and stand by it."""

import math
import shlex
import threading

import numpy as np

from agents.cli.live.options import ArmPlan, PullThread
from agents.configuration.rig import RigConfig
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE
from agents.operator.operator import Events, arm_and_stand_by, ask_for_pull, events_of
from schemas.messages import ExecutionEvent, ExecutionKind, GraspPlan, Outcome, PullBounds, PullStop, Status
from schemas.topics import PLAN
from shared.execution_words import event_told
from shared.runtime.connection import connected
from shared.terminal import complain, say

EXIT_REFUSED = 3
MM = 1e3
AS_ASKED = (PullStop.REACHED, PullStop.LET_GO)
PLANS_S = 0.05
"""How long a plan that is on its way is waited for, before the event that followed it is told."""


def pull(rig: RigConfig, options: PullThread) -> int:
    """Ask for a pull and print its first segment with the bounds that it needs, or why there is none."""
    tail_mm = options.tail_mm
    if (tail_mm is None) != options.release:
        return complain("give one of --tail-mm and --release", EXIT_UNUSABLE)
    if tail_mm is not None and not 0 < tail_mm < math.inf:
        return complain(f"--tail-mm {tail_mm:g} is no length of thread", EXIT_UNUSABLE)
    exit_pixel = None if options.exit_pixel is None else np.array(options.exit_pixel)
    with connected(rig.session) as connection:
        answer, plan = ask_for_pull(connection, options.arm, None if tail_mm is None else tail_mm / MM, exit_pixel)
    if answer.outcome is not Outcome.ACCEPTED:
        return complain(answer.reason, EXIT_REFUSED)
    if plan is None:
        return complain("the goal was accepted and no plan followed; look at the planner's log", EXIT_REFUSED)
    if plan.status is not Status.OK or plan.pull is None:
        return complain(plan.reason, EXIT_REFUSED)
    say(f"plan {plan.plan_id}: {plan.pull.sentence}")
    config = f" --config {shlex.quote(str(options.config))}" if options.config is not None else ""
    say(f"to carry it out: suturegrasp arm {plan.plan_id} --arm {plan.arm}{_bounds_option(plan.pull.bounds)}{config}")
    return EXIT_OK


def _bounds_option(bounds: PullBounds | None) -> str:
    if bounds is None:
        return ""
    length = f"--pull-mm {MM * bounds.length_m:.0f} --pull-seconds {bounds.time_s:.0f}"
    return f" {length} --pull-within-mm {MM * bounds.radius_m:.0f}"


def stand_by_pull(rig: RigConfig, options: ArmPlan, stopped: threading.Event) -> int:
    """Arm a pull with all its segments, and stay with it until it ends."""
    length_mm, time_s, radius_mm = options.pull_mm, options.pull_seconds, options.pull_within_mm
    if length_mm is None or time_s is None or radius_mm is None:
        return complain("a pull is armed with --pull-mm, --pull-seconds and --pull-within-mm together", EXIT_UNUSABLE)
    if not all(0 < bound < math.inf for bound in (length_mm, time_s, radius_mm)):
        return complain("the bounds of a pull must be positive", EXIT_UNUSABLE)
    bounds = PullBounds(length_mm / MM, time_s, radius_mm / MM)
    with connected(rig.session) as connection, events_of(connection, PLAN) as plans:
        told = _Told(options.arm, plans)
        stood = arm_and_stand_by(connection, options.arm, options.plan, stopped, told.event, bounds)
    if stood.answer.outcome is not Outcome.ACCEPTED:
        return complain(stood.answer.reason, EXIT_REFUSED)
    if stood.end is None:
        return complain(stood.left, EXIT_REFUSED)
    as_asked = stood.end.kind is ExecutionKind.FINISHED and told.stop in AS_ASKED
    return EXIT_OK if as_asked else EXIT_REFUSED


class _Told:
    """Events of a pull as they come, and between them what the planner says of each further segment.

    Fields:
        stop: why the pull ended; None while it has not.
    """

    def __init__(self, arm: str, plans: Events) -> None:
        self._arm, self._plans = arm, plans
        self.stop: PullStop | None = None

    def event(self, event: ExecutionEvent) -> None:
        """Tell an event, after the plans that came before it."""
        while (plan := self._plans.next(PLANS_S)) is not None:
            if isinstance(plan, GraspPlan) and plan.arm == self._arm and plan.pull is not None and plan.continues:
                self.stop = plan.pull.stop
                why = f"{plan.pull.stop.name.lower()}: " if plan.pull.stop is not None else ""
                say(f"{self._arm}: {why}{plan.pull.sentence}")
        say(event_told(event))
