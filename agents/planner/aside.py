"""The rest of a plan after its lift: sideways, where the lift alone would not tell whether the thread is held.

Jaws come along the viewing ray and lift back along it, and depth is what stereo sees least of, least of all on thread
that runs along the rows. Across both, in the image, the same way shows as fifty pixels. So where a lift as long as the
plan's is expected to leave the check undecided (by thread that is
1.5 deviations short of what is held, or beyond what was missed), the
jaws go on sideways by `aside_m`, the side on which the instrument keeps clearer of the rest of the thread. First they
lift until their tips are clear of a thread that they do not hold, which they would push along otherwise.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from agents.planner.captures import ArmView
from agents.planner.check import held_probability
from agents.planner.clear_way import ClearWay
from agents.planner.config import PlannerConfig
from agents.planner.curve import ThreadCurve
from agents.planner.entanglement import thread_clearance
from agents.planner.moved import Motion, axes_across
from schemas.messages import Waypoint

TO_SPARE = 1.5


def with_aside(
    led: ClearWay,
    s_goal: float,
    covariance: Float64[np.ndarray, "3 3"],
    curve: ThreadCurve,
    arm: ArmView,
    config: PlannerConfig,
) -> ClearWay:
    """The same way, and sideways where that is needed and possible.

    Args:
        covariance: of the goal on the thread, in m².
        config: with the plan's depth.
    """
    goal = np.array([s_goal])
    axes = axes_across(curve.tangents(goal)[0], curve.points(goal)[0])
    grasped, lifted = (waypoint.T_camera_tool for waypoint in led.waypoints[-2:])
    if config.aside_m == 0 or decides(lifted[:3, 3] - grasped[:3, 3], axes, grasped[:3, 1], covariance, config):
        return led
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


def decides(
    tool_moved: Float64[np.ndarray, "3"],
    axes: Float64[np.ndarray, "2 3"],
    opens: Float64[np.ndarray, "3"],
    covariance: Float64[np.ndarray, "3 3"],
    config: PlannerConfig,
) -> bool:
    """Whether a check after such a motion is expected to say held or missed, with some deviations to spare."""
    tool = axes @ tool_moved
    # of the frame before and of the one after
    told = 2.0 * axes @ covariance @ axes.T
    way = tool / max(float(np.linalg.norm(tool)), 1e-9)
    short = TO_SPARE * float(np.sqrt(way @ told @ way + config.settle_m**2)) * way
    held, missed = (
        held_probability(Motion(tool, thread, told, axes), opens, config) for thread in (tool - short, short)
    )
    return held >= config.sure and missed <= 1.0 - config.sure


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
