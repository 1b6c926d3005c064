"""The candidates of the last look at the whole, found again in a frame that was looked at near them.

Between two frames a thread moves by less than it is away from another one, nearly everywhere; so each piece belongs to
the candidate to which most of its points lie nearest. Scores, colours and widths stay those of the look at the whole.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64, UInt8
from scipy.spatial import cKDTree

from agents.perception.candidates.candidates import Candidates, strands_among
from agents.perception.candidates.drawn import Piece, along, without
from agents.perception.candidates.others import certainly_others
from agents.perception.candidates.threads import pieces_of
from schemas.messages import Centrelines, ThreadCandidate

EVERY = 8
"""Of the points of a piece, which lie a pixel apart, so many as are looked at."""
FAR_SHARE = 0.04
"""Of the image's width: a piece so far from all candidates belongs to none."""


def candidates_followed(
    last: tuple[ThreadCandidate, ...],
    lines: tuple[Centrelines, Centrelines],
    occluders: UInt8[np.ndarray, "r c"] | None,
    image_width: int,
) -> Candidates:
    """The candidates of the frame before, in their order, where they are now; or were, where nobody looked at them."""
    left, right = lines
    if not last:
        return Candidates((), left, right)
    lefts = _nearest(left, [candidate.left_px for candidate in last], image_width)
    rights = _nearest(right, [candidate.right_px for candidate in last], image_width)
    now = [along(candidate.left_px, left, mine, shifted=False) for candidate, mine in zip(last, lefts, strict=True)]
    if len(now[0]) < 2:
        return Candidates((), left, right)
    listed = tuple(
        replace(before, left_px=line_px, right_px=along(line_px, right, mine, shifted=True))
        if len(line_px) > 1
        else before
        for before, line_px, mine in zip(last, now, rights, strict=True)
    )
    others = certainly_others(listed, occluders, image_width)
    return Candidates(
        listed,
        without(left, [piece for k in others for piece in lefts[k]]),
        without(right, [piece for k in others for piece in rights[k]]),
        strands_among(listed, others, (left, right), (lefts, rights)),
    )


def _nearest(lines: Centrelines, before_px: list[Float64[np.ndarray, "n 2"]], image_width: int) -> list[list[Piece]]:
    """The pieces that lie nearest to each of some lines."""
    found: list[list[Piece]] = [[] for _ in before_px]
    pieces, points = pieces_of(lines), np.concatenate(before_px)
    if not pieces or not len(points):
        return found
    of_point = np.repeat(np.arange(len(before_px)), [len(line) for line in before_px])
    some = [piece[len(piece) % EVERY // 2 :: EVERY] for piece in pieces]
    found_near = cKDTree(points).query(
        lines.point_px[np.concatenate(some)], distance_upper_bound=FAR_SHARE * image_width
    )
    away, at = np.asarray(found_near[0]), np.asarray(found_near[1], np.intp)
    first = np.cumsum([0, *(len(part) for part in some)])
    for k, piece in enumerate(pieces):
        here = np.s_[first[k] : first[k + 1]]
        near = of_point[at[here][np.isfinite(away[here])]]
        if 2 * len(near) > len(some[k]):
            found[int(np.argmax(np.bincount(near)))].append(piece)
    return found
