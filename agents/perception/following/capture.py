"""By how far each point of a centreline has moved across it since the frame before.

Profiles show how much of each place is thread, by the colours of the frame before. The thread is where a strip of its
width is thread and what lies beside it is not; neighbours along the thread move alike.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from agents.perception.centrelines.along import Pieces, blurred, gaussian, smoothed
from agents.perception.centrelines.mixture import COLOUR_NOISE, LIGHT
from agents.perception.centrelines.profiles import sample
from agents.perception.following.appearance import Colours, share_of_thread

BAND_PX = 14
"""How far to either side thread is looked for, pixel by pixel; between these a parabola tells."""
INSIDE_SHARE, LEAST_INSIDE_PX = 0.4, 0.75
"""Of the width: how far from its middle a strip is thread for certain."""
BESIDE_PX, BESIDE_TO_PX = 1.0, 3.5
"""Beyond the thread's edges: what is not thread any more."""
ALONG, CALM = 2.0, 1.5
"""Standard deviations, in points that are looked at, of averages along the thread: of what is seen, and of the move."""
RATHER_NEAR = 0.1
"""How much more a place at the border of the band must look like thread than one where the thread was."""
MOST_OFF = 11.3
"""What 99 % of the squares of three normal deviations do not exceed."""
NEIGHBOURS, ASTRAY_PX = 5, 1.5
"""A point that moves by so much more or less than the middle one of so many neighbours has not found the thread."""


@dataclass(frozen=True)
class Captured:
    """Where the thread was found on each profile.

    Fields:
        move_px: along the normal.
        clear: how much more of it is thread than of what lies beside it, up to 1.
        astray: whether its neighbours have moved by another way.
        bare: whether the ground shows where the thread was.
    """

    move_px: Float64[np.ndarray, "m"]
    clear: Float32[np.ndarray, "m"]
    astray: np.ndarray
    bare: Bool[np.ndarray, "m"]


def captured(
    image: UInt8[np.ndarray, "h w 3"],
    point: Float64[np.ndarray, "m 2"],
    normal: Float64[np.ndarray, "m 2"],
    width: float,
    colours: Colours,
    pieces: Pieces,
    reach_px: Float64[np.ndarray, "m"],
    was_seen: Bool[np.ndarray, "m"],
) -> Captured:
    """The thread found again across points where it was.

    Args:
        width: of the thread in general, in pixels.
        reach_px: how far from each point its thread may lie, up to the band.
        was_seen: where the ground's colours are known; elsewhere they are taken from this image.
    """
    margin = int(np.ceil(width / 2 + BESIDE_TO_PX))
    at = np.arange(-BAND_PX - margin, BAND_PX + margin + 1.0)
    seen = sample(image, point, normal, at, cv2.BORDER_REPLICATE)
    bare = _shows_ground(seen[np.abs(at) <= inside_px(width)].mean(axis=0), colours[:, 1:])
    if not was_seen.all():
        colours = colours.copy()
        colours[~was_seen, 1:] = _ground(seen[:, ~was_seen], at, width)
    within = slice(margin, len(at) - margin)
    inner = blurred(clearness(share_of_thread(seen, colours), width)[within], pieces, gaussian(ALONG))
    places = at[within]
    score = inner - np.float32(RATHER_NEAR) * ((places / BAND_PX) ** 2).astype(np.float32)[:, None]
    score[np.abs(places)[:, None] > reach_px] = -1.0
    best = np.argmax(score, axis=0)
    here = np.arange(len(point))
    move = places[best] + _between(score, best, here)
    usual = np.median(move[_beside(pieces)], axis=0)
    astray = np.abs(move - usual) > ASTRAY_PX
    calm = smoothed(np.where(astray, usual, move)[:, None], pieces, gaussian(CALM))[:, 0]
    return Captured(calm, inner[best, here], astray | (np.abs(move) >= BAND_PX), bare)


def _shows_ground(middle: Float64[np.ndarray, "m 3"], ground: UInt8[np.ndarray, "m 2 3"]) -> Bool[np.ndarray, "m"]:
    """Whether a colour is the ground's of either side, in more or less light, as far as noise lets tell."""
    known = ground.astype(np.float64)
    light = ((middle[:, None] * known).sum(axis=2) / COLOUR_NOISE**2 + 1 / LIGHT**2) / (
        (known**2).sum(axis=2) / COLOUR_NOISE**2 + 1 / LIGHT**2
    )
    off = ((middle[:, None] - light[:, :, None] * known) ** 2).sum(axis=2) / COLOUR_NOISE**2
    return (off + (light - 1) ** 2 / LIGHT**2).min(axis=1) < MOST_OFF


def inside_px(width: float) -> float:
    """How far from its middle a strip is thread for certain."""
    return max(LEAST_INSIDE_PX, INSIDE_SHARE * width)


def _ground(
    seen: UInt8[np.ndarray, "t m 3"], at: Float64[np.ndarray, "t"], width: float
) -> Float64[np.ndarray, "m 2 3"]:
    """What lies to either side of a thread, wherever on its profile that is: it is thin, and medians do not show it."""
    beside = width / 2 + BESIDE_PX
    return np.stack([np.median(seen[side], axis=0) for side in (at < -beside, at > beside)], axis=1)


def clearness(share: Float32[np.ndarray, "t m"], width: float) -> Float32[np.ndarray, "t m"]:
    """How much more of a strip of the thread's width is thread than of what lies beside it, at each place."""
    inside = inside_px(width)
    first, last = (width / 2 + beyond for beyond in (BESIDE_PX, BESIDE_TO_PX))
    away = np.abs(np.arange(-np.ceil(last), np.ceil(last) + 1))
    own, beside = _within(away, inside), _within(away, last) - _within(away, first)
    kernel = own / own.sum() - beside / beside.sum()
    return np.asarray(cv2.filter2D(share, cv2.CV_32F, kernel[:, None], borderType=cv2.BORDER_REPLICATE))


def _within(away_px: Float64[np.ndarray, "t"], reach_px: float) -> Float64[np.ndarray, "t"]:
    """How much of each place's own pixel lies within that distance."""
    return np.clip(reach_px - away_px + 0.5, 0.0, 1.0)


def _between(score: Float32[np.ndarray, "t m"], best: np.ndarray, here: np.ndarray) -> Float64[np.ndarray, "m"]:
    """Where between places the parabola through the best one and its neighbours is highest, in steps."""
    inner = np.clip(best, 1, len(score) - 2)
    before, top, after = (score[inner + k, here].astype(np.float64) for k in (-1, 0, 1))
    bend = before - 2 * top + after
    step = 0.5 * (before - after) / np.where(bend < 0, bend, -np.inf)
    return np.where(inner == best, np.clip(step, -0.5, 0.5), 0.0)


def _beside(pieces: Pieces) -> np.ndarray:
    """The indices of each point's neighbours on its piece, which goes on at its ends for ever: (neighbours, points)."""
    first, last = pieces.first[pieces.number], pieces.last[pieces.number]
    steps = np.arange(NEIGHBOURS) - NEIGHBOURS // 2
    return np.minimum(np.maximum(np.arange(len(first)) + steps[:, None], first), last)
