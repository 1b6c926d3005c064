"""The rest of a plan after its lift: sideways, so that it can be told whether the thread is held.

Jaws come along the viewing ray and lift back along it, and depth is what stereo sees least of, least of all on thread
that runs along the rows. Across both, in the image, the same way shows as fifty pixels. However well the thread is
known before the grasp, the frame after it may tell less; so every plan goes on sideways by `aside_m`, on the side where
the instrument keeps clearer of the rest of the thread. First the jaws lift until their tips are clear of a thread that
they do not hold, which they would push along otherwise.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from agents.planner.captures import ArmView
from agents.planner.clear_way import ClearWay
from agents.planner.config import PlannerConfig
from agents.planner.curve import ThreadCurve
from agents.planner.entanglement import thread_clearance
from agents.planner.moved import axes_across
from schemas.messages import Waypoint


def with_aside(led: ClearWay, s_goal: float, curve: ThreadCurve, arm: ArmView, config: PlannerConfig) -> ClearWay:
    """The same way, and sideways where that is asked for and possible.

    Args:
        config: with the plan's depth.
    """
    if config.aside_m == 0:
        return led
    goal = np.array([s_goal])
    axes = axes_across(curve.tangents(goal)[0], curve.points(goal)[0])
    grasped = led.waypoints[-2].T_camera_tool
    back = max(config.retreat_m, config.depth_m + config.aside_clear_m)
    sides = [_aside(led, grasped, back, side * config.aside_m * axes[1]) for side in (1.0, -1.0)]
    ends = [np.stack([waypoint.T_camera_tool for waypoint in side[-2:]]) for side in sides]
    found = [
        replace(led, waypoints=side, thread=thread_clearance(curve, side, arm.T_camera_base, config))
        for side, end in zip(sides, ends, strict=True)
        if np.all(arm.reachable(end))
    ]
    clear = [way for way in found if not way.thread.obstructed or led.thread.obstructed]
    return max(clear, key=_clearance_m, default=led)


def _aside(
    led: ClearWay, grasped: Float64[np.ndarray, "4 4"], back_m: float, by_m: Float64[np.ndarray, "3"]
) -> tuple[Waypoint, ...]:
    lifted, beside = grasped.copy(), grasped.copy()
    lifted[:3, 3] -= back_m * grasped[:3, 2]
    beside[:3, 3] = lifted[:3, 3] + by_m
    last = led.waypoints[-1]
    return (*led.waypoints[:-1], replace(last, T_camera_tool=lifted), replace(last, T_camera_tool=beside))


def _clearance_m(way: ClearWay) -> float:
    return np.inf if way.thread.clearance_m is None else way.thread.clearance_m
