"""Edges, gaps, reflexes and shadows of instruments that segmenters take for thread.

They lie upon an instrument or close beside it. They are greyer than the thread that lies apart from instruments would
be in the light that falls there, or grey and far brighter; or they have the colour of the ground in less light.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.perception.centrelines.centrelines import Lines
from agents.perception.steel import GREY, Looks, colour_of, looks_along, without
from shared.occluded import is_occluded

BESIDE_CELLS = 5
"""Of the map of occluders, four pixels of an image 960 px wide each: how far beside an instrument its edge may lie."""
PALER, LEAST_HUE = 0.4, 5.0
"""Of how far thread is from grey, in OpenCV's 8-bit a and b, in the light that falls there: so pale is an instrument,
where thread would have so much colour at least."""
MOST_HUE, BRIGHTER, BRIGHTER_THAN_GREY = 6.0, 50.0, 90.0
"""Of a reflex: how far from grey, and by how much it is brighter in L than thread; than thread that is grey itself."""
CALM_POINTS = 7
"""Along the line, over which colours are averaged."""
LEAST_APART = 40
"""Points of a piece apart from instruments, which tell how its thread looks; and so many that look like none of an
instrument's are thread."""
AGAINST = 1.5
"""One point of thread weighs as much as so many of an instrument."""
MIXED = 0.6
"""Of the ground's L: the middle of a dark thread holds no more of the ground's light, which is a fifth of it."""
RATHER = 2.0
"""By so much nearer, in a and b, a shadow is to the ground in that light than to the thread."""
LEAST_POINTS = 6
"""Of a stretch at an end; a piece may be shorter."""
MOSTLY = 0.7
"""Of a piece: so much of it makes it one of the instrument's."""


@dataclass(frozen=True)
class _Thread:
    """How thread looks that lies apart from instruments.

    Fields:
        own: how far it is from grey by itself: the little colour of a black thread is the ground's.
    """

    lab: Float64[np.ndarray, "3"]
    own: float


def without_reflexes(
    image: UInt8[np.ndarray, "h w 3"], found: Lines, occluders: UInt8[np.ndarray, "r c"] | None
) -> Lines:
    """Centrelines without what are lines of instruments; all of them where nobody knows of instruments.

    Args:
        occluders: not 0 where instruments are, in a smaller copy of the image; None where the image does not tell.
    """
    lines = found.centrelines
    if occluders is None or not len(lines.piece) or not occluders.any():
        return found
    side = 2 * BESIDE_CELLS + 1
    about = cv2.dilate(occluders, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
    at_tool = is_occluded(lines.point_px, np.asarray(about, np.uint8), image.shape[1])
    if not at_tool.any():
        return found
    looks = looks_along(image, lines)
    pieces = [np.flatnonzero(lines.piece == number) for number in np.unique(lines.piece)]
    usual = _thread_of(looks, max((points[~at_tool[points]] for points in pieces), key=len))
    if usual is None:
        return found
    away = np.zeros(len(lines.piece), bool)
    for points in pieces:
        thread = _thread_of(looks, points[~at_tool[points]]) or usual
        of_tool = at_tool[points] & _is_of_instrument(looks, points, thread)
        of_ends = _at_ends(of_tool)
        is_whole = of_tool.mean() >= MOSTLY and np.count_nonzero(~of_ends) < LEAST_APART
        away[points] = True if is_whole else of_ends
    return without(found, away) if away.any() else found


def _thread_of(looks: Looks, apart: np.ndarray) -> _Thread | None:
    """How thread looks, by points apart from instruments; None where these are too few."""
    if len(apart) < LEAST_APART:
        return None
    lab, ground = np.median(looks.lab[apart], axis=0), np.median(looks.beside[:, apart], axis=(0, 1))
    mixed = min(float(lab[0] / max(ground[0], 1.0)), MIXED)
    own = float(np.linalg.norm(_hue(lab) - mixed * _hue(ground)))
    return _Thread(lab, min(own, float(colour_of(lab))))


def _is_of_instrument(looks: Looks, points: np.ndarray, thread: _Thread) -> Bool[np.ndarray, "n"]:
    lab = np.asarray(cv2.blur(looks.lab[points], (1, CALM_POINTS), borderType=cv2.BORDER_REPLICATE)).reshape(-1, 3)
    # with the light, thread loses colour: in an instrument's shadow, the darkest of it has none
    light = np.minimum(lab[:, 0] / max(float(thread.lab[0]), 1.0), 1.0)
    hue, lit = colour_of(lab), thread.own * light
    paler = (lit >= LEAST_HUE) & (hue <= PALER * lit)
    far = BRIGHTER if thread.own > MOST_HUE else BRIGHTER_THAN_GREY
    reflex = paler | ((hue <= MOST_HUE) & (lab[:, 0] >= thread.lab[0] + far))
    if thread.own < LEAST_HUE:
        return reflex
    off_thread = np.linalg.norm(_hue(lab) - light[:, None] * _hue(thread.lab), axis=1)
    return reflex | (off_thread - _off_ground(lab, looks.beside[:, points]) >= RATHER)


def _off_ground(lab: Float64[np.ndarray, "n 3"], beside: Float64[np.ndarray, "2 n 3"]) -> Float64[np.ndarray, "n"]:
    """How far a and b are from those of the ground on either side in less light; infinite where it is brighter."""
    light = lab[:, 0] / np.maximum(beside[..., 0], 1.0)
    off = np.linalg.norm(_hue(lab) - light[..., None] * _hue(beside), axis=2)
    return np.where(light <= 1.0, off, np.inf).min(axis=0)


def _hue(lab: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 2"]:
    return lab[..., 1:] - GREY


def _at_ends(of_tool: Bool[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """The stretches before both ends that are mostly an instrument's."""
    found = np.zeros(len(of_tool), bool)
    for part, marked in ((of_tool, found), (of_tool[::-1], found[::-1])):
        total = np.cumsum(np.where(part, 1.0, -AGAINST))
        # what lies beyond so much thread is another stretch
        passed = np.maximum.accumulate(total) - total > AGAINST * LEAST_APART
        last = int(np.argmax(np.where(np.logical_or.accumulate(passed), -np.inf, total)))
        if total[last] >= LEAST_POINTS:
            marked[: last + 1] = True
    return found
