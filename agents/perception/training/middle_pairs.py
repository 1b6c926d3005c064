"""Both eyes' profiles at the same places of a thread, and by how much more the left middle errs than the right one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from agents.perception.centrelines.along import Pieces, blurred, gaussian, smoothed
from agents.perception.centrelines.learned import Weights
from agents.perception.centrelines.straightened import BEYOND_PX, GROUND_FROM_PX, LEAST_CONTRAST
from agents.perception.training.middle_crops import eye_pairs, resampled
from agents.perception.training.middle_evaluate import WINDOW_POINTS, said, same_points
from agents.perception.training.middle_views import MiddleView

PLACES = np.linspace(-1.0, 1.0, 33, dtype=np.float32)
ALONG = 1.0
"""Standard deviation, in points two pixels apart, of the average along the thread."""
STRIDE, LONGEST_GAP = 2, 3
MOST_PX, MOST_CONTRASTS = 0.5, 3.0
WINDOW = 15
"""Points, of every second pixel, over which errors are averaged: what so many share bends the curve."""
LEFT, RIGHT = 0, 1


@dataclass(frozen=True)
class PairProfiles:
    """At n points of the threads of one scene that both eyes see, every second pixel of the left one.

    Fields:
        seen: of both eyes, colours at PLACES about the middle that was learned, less the ground's, over the contrast.
        offset_px, log_deviation: of both eyes, what was learned in each, the offset along the normal.
        normal: of the left eye.
        width_px: of both eyes' mean.
        apart_px: by how much more the left middle errs along that normal than the right one.
        pieces: points without a gap between them.
    """

    name: str
    seen: Float32[np.ndarray, "2 n t 3"]
    offset_px: Float32[np.ndarray, "2 n"]
    log_deviation: Float32[np.ndarray, "2 n"]
    normal: Float32[np.ndarray, "n 2"]
    width_px: Float32[np.ndarray, "n"]
    apart_px: Float32[np.ndarray, "n"]
    pieces: Pieces


def pair_profiles(views: Sequence[MiddleView], weights: Weights) -> list[PairProfiles]:
    """Of every pair of eyes among some views that shows enough of the same thread."""
    found = (_of_pair(left, right, weights) for left, right in eye_pairs(views))
    return [pair for pair in found if pair is not None]


def _of_pair(left: MiddleView, right: MiddleView, weights: Weights) -> PairProfiles | None:
    at_left, at_right = same_points(left, right)
    at_left, at_right = at_left[::STRIDE], at_right[::STRIDE]
    if STRIDE * len(at_left) < WINDOW_POINTS:
        return None
    # the right thread may have been followed from its other end
    turned = (left.normal[at_left] * right.normal[at_right]).sum(axis=1) < 0
    cuts = (np.diff(at_left) > LONGEST_GAP) | (np.diff(left.pieces.number[at_left]) != 0)
    pieces = Pieces(np.concatenate(([0], np.cumsum(cuts))))
    eyes = [
        _of_eye(view, at, turned & (eye == RIGHT), weights)
        for eye, (view, at) in enumerate(((left, at_left), (right, at_right)))
    ]
    width = 0.5 * (left.width_px[at_left] + right.width_px[at_right])
    colours = np.stack([blurred(eye[0].swapaxes(0, 1), pieces, gaussian(ALONG)).swapaxes(0, 1) for eye in eyes])
    offset, log_deviation, error = (np.stack([eye[k] for eye in eyes]).astype(np.float32) for k in (1, 2, 3))
    return PairProfiles(
        left.name,
        _in_contrasts(colours, width),
        offset,
        log_deviation,
        left.normal[at_left].astype(np.float32),
        width.astype(np.float32),
        np.clip(error[LEFT] - error[RIGHT], -MOST_PX, MOST_PX),
        pieces,
    )


def _of_eye(
    view: MiddleView, at: Int64[np.ndarray, "n"], turned: Bool[np.ndarray, "n"], weights: Weights
) -> tuple[Float32[np.ndarray, "n t 3"], Float64[np.ndarray, "n"], Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """Colours about the learned middle, its offset, the logarithm of its deviation, and what it errs."""
    offset, deviation = said(view, weights)
    offset = smoothed(offset[:, None], view.pieces, gaussian(STRIDE * ALONG))[:, 0][at]
    reach = view.width_px[at] + BEYOND_PX
    colours = resampled(view.colour[at], PLACES + (offset / reach)[:, None])
    sign = np.where(turned, -1.0, 1.0)
    error = view.offset_px[at] - offset
    colours = np.where(turned[:, None, None], colours[:, ::-1], colours)
    return colours, sign * offset, np.log(deviation[at]), sign * error


def _in_contrasts(colours: Float32[np.ndarray, "2 n t 3"], width_px: Float64[np.ndarray, "n"]) -> np.ndarray:
    """Less the ground's colour and over the contrast that both eyes have in common: what they differ by stays."""
    off = np.abs(PLACES) * (width_px + BEYOND_PX)[:, None]
    beside = (off > width_px[:, None] / 2 + GROUND_FROM_PX)[..., None]
    ground = (colours * beside).sum(axis=(0, 2)) / np.maximum(2 * beside.sum(axis=1), 1)
    less = colours - ground[:, None]
    contrast = np.sqrt(np.square(less.mean(axis=0)).mean(axis=(1, 2))) + LEAST_CONTRAST
    return np.clip(less / contrast[:, None, None], -MOST_CONTRASTS, MOST_CONTRASTS).astype(np.float32)


