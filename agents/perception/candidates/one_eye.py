"""Lines that one eye alone shows, where the other one would show them too if they were thread.

A place of thread lies in the same row of both images, at about the disparity that all thread has. So a line of which
the other eye shows nothing is none, unless something hides it there. Thread upon an instrument lies before it, and that
hides it from neither eye: what one eye alone shows there is a seam, or light on a ring.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, UInt8
from scipy.spatial import cKDTree

from agents.perception.candidates.both_eyes import sampled
from agents.perception.candidates.drawn import Piece, without
from agents.perception.candidates.in_common import InCommon
from schemas.messages import Centrelines, Occluder
from shared.occluded import is_occluded

SEEN = 0.1
"""Of a line's points: what the other eye shows less of it shows none."""
BOTH = 0.5
"""Of all points: where both eyes show less in common, nobody knows which of them is right."""
MOSTLY = 0.75
"""Of a line: so much of it lies upon an instrument, or where nothing hides it in the other eye."""
LEADS_ON_SHARE = 0.03
"""Of the image's width: so near to what both eyes see a line may be the same thread, which one eye shows more of."""
STEPS = 5
"""Disparities at which the other image is asked what may hide a place."""

Map = UInt8[np.ndarray, "r c"]


def seen_by_both(
    lines: tuple[Centrelines, Centrelines],
    common: InCommon,
    occluders: tuple[Map, Map] | None,
    image_width: int,
    about_px: float,
) -> tuple[Centrelines, Centrelines]:
    """The lines of a rectified pair without those that the other eye does not show though it could.

    Args:
        lines: the middle of all that was segmented, left and right.
        common: what both eyes show of them.
        about_px: how far from the usual disparity that of a place may be.
        occluders: not 0 where something may hide thread, in copies of both images; None where nobody knows.
    """
    if common.share < BOTH:
        return lines
    to_other_px = -common.usual_px, common.usual_px
    of_eyes = zip(lines, common.pieces, common.shown, to_other_px, strict=True)
    maps = (None, None) if occluders is None else tuple(_hiding(one) for one in occluders)
    kept_left, kept_right = (
        without(line, _false(_Eye(line, pieces, shown, to_other, own, other, about_px), image_width))
        for (line, pieces, shown, to_other), own, other in zip(of_eyes, maps, maps[::-1], strict=True)
    )
    return kept_left, kept_right


@dataclass(frozen=True)
class _Eye:
    """What one eye shows.

    Fields:
        shown: of points as `sampled` has them, whether the other eye shows them too.
        to_other_px: columns to where the other eye shows a place.
        own, other: what may hide thread in its image and in the other eye's; None where nobody knows.
    """

    lines: Centrelines
    pieces: list[Piece]
    shown: Bool[np.ndarray, "n"]
    to_other_px: float
    own: Map | None
    other: Map | None
    about_px: float


def _false(eye: _Eye, image_width: int) -> list[Piece]:
    """The pieces that the other eye would show if they were thread."""
    at, number = sampled(eye.pieces)
    unseen = np.flatnonzero(np.bincount(number, eye.shown) < SEEN * np.bincount(number))
    if not len(unseen):
        return []
    both = cKDTree(eye.lines.point_px[at[eye.shown]])
    return [eye.pieces[p] for p in unseen if _is_false(eye, eye.lines.point_px[eye.pieces[p]], both, image_width)]


def _is_false(eye: _Eye, line_px: Float64[np.ndarray, "n 2"], both: cKDTree, image_width: int) -> bool:
    """Whether a line that the other eye does not show is none of thread.

    Args:
        both: what both eyes show.
    """
    if eye.own is not None and is_occluded(line_px, eye.own, image_width).mean() >= MOSTLY:
        return True
    about = np.linspace(-eye.about_px, eye.about_px, STEPS) + eye.to_other_px
    places = line_px[None] + np.stack((about, np.zeros(STEPS)), axis=1)[:, None]
    hidden = ((places[..., 0] < 0) | (places[..., 0] > image_width - 1)).any(axis=0)
    if eye.other is not None:
        hidden |= is_occluded(places, eye.other, image_width).any(axis=0)
    away = float(np.min(both.query(line_px)[0]))
    return bool((~hidden).mean() >= MOSTLY and away > LEADS_ON_SHARE * image_width)


def _hiding(occluders: Map) -> Map:
    """Without needles, at which thread ends."""
    return np.where(occluders == Occluder.NEEDLE.value, np.uint8(0), occluders)
