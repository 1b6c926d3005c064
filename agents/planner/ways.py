"""The ways to hold the tool along the thread, and which of them an arm can go from each capture to the goal.

There are four: the approach follows the viewing ray or the ray from the instrument's base, and the jaws have two sides.
Where tissue is known there are more: the approach along the viewing ray turned about the thread, either way. A slide
keeps to one of them all along, so that the tool neither flips nor swings from one plane to the other while the thread
is between its fingers.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from agents.planner.config import PlannerConfig
from agents.planner.poses import approach_directions, tool_poses, tool_rotations, turn_between

UNTILTED = 2
"""The first of the approaches are the viewing ray and the ray from the base."""
Reachable = Callable[[Float64[np.ndarray, "n 4 4"]], Bool[np.ndarray, "n"]]
"""Whether an arm can bring its tool to each `T_camera_tool`."""


@dataclass(frozen=True)
class Ways:
    """Poses at each sample, for each ray (viewing, base, and the viewing ray turned about the thread by each tilt) and
    each side of the jaws (z along the tangent, against it).

    Fields:
        on_thread: `T_camera_tool` with the thread between the fingers.
        standoff, lifted: the same before the approach and after the grasp.
        clear: whether the ray stands clear of the thread's tangent.
        steady: whether the tool turns little enough from each sample to the next.
    """

    on_thread: Float64[np.ndarray, "w 2 n 4 4"]
    standoff: Float64[np.ndarray, "w 2 n 4 4"]
    lifted: Float64[np.ndarray, "w 2 n 4 4"]
    clear: Bool[np.ndarray, "w n"]
    steady: Bool[np.ndarray, "w n_less_1"]


def ways_along(
    points_camera: Float64[np.ndarray, "n 3"],
    tangents: Float64[np.ndarray, "n 3"],
    base_camera: Float64[np.ndarray, "3"],
    config: PlannerConfig,
    tilts_deg: tuple[float, ...] = (),
) -> Ways:
    """All ways to hold the tool at samples of the thread, for an instrument whose base is there.

    Args:
        tilts_deg: by how much the approach along the viewing ray is turned about the thread, either way.
    """
    rays = np.stack((points_camera, points_camera - base_camera))
    untilted, angle = approach_directions(rays, tangents[None])
    turns = np.radians([turn for tilt in tilts_deg for turn in (tilt, -tilt)])
    approach = np.concatenate((untilted, turned(untilted[0], tangents, turns)))
    sides = np.stack((tangents, -tangents))
    shape = (len(approach), 2, *tangents.shape)
    R = tool_rotations(np.broadcast_to(approach[:, None], shape), np.broadcast_to(sides, shape))
    angle = np.concatenate((angle, np.broadcast_to(angle[0], (len(turns), len(tangents)))))
    least = np.radians([config.clear_deg, config.base_clear_deg, *[config.clear_deg] * len(turns)])
    return Ways(
        on_thread=tool_poses(points_camera, R, config.setback_m),
        standoff=tool_poses(points_camera, R, config.setback_m + config.standoff_m),
        lifted=tool_poses(points_camera, R, config.setback_m + config.retreat_m),
        clear=angle >= least[:, None],
        steady=turn_between(R[:, 0, :-1], R[:, 0, 1:]) <= np.radians(config.turn_deg),
    )


def turned(
    approach: Float64[np.ndarray, "n 3"], tangents: Float64[np.ndarray, "n 3"], turns_rad: Float64[np.ndarray, "t"]
) -> Float64[np.ndarray, "t n 3"]:
    """Directions across the thread, turned about it."""
    turns = turns_rad[:, None, None]
    return np.cos(turns) * approach + np.sin(turns) * np.cross(tangents, approach)


def reached(ways: Ways, goal: int, reachable: Reachable) -> Bool[np.ndarray, "w 2 n"]:
    """Whether the arm can approach each sample, slide from there to the goal, and lift off, in each way."""
    count, _, n, *_ = ways.on_thread.shape
    asked = np.concatenate((ways.on_thread, ways.standoff, ways.lifted[:, :, goal : goal + 1]), axis=2)
    answer = np.asarray(reachable(asked.reshape(-1, 4, 4)), dtype=bool).reshape(count, 2, 2 * n + 1)
    return along_slide(answer[..., :n], goal) & answer[..., n : 2 * n] & answer[..., 2 * n :]


def along_slide(holds: Bool[np.ndarray, "*w n"], goal: int) -> Bool[np.ndarray, "*w n"]:
    """Whether something holds at every sample from each one to the goal, both included."""
    after = np.logical_and.accumulate(holds[..., goal:], axis=-1)
    before = np.logical_and.accumulate(holds[..., goal::-1], axis=-1)[..., ::-1]
    return np.concatenate((before[..., :-1], after), axis=-1)


def steps_along_slide(holds: Bool[np.ndarray, "*w n_less_1"], goal: int) -> Bool[np.ndarray, "*w n"]:
    """Whether something holds at every step between samples from each sample to the goal."""
    at_goal = np.ones((*holds.shape[:-1], 1), dtype=bool)
    return along_slide(np.concatenate((holds[..., :goal], at_goal, holds[..., goal:]), axis=-1), goal)
