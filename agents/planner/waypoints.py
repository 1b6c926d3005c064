"""The waypoints of a grasp, phase by phase."""

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.ways import Ways
from schemas.messages import Phase, Waypoint


def waypoints(
    ways: Ways, way: tuple[int, int], s: Float64[np.ndarray, "n"], capture: int, goal: int, config: PlannerConfig
) -> tuple[Waypoint, ...]:
    """From before the capture to after the grasp.

    The jaws stay open until the thread is between them, close partly there, so that the thread can slide but not
    leave, and close at the goal.
    """
    opened, partly, closed = np.radians([config.open_deg, config.slide_deg, config.closed_deg])
    ray, side = way

    def on_thread(i: int, jaw_rad: float, phase: Phase) -> Waypoint:
        return Waypoint(ways.on_thread[ray, side, i], float(jaw_rad), phase, float(s[i]))

    step = 1 if goal > capture else -1
    slide = range(capture + step, goal + step, step) if goal != capture else ()
    return (
        Waypoint(ways.standoff[ray, side, capture], float(opened), Phase.APPROACH, None),
        on_thread(capture, opened, Phase.APPROACH),
        on_thread(capture, partly, Phase.CAPTURE),
        *(on_thread(i, partly, Phase.SLIDE) for i in slide),
        on_thread(goal, closed, Phase.GRASP),
        Waypoint(ways.lifted[ray, side, goal], float(closed), Phase.RETREAT, None),
    )
