"""How the two images of a rectified pair lie to each other, as far as their ground tells.

Of a place (u, v) of the left image and its counterpart (u', v') in the right one, the rows should be equal. What they
are instead is described by a plane,

    v' - v = -o + a (u - u0) + b (v - v0),

with (u0, v0) the middle of the image: o is a constant row offset, atan2(a, 1 + b) a rotation of one eye's image about
the line of sight, and 1 + b a magnification. The plane is found by random samples of three matches (Fischler and
Bolles 1981) among all of them, wherever they lie, so that an image upside down is a rotation by 180 degrees, and then
from matches followed to a fraction of a pixel, by the least median of squares (Rousseeuw 1984) and, from there, robust
least squares (Tukey's weights). Columns differ by a plane too, as far as depth lets them.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.perception.judging.features import Matched, followed, grey, matched_features

LEAST_MATCHES = 25
"""Fewer agreeing feature matches say nothing about an image."""
LEAST_AGREEING = 0.2
"""Of all matches: with fewer, the images show different things. Unrelated images stay below 0.1."""
SAMPLES = 300
NEAR_ROW_SHARE, COLUMNS_SHARE = 0.004, 0.06
"""Of the width: how close to a plane the rows and the columns of a match must be, before it is followed."""
LEAST_AREA = 0.1
"""Of an image in the other one, as a ratio; a mirrored one has a negative area."""
TURNED_DEG, MAGNIFIED = 3.0, 0.04
"""Beyond these, windows no longer look alike enough to be followed."""
ROUNDS = 8
TUKEY = 4.685
LEAST_SCALE_PX = 0.05
GROUP = 4.0
"""Matches that err together, as neighbours do: the deviation of a mean is that of so many times fewer."""


Plane = Float64[np.ndarray, "3"]


@dataclass(frozen=True)
class Correspondence:
    """How the two images lie to each other, as far as they tell; None where unknown.

    Fields:
        row_residual_px: left row minus right row of what corresponds, in the middle of the image.
        disparity_px: typical left minus right column.
        row_deviation_px: standard deviation of `row_residual_px`.
        rotation_deg: by which the right image is turned against the left one, clockwise as it is looked at.
        rotation_deviation_deg: its standard deviation.
        magnification: of the right image against the left one, in rows.
        magnification_deviation: its standard deviation.
        off_rows_px: the median distance in rows of what corresponds.
        scatter_px: the same once offset, rotation and magnification are taken out.
        nearest_px, farthest_px: disparities that 2 % of the places are beyond.
        behind_share: of the places, lies further left in the left image, by more than a pixel.
        from_right: the plane of left rows less right rows over places in the right image, about its middle.
        mirrored: whether one image is mirrored against the other.
        matches: how many places agree.
    """

    row_residual_px: float | None
    disparity_px: float | None
    row_deviation_px: float | None = None
    rotation_deg: float | None = None
    rotation_deviation_deg: float | None = None
    magnification: float | None = None
    magnification_deviation: float | None = None
    off_rows_px: float | None = None
    scatter_px: float | None = None
    nearest_px: float | None = None
    farthest_px: float | None = None
    behind_share: float = 0.0
    from_right: Plane | None = None
    mirrored: bool = False
    matches: int = 0


UNKNOWN = Correspondence(None, None)


def correspondence_of(
    left: UInt8[np.ndarray, "h w *c"],
    right: UInt8[np.ndarray, "h w *c"],
    thread_left: Bool[np.ndarray, "h w"],
    thread_right: Bool[np.ndarray, "h w"],
) -> Correspondence:
    """From the ground, and on one that shows nothing from the thread alone."""
    return correspondence_of_texture(left, right, thread_left, thread_right) or correspondence_of_masks(
        thread_left, thread_right
    )


def correspondence_of_texture(
    left: UInt8[np.ndarray, "h w *c"],
    right: UInt8[np.ndarray, "h w *c"],
    thread_left: Bool[np.ndarray, "h w"] | None = None,
    thread_right: Bool[np.ndarray, "h w"] | None = None,
) -> Correspondence | None:
    """From matched features of the ground, without the thread where it is known; None where too few agree."""
    left, right = grey(left), grey(right)
    matched = matched_features(left, right, thread_left, thread_right)
    if len(matched) < LEAST_MATCHES:
        return None
    if found := _of_matches(left, right, matched):
        return found
    # a mirrored image has the same features, each of them mirrored, which nothing matches
    other, covered = cv2.flip(right, 1), None if thread_right is None else thread_right[:, ::-1]
    found = _of_matches(left, other, matched_features(left, other, thread_left, covered))
    if found is None:
        return None
    return Correspondence(None, None, rotation_deg=found.rotation_deg, mirrored=True, matches=found.matches)


def _of_matches(left: np.ndarray, right: np.ndarray, matched: Matched) -> Correspondence | None:
    height, width = left.shape
    middle = np.array([width - 1, height - 1]) / 2
    agreeing = _near_one_plane(matched, middle, width)
    if agreeing.sum() < max(LEAST_MATCHES, LEAST_AGREEING * len(matched)):
        return None
    kept = matched.only(agreeing)
    plane, deviation, scatter = _robust_plane(kept, middle)
    if abs(_turned_deg(plane)) < TURNED_DEG and abs(_magnification(plane) - 1) < MAGNIFIED:
        fine = followed(left, right, kept)
        if len(fine) >= LEAST_MATCHES:
            kept = fine
            plane, deviation, scatter = _robust_plane(kept, middle)
    from_right, *_ = _robust_plane(kept.exchanged, middle)
    shift = kept.left - kept.right
    near, far = np.percentile(shift[:, 0], (98.0, 2.0))
    return Correspondence(
        row_residual_px=float(-plane[0]),
        disparity_px=float(np.median(shift[:, 0])),
        row_deviation_px=float(deviation[0]),
        rotation_deg=_turned_deg(plane),
        rotation_deviation_deg=float(np.degrees(deviation[1])),
        magnification=_magnification(plane),
        magnification_deviation=float(deviation[2]),
        off_rows_px=float(np.median(np.abs(shift[:, 1]))),
        scatter_px=scatter,
        nearest_px=float(near),
        farthest_px=float(far),
        behind_share=float(np.mean(shift[:, 0] < -1.0)),
        from_right=from_right,
        matches=len(kept),
    )


def _design(at: Float64[np.ndarray, "... 2"], middle: Float64[np.ndarray, "2"]) -> Float64[np.ndarray, "... 3"]:
    return np.concatenate((np.ones((*at.shape[:-1], 1)), at - middle), axis=-1)


def _near_one_plane(matched: Matched, middle: Float64[np.ndarray, "2"], width: int) -> Bool[np.ndarray, "n"]:
    """The matches whose rows lie near the plane that most of them lie near, if their columns lie near one too.

    Columns differ by depth too, so that they have more room. A mirrored image is none.
    """
    design, shift = _design(matched.left, middle), matched.right - matched.left
    # always the same samples, so that the same images give the same numbers
    chosen = np.random.default_rng(0).integers(0, len(matched), (SAMPLES, 3))
    corners = design[chosen]
    spread = np.abs(np.linalg.det(corners))
    usable = spread > np.quantile(spread, 0.25) + 1e-6
    planes = np.linalg.solve(corners[usable], shift[chosen][usable])
    # the middle of all columns, and no offset, rotation or magnification, is always among them
    level = np.zeros((1, 3, 2))
    level[0, 0, 0] = _densest(shift[:, 0], 2 * COLUMNS_SHARE * width)
    planes = np.concatenate((level, planes))
    upright = np.linalg.det(np.eye(2) + planes[:, 1:]) > LEAST_AREA
    off = np.abs(design @ planes[upright] - shift)
    near = (off[..., 1] < NEAR_ROW_SHARE * width) & (off[..., 0] < COLUMNS_SHARE * width)
    return near[int(np.argmax(near.sum(axis=1)))]


def _densest(values: Float64[np.ndarray, "n"], window: float) -> float:
    """The median of the window that holds the most values."""
    ordered = np.sort(values)
    inside = np.searchsorted(ordered, ordered + window, side="right") - np.arange(len(ordered))
    start = int(np.argmax(inside))
    return float(np.median(ordered[start : start + int(inside[start])]))


def _robust_plane(matched: Matched, middle: Float64[np.ndarray, "2"]) -> tuple[Plane, Plane, float]:
    """The plane through the rows, its standard deviations, and the median distance from it."""
    design, down = _design(matched.left, middle), matched.right[:, 1] - matched.left[:, 1]
    plane, normal = _least_median_plane(design, down), np.eye(3)
    scale = LEAST_SCALE_PX
    for _ in range(ROUNDS):
        off = np.abs(down - design @ plane)
        scale = max(1.4826 * float(np.median(off)), LEAST_SCALE_PX)
        weight = np.maximum(0.0, 1.0 - (off / (TUKEY * scale)) ** 2) ** 2
        normal = design.T @ (weight[:, None] * design) + 1e-9 * np.eye(3)
        plane = np.linalg.solve(normal, design.T @ (weight * down))
    deviation = scale * np.sqrt(GROUP * np.diag(np.linalg.inv(normal)))
    return plane, deviation, float(np.median(np.abs(down - design @ plane)))


def _least_median_plane(design: Float64[np.ndarray, "n 3"], down: Float64[np.ndarray, "n"]) -> Plane:
    """Of the planes through three places each, the one whose median distance is least: half of them may be wrong."""
    chosen = np.random.default_rng(0).integers(0, len(down), (SAMPLES, 3))
    spread = np.abs(np.linalg.det(design[chosen]))
    usable = chosen[spread > np.quantile(spread, 0.25) + 1e-6]
    level = np.array([[float(np.median(down)), 0.0, 0.0]])
    planes = np.concatenate((level, np.linalg.solve(design[usable], down[usable][..., None])[..., 0]))
    return planes[int(np.argmin(np.median(np.abs(planes @ design.T - down), axis=1)))]


def _turned_deg(plane: Plane) -> float:
    return float(np.degrees(np.arctan2(plane[1], 1.0 + plane[2])))


def _magnification(plane: Plane) -> float:
    return float(np.hypot(plane[1], 1.0 + plane[2]))


ROW_SEARCH_SHARE = 0.04
"""How far rows are searched for each other, as a share of the image's height."""
LEAST_AGREEMENT, CLEARLY_BETTER = 0.4, 1.05
"""Of the row profiles of two masks: to say anything at all, and to say that another shift fits better than none.
Clean pairs stay below 1.01 and pairs that are 4 px apart lie above 1.06, unless the thread fills its rows evenly."""


