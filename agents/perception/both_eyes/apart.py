"""By how much more the left middle errs than the right one, by what small networks have learned of both eyes together.

Light shifts what looks like the middle of a thread, and both eyes see it from two sides. What their middles err apart
is depth. Neither eye by itself shows all that tells of it; both do, at the same places (`same_places`). Half of what is
told is taken from either middle, across the line. docs/model_card.md says what the networks have learned from.
"""

import functools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

from agents.perception.both_eyes.network_inputs import (
    LEFT,
    Image,
    Shown,
    from_other_side,
    numbers,
    shown_in_both,
)
from agents.perception.both_eyes.same_places import same_places
from agents.perception.centrelines.along import Pieces
from agents.perception.centrelines.learned import STEPS
from schemas.messages import Centrelines
from shared.disparities import disparities

WEIGHTS = Path(__file__).with_name("apart.npz")
DILATIONS = 1, 2, 4, 8
"""Of layers, each of which looks at five places: so 30 to either side."""
MOST_PX = 0.5
FADE = 2
"""Places towards the end of a stretch over which what is told comes to nothing: a line has no step."""
CARRIED_SHARE = 0.5
"""Of what is told where places are not certain, which is along the rows: there both eyes err apart by half as much, and
what a network says of long stretches may be as wrong as the middles were."""
NOTHING = np.float32(0)
Weights = Mapping[str, Float32[np.ndarray, "..."]]
Lines = tuple[Centrelines, Centrelines]


def drawn_together(
    images: tuple[Image, Image],
    lines: Lines,
    weights: Weights | None = None,
    shown_px: Float64[np.ndarray, "2"] | None = None,
) -> Lines:
    """Both eyes' centrelines, each moved across itself by half of what they are told to err apart.

    What is not seen by both eyes for certain stays where it was, and so does all over a plain ground.

    Args:
        images: BGR, rectified, their rows in line.
        weights: of networks, along the first axis; the project's own, if they are None.
        shown_px: least and greatest disparity of thread, as far as the pair shows them.
    """
    places = same_places(*lines, disparities(images[LEFT].shape[1], shown_px))
    if places is None:
        return lines
    if (shown := shown_in_both(images, lines, places)) is None:
        return lines
    told = np.clip(apart_px(shown, places.stretches, weights), -MOST_PX, MOST_PX)
    half = 0.5 * _fading(places.stretches) * np.where(places.certain, 1.0, CARRIED_SHARE) * told
    at = places.left_at.astype(np.float64), places.right_at
    moves = half[:, None] * places.left_normal, -half[:, None] * places.right_normal
    left, right = (
        _moved(line, where, move, places.stretches, image)
        for line, where, move, image in zip(lines, at, moves, images, strict=True)
    )
    return left, right


def apart_px(shown: Shown, stretches: Pieces, weights: Weights | None = None) -> Float64[np.ndarray, "n"]:
    """By how much more the left middle errs along its normal than the right one; in a mirror the opposite is said."""
    seen = np.concatenate((numbers(shown), numbers(from_other_side(shown))))
    number = stretches.number
    both = Pieces(np.concatenate((number, number + number[-1] + 1)))
    said, opposite = np.split(_told(seen, both, weights or own_weights()), 2)
    return 0.5 * (said - opposite)


def _told(seen: Float32[np.ndarray, "n f"], stretches: Pieces, weights: Weights) -> Float64[np.ndarray, "n"]:
    """The mean of what all networks say."""
    state = np.maximum(seen @ weights["first"] + weights["first_bias"][:, None], NOTHING)
    count = (stretches.last - stretches.first + 1)[:, None].astype(np.float32)
    mean = np.add.reduceat(state, stretches.first, axis=1) / count
    of_all = np.maximum(mean @ weights["of_all"] + weights["of_all_bias"][:, None], NOTHING)
    state = state + of_all[:, stretches.number]
    places = np.arange(len(seen))[:, None]
    first, last = stretches.first[stretches.number, None], stretches.last[stretches.number, None]
    for layer, dilation in enumerate(DILATIONS):
        # the last place of a stretch goes on for ever
        beside = np.minimum(np.maximum(places + dilation * STEPS, first), last)
        along = state.take(beside, axis=1).reshape(*state.shape[:2], -1) @ weights[f"along{layer}"]
        along += weights[f"along{layer}_bias"][:, None]
        state += np.maximum(along, NOTHING, out=along)
    said = state @ weights["out"] + weights["out_bias"][:, None]
    return said[..., 0].mean(axis=0).astype(np.float64)


def _fading(stretches: Pieces) -> Float64[np.ndarray, "n"]:
    """One, and less towards either end of a stretch."""
    return np.minimum(np.minimum(stretches.before, stretches.after) / FADE, 1.0)


def _moved(
    line: Centrelines, at: Float64[np.ndarray, "n"], move: Float64[np.ndarray, "n 2"], stretches: Pieces, image: Image
) -> Centrelines:
    """The line moved at places along it, and between those of one stretch; nowhere else, nor out of the image."""
    point = line.point_px.copy()
    for first, last in zip(stretches.first, stretches.last, strict=True):
        order = first + np.argsort(at[first : last + 1])
        places = at[order]
        start, stop = int(np.ceil(places[0])), int(places[-1]) + 1
        between, by = np.arange(start, stop), move[order].T
        for axis in (0, 1):
            point[start:stop, axis] += np.interp(between, places, by[axis])
    within = np.clip(point, 0.0, np.array(image.shape[1::-1]) - 1.0)
    return Centrelines(within, line.piece, line.width_px, line.deviation_px)


@functools.cache
def own_weights() -> Weights:
    """The project's own weights."""
    with np.load(WEIGHTS) as file:
        return {name: file[name].astype(np.float32) for name in file.files}