def features(
    pair: PairProfiles, mirrored: bool = False, exchanged: bool = False, upside_down: bool = False
) -> tuple[Float32[np.ndarray, "n f"], Float32[np.ndarray, "n"]]:
    """What a network is shown of each point, and what it is to say; of the scene as it is, or in a mirror.

    Args:
        mirrored: profiles are read from their other side, with the normal turned round.
        exchanged: in a mirror that stands beside the scene; the eyes change places.
        upside_down: in a mirror that lies below it.
    """
    seen, offset, deviation, apart = pair.seen, pair.offset_px, pair.log_deviation, pair.apart_px
    normal = pair.normal.copy()
    if exchanged:
        seen, offset, deviation, apart = seen[::-1], offset[::-1], deviation[::-1], -apart
        normal[:, 0] *= -1
    if upside_down:
        normal[:, 1] *= -1
    if mirrored:
        seen, offset, normal, apart = seen[:, :, ::-1], -offset, -normal, -apart
    n = len(apart)
    shown = (
        seen.mean(axis=0).reshape(n, -1),
        2 * (seen[LEFT] - seen[RIGHT]).reshape(n, -1),
        3 * np.stack((offset.sum(axis=0), offset[LEFT] - offset[RIGHT]), axis=1),
        np.stack((deviation.sum(axis=0), deviation[LEFT] - deviation[RIGHT], np.log(pair.width_px)), axis=1),
        normal,
        normal[:, :1] * pair.width_px[:, None] / 5,
    )
    return np.concatenate(shown, axis=1, dtype=np.float32), apart


def explained(pairs: Sequence[PairProfiles], said_px: Sequence[np.ndarray]) -> tuple[float, float, float]:
    """Share of the variance of the disparity's errors that is told; and their rms before and after, medians of pairs.

    Both are averaged over 30 px along the thread, and times the normal's share along the row.
    """
    parts: list[tuple[float, float, int]] = []
    for pair, say in zip(pairs, said_px, strict=True):
        weight = np.abs(pair.normal[:, 0]).astype(np.float64)
        before, after = (weight * _averaged(part, pair.pieces) for part in (pair.apart_px, pair.apart_px - say))
        parts.append((float(before @ before), float(after @ after), len(before)))
    first, then, count = np.array(parts).T
    rms_before, rms_after = (float(np.median(np.sqrt(part / count))) for part in (first, then))
    return float(1 - then.sum() / first.sum()), rms_before, rms_after


def _averaged(values: np.ndarray, pieces: Pieces) -> Float64[np.ndarray, "n"]:
    """The mean over WINDOW points, or as many as its piece has there."""
    both = np.zeros((2, len(values) + 1))
    both[:, 1:] = np.cumsum(np.stack((values, np.ones(len(values)))), axis=1)
    index = np.arange(len(values))
    start = index - np.minimum(WINDOW // 2, pieces.before)
    stop = index + np.minimum(WINDOW // 2, pieces.after) + 1
    total, count = both[:, stop] - both[:, start]
    return total / count
