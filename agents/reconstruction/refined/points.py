"""The points of a centreline that are looked at to follow a curve, with what does not depend on where the curve is."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from agents.reconstruction.refined.medians import median
from agents.reconstruction.refined.projection import chords
from agents.reconstruction.refined.sightings import CORRELATED_PX
from schemas.messages import Centrelines, RectifiedStereo

DIRECTION_REACH = 4
BORDER_PX = 4.0
"""What ends nearer to the image's border than this goes on outside."""


@dataclass(frozen=True)
class Points:
    """Some points of a centreline, in its order.

    Fields:
        deviation_px: for points that err independently.
        direction: at twice its angle, as a vector of length 1.
        is_end: whether a piece ends there, away from the image's border.
        all_px: the whole centreline.
        width_px: of the thread, in the median; 0 where there is none.
        raised: by which factor deviations are more than perception states, since neighbours err together.
    """

    point_px: Float64[np.ndarray, "n 2"]
    deviation_px: Float64[np.ndarray, "n"]
    direction: Float64[np.ndarray, "n 2"]
    piece: Int64[np.ndarray, "n"]
    is_end: Bool[np.ndarray, "n"]
    all_px: Float64[np.ndarray, "k 2"]
    width_px: float
    raised: float


def chosen_points(lines: Centrelines, camera: RectifiedStereo, wanted: int) -> Points:
    """About so many points of a centreline, spread over all pieces, the ends of each among them."""
    bound = np.ones(len(lines.piece) + 1, bool)
    bound[1:-1] = lines.piece[1:] != lines.piece[:-1]
    is_bound = bound[:-1] | bound[1:]
    chosen = is_bound.copy()
    chosen[:: max(2, -(-len(chosen) // wanted))] = True
    index = np.flatnonzero(chosen)
    points = lines.point_px[index]
    spacing = max(1.0, median(chords(points))) if len(points) > 1 else 1.0
    border = np.array([camera.image_width, camera.image_height]) - 1 - BORDER_PX
    raised = float(np.sqrt(max(1.0, CORRELATED_PX / spacing)))
    inside = ((points >= BORDER_PX) & (points <= border)).all(axis=1)
    return Points(
        points,
        lines.deviation_px[index] * raised,
        double_angle(_directions(lines.point_px, np.flatnonzero(bound), index)),
        lines.piece[index],
        is_bound[index] & inside,
        lines.point_px,
        median(lines.width_px) if len(lines.width_px) else 0.0,
        raised,
    )


def double_angle(direction: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    """The same for opposite directions, and opposite for directions at a right angle; of length 1."""
    u, v = direction.T
    square = np.maximum(u * u + v * v, 1e-18)
    return np.column_stack(((u * u - v * v) / square, 2 * u * v / square))


def _directions(
    points: Float64[np.ndarray, "k 2"], bounds: Int64[np.ndarray, "p"], index: Int64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n 2"]:
    """From some points before each to some after it, on the same piece; pieces lie between successive bounds."""
    own = np.searchsorted(bounds, index, side="right")
    low = np.maximum(index - DIRECTION_REACH, bounds[own - 1])
    high = np.minimum(index + DIRECTION_REACH, bounds[own] - 1)
    return points[high] - points[low]
