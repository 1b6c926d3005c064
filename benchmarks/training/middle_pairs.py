"""Both eyes' profiles at the same places, as at run time, and by how much more the left middle errs there."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Float64

from agents.perception.both_eyes.network_inputs import (
    LEFT,
    PLACES,
    RIGHT,
    Eye,
    Shown,
    eyes_of,
    from_other_side,
    numbers,
    together,
)
from agents.perception.both_eyes.same_places import SamePlaces, between, same_places
from agents.perception.centrelines import thread_centrelines
from agents.perception.centrelines.along import Pieces
from agents.perception.centrelines.learned import has_plain_ground, reach_px
from agents.perception.segmentation.network import segment_network
from benchmarks.training.middle_views import Truth, offsets_to, truth_of
from benchmarks.training.scenes import View, views_in
from schemas.messages import Centrelines
from shared.disparities import disparities

WIDE_PLACES = np.linspace(-1.5, 1.5, 49, dtype=np.float32)
"""As PLACES and as far apart, and wider, so that profiles can be drawn aside."""
INNER = slice(len(WIDE_PLACES) // 2 - len(PLACES) // 2, len(WIDE_PLACES) // 2 + len(PLACES) // 2 + 1)
MOST_PX = 0.5
FARTHEST_PX, ALIKE_MM = 2.0, 1.0
"""A middle farther from the truth is on no thread; and places that lie so far from each other are not the same."""
LEAST_KNOWN = 8
WINDOW = 3
"""Places, of every eighth pixel, over which errors are averaged: what so many share bends the curve."""


@dataclass(frozen=True)
class PairProfiles:
    """What the eyes of one pair show at the same places of their threads.

    Fields:
        eyes: at WIDE_PLACES.
        apart_px: by how much more the left middle errs along its normal than the right one.
        known: whether the truth says that; the places are the same by it too.
        pieces: places without a gap between them.
    """

    name: str
    eyes: tuple[Eye, Eye]
    apart_px: Float32[np.ndarray, "n"]
    known: Bool[np.ndarray, "n"]
    pieces: Pieces


def pair_profiles(folders: Iterable[Path]) -> list[PairProfiles]:
    """Of every rendered pair below some folders that shows enough of the same thread.

    Raises:
        SceneFolderError: where a folder has no scenes.
    """
    found: list[PairProfiles] = []
    for folder in folders:
        views = {view.name: view for view in views_in([folder])}
        for name in sorted(view.removesuffix("_left") for view in views if view.endswith("_left")):
            right = views.get(f"{name}_right")
            pair = None if right is None else _of_pair(folder, views[f"{name}_left"], right)
            if pair is not None:
                found.append(pair)
    return found


def _of_pair(folder: Path, left: View, right: View) -> PairProfiles | None:
    if not (left.coverage.any() and right.coverage.any()):
        return None
    images = left.image, right.image
    lines = tuple(thread_centrelines(image, segment_network(image)) for image in images)
    places = same_places(lines[LEFT], lines[RIGHT], disparities(images[LEFT].shape[1]))
    if places is None:
        return None
    apart, known = _apart((truth_of(folder, left), truth_of(folder, right)), lines, places)
    eyes = eyes_of(images, (lines[LEFT], lines[RIGHT]), places, WIDE_PLACES)
    plain = any(has_plain_ground(eye.colour[INNER], eye.width_px, PLACES) for eye in eyes)
    if known.sum() < LEAST_KNOWN or plain:
        return None
    return PairProfiles(left.name.removesuffix("_left"), eyes, apart, known, places.stretches)


def _apart(
    truths: Sequence[Truth], lines: Sequence[Centrelines], places: SamePlaces
) -> tuple[Float32[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """What the middles err apart, and where that is known."""
    at = places.left_at.astype(np.float64), places.right_at
    off: list[np.ndarray] = []
    known = np.ones(len(places.left_at), bool)
    along: list[np.ndarray] = []
    for truth, line, where, normal in zip(truths, lines, at, (places.left_normal, places.right_normal), strict=True):
        tangent = np.column_stack((normal[:, 1], -normal[:, 0]))
        offset, told, along_mm = offsets_to(truth, between(line.point_px, where), tangent)
        off.append(offset)
        along.append(along_mm)
        known &= told & (np.abs(offset) < FARTHEST_PX)
    # where along the thread a place lies is not known of light scenes, which have no such errors
    known &= ~(np.abs(along[LEFT] - along[RIGHT]) > ALIKE_MM)
    return (off[LEFT] - off[RIGHT]).astype(np.float32), known


def features(
    pair: PairProfiles,
    mirrored: bool = False,
    exchanged: bool = False,
    below: bool = False,
    aside_px: Float64[np.ndarray, "2 n"] | None = None,
) -> tuple[Float32[np.ndarray, "n f"], Float32[np.ndarray, "n"]]:
    """What a network is shown of each place, and what it is to say; of the scene as it is, or in a mirror.

    Args:
        mirrored: profiles are read from their other side, with the normal turned round.
        exchanged: in a mirror that stands beside the scene; the eyes change places.
        below: in a mirror that lies below it.
        aside_px: by how much the left and the right line are drawn along their normals before, if at all.
    """
    apart = pair.apart_px
    if aside_px is None:
        left, right = (replace(eye, colour=eye.colour[INNER]) for eye in pair.eyes)
    else:
        left, right = (drawn_aside(eye, by) for eye, by in zip(pair.eyes, aside_px, strict=True))
        apart = (apart - aside_px[LEFT] + aside_px[RIGHT]).astype(np.float32)
    shown = together(left, right)
    if exchanged:
        shown, apart = beside_mirror(shown), -apart
    if below:
        shown = upside_down(shown)
    if mirrored:
        shown, apart = from_other_side(shown), -apart
    return numbers(shown), np.clip(apart, -MOST_PX, MOST_PX)


def beside_mirror(shown: Shown) -> Shown:
    """The scene in a mirror that stands beside it, in which the eyes change places."""
    aside = np.array([-1, 1], np.float32)
    return Shown(shown.seen[::-1], shown.log_deviation[::-1], shown.normal[::-1] * aside, shown.width_px)


def upside_down(shown: Shown) -> Shown:
    """The scene in a mirror that lies below it."""
    return Shown(shown.seen, shown.log_deviation, shown.normal * np.array([1, -1], np.float32), shown.width_px)


def drawn_aside(eye: Eye, by_px: Float64[np.ndarray, "n"]) -> Eye:
    """What the eye would show at PLACES if its line lay elsewhere, along the normals."""
    shares = PLACES[:, None] + (by_px / reach_px(eye.width_px)).astype(np.float32)
    at = np.clip((shares - WIDE_PLACES[0]) / (WIDE_PLACES[1] - WIDE_PLACES[0]), 0, len(WIDE_PLACES) - 1.001)
    before = at.astype(np.int64)
    share, place = (at - before)[..., None], np.arange(len(by_px))
    colour = eye.colour[before, place] * (1 - share) + eye.colour[before + 1, place] * share
    return replace(eye, colour=colour)


def explained(pairs: Sequence[PairProfiles], said_px: Sequence[np.ndarray]) -> tuple[float, float, float]:
    """Share of the variance of the disparity's errors that is told; and their rms before and after, medians of pairs.

    Both are averaged over 24 px along the thread, and times the normal's share along the row.
    """
    parts: list[tuple[float, float, int]] = []
    for pair, say in zip(pairs, said_px, strict=True):
        known = pair.known
        weight = np.abs(pair.eyes[LEFT].normal[known, 0])
        pieces = Pieces(np.unique(pair.pieces.number[known], return_inverse=True)[1])
        apart = np.clip(pair.apart_px, -MOST_PX, MOST_PX)
        before, after = (weight * _averaged(part[known], pieces) for part in (apart, apart - say))
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
