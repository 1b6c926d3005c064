"""Goals that are not planned for at all: what a plan would be made from is missing or old."""

import math
from collections.abc import Mapping

from agents.planner.config import PlannerConfig
from schemas.messages import (
    GraspGoal,
    HostClock,
    HostClocks,
    PullGoal,
    RobotMode,
    RobotState,
    ThreadReconstruction,
    TissueSurface,
    TrackStep,
)
from schemas.topics import FRAMES, SURFACE, THREAD

CLOCK_BOUND_MS = 100.0
"""How far the clock of the camera's host may be off: half of what a heartbeat may take."""


class RefusedGoalError(ValueError):
    """A goal cannot be planned for now: a stable code, and the reason with its remedy."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


def planned_from(
    goal: GraspGoal | PullGoal,
    thread: ThreadReconstruction | None,
    arms: Mapping[str, RobotState],
    now_ns: int,
    config: PlannerConfig,
    clocks: HostClocks | None = None,
) -> tuple[ThreadReconstruction, RobotState]:
    """The thread and the state of the arm that a goal can be planned from.

    Of clocks that nobody measured nothing is held against a goal.

    Raises:
        RefusedGoalError: where one of them is missing, too old, or of no use.
    """
    if arms:
        # of a name that is wrong nothing else need be told
        _reported(goal.arm, arms)
    if thread is not None:
        # a wrong clock makes a thread look old, or yet to come, and that says less
        _check_clocks(clocks)
    fresh = _fresh_thread(thread, now_ns)
    by_s = isinstance(goal, GraspGoal) and goal.s is not None
    if by_s and fresh.track is not None and fresh.track.step is TrackStep.RESTARTED:
        raise RefusedGoalError(
            "thread_restarted",
            "the thread was just found anew, so s may name another place than before; look again, or name a pixel or a "
            "point",
        )
    return fresh, _fresh_arm(goal.arm, arms, now_ns, config)


def clock_unknown(clocks: HostClocks | None) -> str:
    """What cannot be told of the clocks that frames are stamped by; empty where nothing is left open."""
    for clock in _of_cameras(clocks):
        if clock.ahead_ms is None or clock.within_ms is None:
            return f"the clock of the host of {clock.agent} {clock.instance} is unknown, for it gives no answer"
        if abs(clock.ahead_ms) + clock.within_ms > CLOCK_BOUND_MS:
            return (
                f"whether the clock of {clock.host} is within {CLOCK_BOUND_MS:.0f} ms of the planner's cannot be told, "
                f"for its answer takes {2 * clock.within_ms:.0f} ms"
            )
    return ""


def surface_unusable(surface: TissueSurface | None, thread: ThreadReconstruction, now_ns: int) -> str:
    """Why a plan for a thread cannot be checked against a surface; empty where it can."""
    if surface is None:
        return "perception has told of none yet"
    if surface.camera != thread.camera or surface.stamp.calibration_id != thread.stamp.calibration_id:
        return "it was seen with another calibration than the thread"
    if surface.deviation is None:
        return "perception does not tell how sure it is of it; update perception"
    age_ms = 1e-6 * (now_ns - min(surface.stamp.capture_left_ns, surface.stamp.capture_right_ns))
    oldest_ms = SURFACE.maximum_age_ms or math.inf
    if abs(age_ms) > oldest_ms:
        when = f"{age_ms:.0f} ms ago" if age_ms > 0 else f"{-age_ms:.0f} ms from now"
        return f"it was seen {when}, and at most {oldest_ms:.0f} ms are accepted"
    return "" if surface.valid.any() else "it has no texture that could be matched"


def _check_clocks(clocks: HostClocks | None) -> None:
    """Refuse frames of a host whose clock is out of bounds for certain."""
    for clock in _of_cameras(clocks):
        if clock.ahead_ms is None or clock.within_ms is None:
            continue
        if abs(clock.ahead_ms) - clock.within_ms > CLOCK_BOUND_MS:
            apart = f"{abs(clock.ahead_ms):.0f} ms {'ahead of' if clock.ahead_ms > 0 else 'behind'} the planner's"
            raise RefusedGoalError(
                "clock_out_of_bounds",
                f"the frames come from {clock.host}, whose clock is {apart} (within {clock.within_ms:.1f} ms), and at "
                f"most {CLOCK_BOUND_MS:.0f} ms are accepted; synchronise both hosts with chrony or PTP",
            )


def _of_cameras(clocks: HostClocks | None) -> tuple[HostClock, ...]:
    return tuple(c for c in clocks.clocks if c.agent == FRAMES.agent) if clocks is not None else ()


def _fresh_thread(thread: ThreadReconstruction | None, now_ns: int) -> ThreadReconstruction:
    if thread is None:
        raise RefusedGoalError(
            "no_thread", "no thread was reconstructed yet; are camera, perception and reconstruction running?"
        )
    seen_ns = min(thread.stamp.capture_left_ns, thread.stamp.capture_right_ns)
    age_ms, oldest_ms = 1e-6 * (now_ns - seen_ns), THREAD.maximum_age_ms or math.inf
    if age_ms > oldest_ms:
        raise RefusedGoalError(
            "thread_stale",
            f"the thread was seen {age_ms:.0f} ms ago, and at most {oldest_ms:.0f} ms are accepted; "
            "are camera, perception and reconstruction running, and as fast as that (suturegrasp status tells), and "
            "are the clocks of the hosts set?",
        )
    if age_ms < -oldest_ms:
        raise RefusedGoalError(
            "thread_from_future",
            f"the thread was seen {-age_ms:.0f} ms from now; set the clocks of the hosts, or, where a replay has just "
            "begun anew, ask again once it has shown the thread",
        )
    if thread.camera.metres_per_unit is None:
        raise RefusedGoalError("unit_unknown", "the unit of the calibration is unknown; give its metres_per_unit")
    return thread


def _reported(arm: str, arms: Mapping[str, RobotState]) -> RobotState:
    if arm not in arms:
        known = f"there are: {', '.join(sorted(arms))}" if arms else "there is none; is its bridge running?"
        raise RefusedGoalError("unknown_arm", f"no arm called {arm} has reported; {known}")
    return arms[arm]


def _fresh_arm(arm: str, arms: Mapping[str, RobotState], now_ns: int, config: PlannerConfig) -> RobotState:
    state = _reported(arm, arms)
    age_ms = 1e-6 * (now_ns - state.measured_ns)
    if abs(age_ms) > config.arm_age_ms:
        raise RefusedGoalError(
            "arm_stale",
            f"the last state of {arm} was measured {age_ms:.0f} ms ago, and at most {config.arm_age_ms:.0f} ms are "
            "accepted; is its bridge running, and are the clocks set?",
        )
    if state.mode is RobotMode.MOVING:
        # whoever stands by sees the newest plan
        raise RefusedGoalError("arm_moves", f"{arm} carries out plan {state.plan_id}: let it end, or say hold, first")
    return state
