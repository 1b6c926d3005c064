"""The way of closed jaws that pull the standing strand away from its entry, clear of all else.

From where they grasped, the jaws lift back along their fingers, and then go straight on: away from the entry, up from
the tissue by some angle, and to one side of that by another. Of these ways the one on which the jaws get farthest from
the entry is taken, of equals the one with the least turns. Along it the tool keeps its attitude. It is followed in
steps of a millimetre until it is not reachable, would take the jaws out of the view of an eye, beyond the bounds, or
nearer to the entry again, brings fingers, wrist or shaft too near to thread, needle or another instrument, or closed
fingers to the tissue.

What does not count as thread in the way is what the jaws hold, and the loose strand behind them that they take along.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from agents.planner.captures import ArmView
from agents.planner.config import PlannerConfig
from agents.planner.curve import unit_vectors
from agents.planner.jaws import SHAFT_M, SHAFT_RADIUS_M, aside_pass, clearances, instrument_at, nearest_to_tissue
from agents.planner.needle import NeedleAround
from agents.planner.pulling.strands import Strands, inside
from agents.planner.tissue_clearance import SeenTissue
from shared.kinematics.psm import FINGER_M

STEP_M, POINTS = 0.001, 400
RISES_DEG, TURNS_DEG = (30.0, 45.0, 15.0, 60.0), (0.0, 30.0, -30.0, 60.0, -60.0)
BETTER_M = 0.002
"""By how much farther a way must lead to be taken instead of one that turns less."""


@dataclass(frozen=True)
class Around:
    """What a pull must keep clear of, beside the thread.

    Fields:
        instruments: of the other arms, places along the axis of each tool in the camera frame.
    """

    tissue: SeenTissue
    needle: NeedleAround | None = None
    instruments: Sequence[Float64[np.ndarray, "k 3"]] = ()


@dataclass(frozen=True)
class Situation:
    """What a segment of a pull is planned in: the thread as it is seen, the arm, and what is around both."""

    strands: Strands
    arm: ArmView
    config: PlannerConfig
    around: Around

    @property
    def entry_camera(self) -> Float64[np.ndarray, "3"]:
        """Where the standing strand goes into the tissue."""
        return self.strands.entry.point_camera


def jaw_of(T_camera_tool: Float64[np.ndarray, "*n 4 4"], depth_m: float) -> Float64[np.ndarray, "*n 3"]:
    """Where thread lies between closed fingers whose tips reach so far beyond it."""
    return T_camera_tool[..., :3, 3] + (FINGER_M - depth_m) * T_camera_tool[..., :3, 2]


def moved(
    T_camera_tool: Float64[np.ndarray, "4 4"], by_m: Float64[np.ndarray, "*n 3"]
) -> Float64[np.ndarray, "*n 4 4"]:
    """A pose, moved and not turned."""
    poses = np.broadcast_to(T_camera_tool, (*by_m.shape[:-1], 4, 4)).copy()
    poses[..., :3, 3] += by_m
    return poses


def clear_way_end(
    T_camera_tool: Float64[np.ndarray, "4 4"], depth_m: float, here: Situation
) -> Float64[np.ndarray, "3"] | None:
    """Where the best way from a grasp ends, as a place of the jaws after the lift; None where none leads anywhere."""
    start = moved(T_camera_tool, lift_of(T_camera_tool, depth_m, here.config))
    if not bool(np.all(here.arm.reachable(start[None]))):
        return None
    jaw, entry = jaw_of(start, depth_m), here.entry_camera
    best, best_m = None, BETTER_M
    for direction in _directions(jaw - entry, jaw):
        clear = clear_until(start, jaw + direction * here.config.pull_reach_m, depth_m, here)
        gained_m = _from(clear, entry) - _from(jaw, entry)
        if gained_m > best_m:
            best, best_m = clear, gained_m + BETTER_M
    return best


def lift_of(
    T_camera_tool: Float64[np.ndarray, "4 4"], depth_m: float, config: PlannerConfig
) -> Float64[np.ndarray, "3"]:
    """Back along the fingers until their tips are before where the thread lay."""
    return -(depth_m + config.aside_clear_m) * T_camera_tool[:3, 2]


def clear_until(
    T_camera_tool: Float64[np.ndarray, "4 4"], end_camera: Float64[np.ndarray, "3"], depth_m: float, here: Situation
) -> Float64[np.ndarray, "3"]:
    """How far the jaws can go straight towards a place from where they are: a place of theirs, theirs now at least."""
    jaw, entry = jaw_of(T_camera_tool, depth_m), here.entry_camera
    long_m = _from(end_camera, jaw)
    share = np.arange(1, int(long_m / STEP_M) + 1) * STEP_M / max(long_m, STEP_M)
    if not len(share):
        return jaw
    poses = moved(T_camera_tool, share[:, None] * (end_camera - jaw))
    jaws = jaw_of(poses, depth_m)
    off_m = np.linalg.norm(jaws - entry, axis=1)
    open_ = (off_m <= here.config.pull_reach_m) & (np.diff(off_m, prepend=_from(jaw, entry)) >= 0)
    open_ &= inside(here.strands.line.curve, jaws)
    open_ &= np.asarray(here.arm.reachable(poses), bool) & _clear_of_all(poses, jaws, here)
    far = len(open_) if open_.all() else int(np.argmin(open_))
    return jaws[far - 1] if far else jaw


def _directions(away: Float64[np.ndarray, "3"], jaw_camera: Float64[np.ndarray, "3"]) -> list[Float64[np.ndarray, "3"]]:
    """From the entry along the strand, and up towards the camera."""
    up = -unit_vectors(jaw_camera)
    flat = unit_vectors(away - (away @ up) * up)
    side = np.cross(up, flat)
    turns, rises = np.radians(TURNS_DEG), np.radians(RISES_DEG)
    return [
        np.cos(rise) * (np.cos(turn) * flat + np.sin(turn) * side) + np.sin(rise) * up
        for turn in turns
        for rise in rises
    ]


def _clear_of_all(
    poses: Float64[np.ndarray, "k 4 4"], jaws: Float64[np.ndarray, "k 3"], here: Situation
) -> Bool[np.ndarray, "k"]:
    config, around = here.config, here.around
    closed = np.full(len(poses), np.radians(config.closed_deg))
    instrument = instrument_at(poses, closed, here.arm.T_camera_base)
    s = np.linspace(0.0, 1.0, POINTS)
    points = here.strands.line.curve.points(s)
    clear = np.ones(len(poses), bool)
    counts = np.concatenate((points[_counts(s, points, jaws[0], here)], here.strands.tail_points))
    if len(counts):
        clear &= clearances(instrument, counts).min(axis=1) >= config.thread_radius_m + config.thread_clear_m
    if around.needle is not None:
        off = clearances(instrument, around.needle.points_camera) - around.needle.reach_m
        clear &= off.min(axis=1) >= config.thread_clear_m
    for axis in around.instruments:
        clear &= clearances(instrument, axis).min(axis=1) >= SHAFT_RADIUS_M + config.thread_clear_m
    if around.tissue.tissue is not None:
        near = nearest_to_tissue(around.tissue.tissue, poses, aside_pass(config), config)
        clear &= (near.bound_m >= 0) & ((near.known == 1) | (not config.tissue_required))
    return clear


def _counts(
    s: Float64[np.ndarray, "n"],
    points: Float64[np.ndarray, "n 3"],
    jaw_camera: Float64[np.ndarray, "3"],
    here: Situation,
) -> Bool[np.ndarray, "n"]:
    """What thread is in the way: all but what is held, and the strand behind the jaws as far as they take it along."""
    if here.strands.standing is None:
        return np.ones(len(s), bool)
    entry, far = here.strands.standing
    standing = (s >= min(entry, far)) & (s <= max(entry, far))
    held = s[standing][np.argmin(np.linalg.norm(points[standing] - jaw_camera, axis=1))] if standing.any() else entry
    behind_m = (s - held) * here.strands.line.curve.length_m * (1.0 if far > entry else -1.0)
    with_jaws_m = here.config.grasp_arc_m
    return (behind_m < -with_jaws_m) | (behind_m > here.config.pull_reach_m + with_jaws_m)


def _from(a: Float64[np.ndarray, "3"], b: Float64[np.ndarray, "3"]) -> float:
    return float(np.linalg.norm(a - b))


def tool_places(axis: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "k 3"]:
    """Places a step apart along the axis of an instrument, from its tips as far as its shaft comes near the thread."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1)))
    at = np.arange(0.0, min(float(along[-1]), FINGER_M + SHAFT_M), STEP_M)
    return np.column_stack([np.interp(at, along, one) for one in axis.T])
