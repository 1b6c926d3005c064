"""The rest of a plan after its lift: sideways, so that it can be told whether the thread is held.

Jaws come along the viewing ray and lift back along it, and depth is what stereo sees least of, least of all on thread
that runs along the rows. Across both, in the image, the same way shows as fifty pixels. However well the thread is
known before the grasp, the frame after it may tell less; so every plan goes on sideways by `aside_m`, on the side where
the instrument keeps clearer of the rest of the thread. First the jaws lift until their tips are clear of a thread that
they do not hold, which they would push along otherwise. Jaws may press into tissue a little to grasp, but they are not
dragged along in it: where a fold stands beside the thread they go to the other side, and where folds stand on both
sides they only lift.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from agents.planner.captures import ArmView
from agents.planner.clear_way import ClearWay
from agents.planner.config import PlannerConfig
from agents.planner.curve import ThreadCurve
from agents.planner.entanglement import thread_clearance
from agents.planner.jaws import aside_pass, nearest_to_tissue
from agents.planner.moved import axes_across
from agents.planner.needle import NeedleAround
from agents.planner.tissue_clearance import SeenTissue
from schemas.messages import Phase, Waypoint

STEPS = 6
"""At so many places of the way to the side the jaws are looked at, the first of them where they have lifted."""
NOWHERE = np.zeros((0, 4, 4))
"""No poses."""


def with_aside(
    led: ClearWay,
    s_goal: float,
    curve: ThreadCurve,
    arm: ArmView,
    config: PlannerConfig,
    tissue: SeenTissue,
    needle: NeedleAround | None = None,
    beside: Float64[np.ndarray, "k 3"] | None = None,
) -> ClearWay:
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
        replace(led, waypoints=side, thread=thread_clearance(curve, side, arm.T_camera_base, config, needle, beside))
        for side, end in zip(sides, ends, strict=True)
        if np.all(arm.reachable(end)) and _before_tissue(end, tissue, config)
    ]
    clear = [way for way in found if not way.thread.obstructed or led.thread.obstructed]
    return max(clear, key=_clearance_m, default=led)


def aside_of(led: ClearWay) -> Float64[np.ndarray, "k 4 4"]:
    """Poses on the way to the side; none where a way ends with its lift."""
    end = [waypoint.T_camera_tool for waypoint in led.waypoints if waypoint.phase is Phase.RETREAT]
    return _poses_between(np.stack(end)) if len(end) > 1 else NOWHERE


def _aside(
    led: ClearWay, grasped: Float64[np.ndarray, "4 4"], back_m: float, by_m: Float64[np.ndarray, "3"]
) -> tuple[Waypoint, ...]:
    lifted, beside = grasped.copy(), grasped.copy()
    lifted[:3, 3] -= back_m * grasped[:3, 2]
    beside[:3, 3] = lifted[:3, 3] + by_m
    last = led.waypoints[-1]
    return (*led.waypoints[:-1], replace(last, T_camera_tool=lifted), replace(last, T_camera_tool=beside))


def _before_tissue(end: Float64[np.ndarray, "2 4 4"], tissue: SeenTissue, config: PlannerConfig) -> bool:
    """Whether closed jaws stay before the tissue from one pose to the other, and it is known where it has to be."""
    if tissue.tissue is None:
        return True
    near = nearest_to_tissue(tissue.tissue, _poses_between(end), aside_pass(config), config)
    return bool((near.bound_m >= 0).all()) and (bool((near.known == 1).all()) or not config.tissue_required)


def _poses_between(end: Float64[np.ndarray, "2 4 4"]) -> Float64[np.ndarray, "k 4 4"]:
    """From one pose straight to another of the same attitude."""
    poses = np.repeat(end[:1], STEPS, axis=0)
    poses[:, :3, 3] += np.linspace(0.0, 1.0, STEPS)[:, None] * (end[1] - end[0])[:3, 3]
    return poses


def _clearance_m(way: ClearWay) -> float:
    return np.inf if way.thread.clearance_m is None else way.thread.clearance_m
