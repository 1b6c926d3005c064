"""Which ends of a centreline's pieces are the thread's own tips, and which lie under what hides the rest of it.

A tip is one place of the thread, so both images show it in one row, with the disparity of the thread before it. A cover
at another depth than the thread hides other places of it in the one image than in the other: there the pieces of
both images end apart, along the thread. With δ = left end − right end − (disparity before, 0), the outward direction
t, the covariance S of δ for one place, and R, how far covered ends lie apart, the ratio of the likelihoods is

    log p(δ | tip) / p(δ | covered) = ½ log(1 + g) − ½ R² (tᵀS⁻¹δ)² / (1 + g),   g = R² tᵀS⁻¹t,

which says nothing by itself where the images cannot tell: along the rows, or far from the last match.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.refined.alignment import GRADIENT, Alignment
from agents.reconstruction.refined.chains import Chain, Ends, direction_outward
from schemas.messages import Centrelines, RectifiedStereo

TIP_DEVIATION_PX = 0.5
APART_SHARE = 0.01
"""Of the image's width: R."""
REACH_SHARE = 0.05
"""Of the image's width: how far from a piece's end its last match may be."""
MOST_EVIDENCE = 4.0
"""A cover may lie at the thread's own depth, and a mask may be ragged: no end is worth more than this."""
BORDER_PX = 4.0


@dataclass(frozen=True)
class _End:
    """The end of a stretch of a chain: its point, the direction outward, and its last match before it."""

    left: int
    point_px: Float64[np.ndarray, "2"]
    outward: Float64[np.ndarray, "2"]
    match: int
    inner_match: int
    rest_px: float


def ends_of(
    left: Centrelines,
    right: Centrelines,
    matched: list[tuple[Chain, Alignment | None]],
    camera: RectifiedStereo,
) -> Ends:
    """What both images together say of every end of the left pieces.

    Args:
        right: in the left image's rows.
        matched: threads of the left image, each with the places of the right image that correspond to it.
    """
    tip, disparity_px = np.zeros(len(left.piece)), np.full(len(left.piece), np.nan)
    for chain, aligned in matched:
        if aligned is None:
            continue
        for end in _ends_of_stretches(chain, aligned, camera):
            disparity_px[end.left] = aligned.disparity_px[end.match]
            tip[end.left] = _tip(end, aligned, right, camera)
    return Ends(tip, disparity_px)


def _ends_of_stretches(chain: Chain, aligned: Alignment, camera: RectifiedStereo) -> list[_End]:
    cuts = np.flatnonzero(np.diff(chain.piece)) + 1
    first, last = np.concatenate(([0], cuts)), np.concatenate((cuts, [len(chain.piece)])) - 1
    low = np.searchsorted(aligned.along_px, chain.along_px[first], side="left")
    high = np.searchsorted(aligned.along_px, chain.along_px[last], side="right") - 1
    size = np.array((camera.image_width - 1, camera.image_height - 1))
    found: list[_End] = []
    for a, b, i, j in zip(first, last, low, high, strict=True):
        if j <= i:
            continue
        points = chain.point_px[a : b + 1]
        reach = 3.0 * float(np.median(chain.width_px[a : b + 1]))
        for at, way, match, inner in ((a, points, i, i + 1), (b, points[::-1], j, j - 1)):
            rest = abs(float(aligned.along_px[match] - chain.along_px[at]))
            within = min(way[0].min(), (size - way[0]).min()) > BORDER_PX
            if within and rest <= REACH_SHARE * camera.image_width:
                outward = direction_outward(way, reach)
                found.append(_End(int(chain.index[at]), way[0], outward, int(match), int(inner), rest))
    return found


def _tip(end: _End, aligned: Alignment, right: Centrelines, camera: RectifiedStereo) -> float:
    """The logarithm of how much likelier this is a tip than covered; 0 where the right image does not say."""
    here, inner = aligned.right_index[end.match], aligned.right_index[end.inner_match]
    mine = np.flatnonzero(right.piece == right.piece[int(here)])
    if here == inner or right.piece[int(inner)] != right.piece[int(here)]:
        return 0.0
    point = right.point_px[mine[-1] if here > inner else mine[0]]
    size = np.array((camera.image_width - 1, camera.image_height - 1))
    if min(point.min(), (size - point).min()) <= BORDER_PX:
        return 0.0
    # where these two ends are taken for one place, they cannot speak for it themselves
    before = end.inner_match if here in (mine[0], mine[-1]) else end.match
    rest_px = end.rest_px + abs(float(aligned.along_px[end.match] - aligned.along_px[before]))
    off = end.point_px - point - (aligned.disparity_px[before], 0.0)
    known = TIP_DEVIATION_PX**2
    variance = np.array((known + aligned.variance_px2[before] + (GRADIENT * rest_px) ** 2, known))
    apart = APART_SHARE * camera.image_width
    gain = apart**2 * float((end.outward**2 / variance).sum())
    seen = apart * float((end.outward * off / variance).sum())
    return float(np.clip(0.5 * np.log1p(gain) - 0.5 * seen**2 / (1.0 + gain), -MOST_EVIDENCE, MOST_EVIDENCE))
