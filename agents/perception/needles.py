"""Needles at the ends of a thread: what of a centreline runs along steel, and is no thread.

A curved needle is as thin as a thread and leads on from it without a gap, so that segmenters take it for thread. Yet
steel is grey, mirrors lamp and dark room side by side, and is mostly wider than what is swaged into it. So of every
piece, the stretch before an end is a needle where that explains what is seen better than thread does, which the rest
of the piece shows. With the log-likelihoods of both at each point, the needle ends where their sum from the end is
greatest.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.perception.centrelines.centrelines import Lines
from agents.perception.occluders import map_image, map_shape
from agents.perception.steel import GREY, Looks, colour_of, looks_along, without
from schemas.messages import Centrelines, Occluder, Occluders

HUE, BRIGHTNESS, WIDTH = 3.0, 25.0, 0.14
"""Standard deviations along a thread: of a and b (OpenCV's 8-bit Lab), of L, and of the width's logarithm."""
STEEL_HUE, STEEL_WIDER, STEEL_WIDTH = 2.5, 1.9, 0.4
"""Of steel: of a and b about grey; how much wider than the thread a needle is, and the deviation of its logarithm."""
LEVELS = 255.0
FARTHEST = 9.0
"""No point counts for more than three deviations."""
LEAST, CERTAIN = 25.0, 60.0
"""Log-likelihood, a point for each width, from which on a stretch is a needle; and even where it is no wider.
Thread comes to 20 in 120 scenes without needles."""
LEAST_WIDER, WIDER_SHARE = 1.25, 75
"""A needle is wider than its thread, at the upper quartile of its points: its tip tapers."""
LEAST_SPREAD = 60.0
"""Of L between the darkest and the brightest tenth of a needle's points."""
MOST_HUE = 12.0
"""Of a needle's points, at the median: how far from grey."""
LEAST_WIDTHS = 4.0
"""The length of a needle at least, in widths of the thread."""
LARGEST_SHARE = 0.5
"""Of a piece: what is more than the half of it is what that piece is."""
GROUND_SHARE, BEGINNING_WIDTHS = 0.5, 12.0
"""Of how coloured the ground beside the thread is, and over how many widths where the needle begins: what begins with
another ground, such as an instrument's steel, may be thread whose edges are seen otherwise there."""
TOUCHING_WIDTHS = 3.0
"""In widths of the thread: a piece that begins so near to a needle, and looks like it, is part of it."""


@dataclass(frozen=True)
class Stretch:
    """Part of a needle's middle.

    Fields:
        width_px: as wide as it looks.
    """

    point_px: Float64[np.ndarray, "n 2"]
    width_px: float


@dataclass(frozen=True)
class _Thread:
    """How thread looks: medians of L, a, b, of the width, and of how coloured the ground is."""

    lab: Float64[np.ndarray, "3"]
    width: float
    ground: float


def without_needles(image: UInt8[np.ndarray, "h w 3"], found: Lines) -> tuple[Lines, list[Stretch]]:
    """Centrelines cut where needles begin, and the needles."""
    lines = found.centrelines
    if not len(lines.piece):
        return found, []
    looks = looks_along(image, lines)
    pieces = [np.flatnonzero(lines.piece == number) for number in np.unique(lines.piece)]
    needle = np.zeros(len(lines.piece), bool)
    stretches: list[Stretch] = []
    for points in pieces:
        thread = _thread_of(looks, points)
        for count, from_end in _needle_ends(looks, points, thread):
            part = points[len(points) - count :] if from_end else points[:count]
            needle[part] = True
            stretches.append(Stretch(lines.point_px[part], float(np.median(lines.width_px[part]))))
            stretches.extend(_parts_beyond(lines, looks, pieces, thread, part, needle))
    return (without(found, needle), stretches) if stretches else (found, [])


def needle_map(
    image_shape: tuple[int, ...], left: list[Stretch], right: list[Stretch], sequence: int
) -> Occluders | None:
    """The needles of both images as occluders, and nothing else; None where there are none."""
    if not left and not right:
        return None
    return Occluders(map_image(_drawn(left, image_shape)), map_image(_drawn(right, image_shape)), sequence)


def _drawn(stretches: list[Stretch], image_shape: tuple[int, ...]) -> UInt8[np.ndarray, "r c"]:
    found = np.zeros(map_shape(image_shape), np.uint8)
    share = found.shape[1] / image_shape[1]
    for stretch in stretches:
        at = np.rint((stretch.point_px + 0.5) * share - 0.5).astype(np.int32)
        wide = max(1, round(stretch.width_px * share))
        cv2.polylines(found, [at[:, None]], False, Occluder.NEEDLE.value, wide)
    return found


def _thread_of(looks: Looks, points: np.ndarray) -> _Thread:
    return _Thread(
        np.median(looks.lab[points], axis=0),
        float(np.median(looks.width[points])),
        float(np.median(looks.ground[points])),
    )


def _rather_steel(looks: Looks, points: np.ndarray, thread: _Thread) -> Float64[np.ndarray, "n"]:
    """The log-likelihood of steel, less that of thread; of points a width apart, since neighbours look alike."""
    lab, wider = looks.lab[points], np.log(looks.width[points] / thread.width)
    own = _far((lab[:, 1:] - thread.lab[1:]) / HUE).sum(axis=1)
    own += _far((lab[:, 0] - thread.lab[0]) / BRIGHTNESS) + _far(wider / WIDTH)
    steel = _far((lab[:, 1:] - GREY) / STEEL_HUE).sum(axis=1) + _far((wider - np.log(STEEL_WIDER)) / STEEL_WIDTH)
    densities = np.log(HUE**2 * BRIGHTNESS * WIDTH * np.sqrt(2 * np.pi)) - np.log(STEEL_HUE**2 * STEEL_WIDTH * LEVELS)
    return (0.5 * (own - steel) + densities) / thread.width


def _far(deviations: np.ndarray) -> np.ndarray:
    return np.minimum(deviations**2, FARTHEST)


def _needle_ends(looks: Looks, points: np.ndarray, thread: _Thread) -> list[tuple[int, bool]]:
    """How many points at the start and at the end of a piece run along a needle, where any do, and which end it is.

    The thread is what is left, so that it is told once more without what was taken for a needle.
    """
    found: list[tuple[int, bool]] = []
    for _ in range(2):
        found = []
        rather = _rather_steel(looks, points, thread)
        for from_end in (False, True):
            way, order = (rather[::-1], points[::-1]) if from_end else (rather, points)
            total = np.cumsum(way)
            count = int(np.argmax(total)) + 1
            if count <= LARGEST_SHARE * len(points) and _is_needle(
                looks, order[:count], thread, float(total[count - 1])
            ):
                found.append((count, from_end))
        rest = points[sum(n for n, last in found if not last) : len(points) - sum(n for n, last in found if last)]
        if not found or not len(rest):
            return []
        thread = _thread_of(looks, rest)
    return found


def _is_needle(looks: Looks, points: np.ndarray, thread: _Thread, likelihood: float) -> bool:
    if likelihood < LEAST or len(points) < LEAST_WIDTHS * thread.width:
        return False
    lab = looks.lab[points]
    dark, bright = np.percentile(lab[:, 0], (10, 90))
    wider = float(np.percentile(looks.width[points], WIDER_SHARE)) >= LEAST_WIDER * thread.width
    first = looks.ground[points[-round(BEGINNING_WIDTHS * thread.width) :]]
    on_ground = float(np.median(first)) >= GROUND_SHARE * thread.ground
    grey = float(np.median(colour_of(lab))) <= MOST_HUE
    return bool(bright - dark >= LEAST_SPREAD and grey and on_ground and (wider or likelihood >= CERTAIN))


def _parts_beyond(
    lines: Centrelines,
    looks: Looks,
    pieces: list[np.ndarray],
    thread: _Thread,
    part: np.ndarray,
    needle: Bool[np.ndarray, "n"],
) -> list[Stretch]:
    """Whole pieces that a needle goes on in; they are marked."""
    found: list[Stretch] = []
    for points in pieces:
        if needle[points].any() or float(_rather_steel(looks, points, thread).sum()) <= 0:
            continue
        ends = lines.point_px[points[[0, -1]]]
        away = np.linalg.norm(ends[:, None] - lines.point_px[part][None], axis=2).min()
        if away <= TOUCHING_WIDTHS * thread.width:
            needle[points] = True
            found.append(Stretch(lines.point_px[points], float(np.median(lines.width_px[points]))))
    return found
