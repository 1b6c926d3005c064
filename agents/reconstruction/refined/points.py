"""The points of both centrelines that are looked at to follow a curve, with what does not depend on where it is."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from agents.reconstruction.refined.projection import chords
from agents.reconstruction.refined.sightings import CORRELATED_PX
from schemas.messages import Centrelines, RectifiedStereo

DIRECTION_REACH = 2
"""Points to either side, some two pixels apart."""
BORDER_PX = 4.0
"""What ends nearer to the image's border than this goes on outside."""


@dataclass(frozen=True)
class Points:
    """Some points of both centrelines, those of the left image first, each in the order of its centreline.

    Fields:
        deviation_px: for points that err independently.
        direction: at twice its angle, as a vector of length 1.
        piece: numbered through both images.
        is_end: whether a piece ends there, away from the image's border.
        lefts: how many of them are the left image's.
        all_px: the whole centrelines.
        width_px: of the thread in the left image, in the median; 0 where there is none.
        raised: by which factor deviations are more than perception states, since neighbours err together.
    """

    point_px: Float64[np.ndarray, "n 2"]
    deviation_px: Float64[np.ndarray, "n"]
    direction: Float64[np.ndarray, "n 2"]
    piece: Int64[np.ndarray, "n"]
    is_end: Bool[np.ndarray, "n"]
    lefts: int
    all_px: tuple[Float64[np.ndarray, "k 2"], Float64[np.ndarray, "l 2"]]
    width_px: float
    raised: Float64[np.ndarray, "n"]

    def of_eye(self, eye: int) -> slice:
        """The points of one image."""
        return slice(self.lefts) if eye == 0 else slice(self.lefts, None)


def chosen_points(lines: tuple[Centrelines, Centrelines], camera: RectifiedStereo, wanted: int) -> Points:
    """About so many points of each centreline, spread over all pieces, the ends of each among them."""
    left, right = lines
    all_px, split = np.concatenate((left.point_px, right.point_px)), len(left.piece)
    bound = np.ones(len(all_px) + 1, bool)
    bound[1:split], bound[split + 1 : -1] = np.diff(left.piece) != 0, np.diff(right.piece) != 0
    is_bound = bound[:-1] | bound[1:]
    chosen = is_bound.copy()
    for of_eye in (chosen[:split], chosen[split:]):
        of_eye[:: max(1, -(-len(of_eye) // wanted))] = True
    index = np.flatnonzero(chosen)
    points, lefts = all_px[index], int(np.count_nonzero(chosen[:split]))
    border = np.array([camera.image_width, camera.image_height]) - 1 - BORDER_PX
    inside = ((points >= BORDER_PX) & (points <= border)).all(axis=1)
    bounds = np.flatnonzero(bound)
    own = np.searchsorted(bounds, index, side="right")
    raised = np.repeat((_raised(points[:lefts]), _raised(points[lefts:])), (lefts, len(index) - lefts))
    return Points(
        points,
        np.concatenate((left.deviation_px, right.deviation_px))[index] * raised,
        double_angle(_directions(all_px, bounds, own, index)),
        own,
        is_bound[index] & inside,
        lefts,
        (left.point_px, right.point_px),
        float(np.median(left.width_px)) if split else 0.0,
        raised,
    )


def _raised(points: Float64[np.ndarray, "n 2"]) -> float:
    """The factor for points that lie so near to each other."""
    spacing = max(1.0, float(np.median(chords(points)))) if len(points) > 1 else 1.0
    return float(np.sqrt(max(1.0, CORRELATED_PX / spacing)))


def double_angle(direction: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    """The same for opposite directions, and opposite for directions at a right angle; of length 1."""
    u, v = direction.T
    square = np.maximum(u * u + v * v, 1e-18)
    return np.column_stack(((u * u - v * v) / square, 2 * u * v / square))


def _directions(
    points: Float64[np.ndarray, "k 2"],
    bounds: Int64[np.ndarray, "p"],
    own: Int64[np.ndarray, "n"],
    index: Int64[np.ndarray, "n"],
) -> Float64[np.ndarray, "n 2"]:
    """From some points before each to some after it, on the same piece, which ends at the bound of number `own`."""
    low = np.maximum(index - DIRECTION_REACH, bounds[own - 1])
    high = np.minimum(index + DIRECTION_REACH, bounds[own] - 1)
    return points[high] - points[low]