def correspondence_of_masks(
    thread_left: Bool[np.ndarray, "h w"], thread_right: Bool[np.ndarray, "h w"]
) -> Correspondence:
    """From the thread alone: the shift of rows at which both masks fill rows alike, then the columns of those rows."""
    count_left, count_right = thread_left.sum(axis=1), thread_right.sum(axis=1)
    if not count_left.any() or not count_right.any():
        return UNKNOWN
    reach = max(2, round(ROW_SEARCH_SHARE * len(count_left)))
    shift = _row_shift(count_left, count_right, reach)
    columns = np.arange(thread_left.shape[1])
    both = (count_left > 0) & (count_right > 0)
    if not both.any():
        return Correspondence(shift, None)
    mean_left = (thread_left[both] @ columns) / count_left[both]
    mean_right = (thread_right[both] @ columns) / count_right[both]
    return Correspondence(shift, float(np.median(mean_left - mean_right)))


def _row_shift(count_left: np.ndarray, count_right: np.ndarray, reach: int) -> float | None:
    """The shift of rows at which both profiles agree best, 0 unless another is clearly better; None if none agrees."""
    shifts = np.arange(-reach, reach + 1)
    padded = np.pad(count_right, reach)
    shifted = np.array([padded[reach - shift : reach - shift + len(count_left)] for shift in shifts])
    agreement = np.minimum(count_left, shifted).sum(axis=1) / np.maximum(count_left, shifted).sum(axis=1)
    if agreement.max() < LEAST_AGREEMENT:
        return None
    if agreement.max() < CLEARLY_BETTER * agreement[reach]:
        return 0.0
    return float(np.median(shifts[agreement == agreement.max()]))
