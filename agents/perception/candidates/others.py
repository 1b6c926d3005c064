"""Which candidates are certainly not the thread that is meant.

That is one of another colour, unless it begins where the other ends and leads on: light takes the colour from parts of
a thread. And one that looks the same and cannot be how the other goes on: not both have an end that something may hide,
and neither ends where the other is cut, at a crossing that may have been read wrongly.
"""

import cv2
import numpy as np
from jaxtyping import Float64, UInt8
from scipy.spatial import cKDTree

from agents.perception.candidates.drawn import SPACING_PX
from agents.perception.candidates.links import Looks, unlikeness
from schemas.messages import ThreadCandidate
from shared.occluded import hidden_ends

ANOTHER = 14.0
"""What looks so unlike the thread that is meant (see `unlikeness`) is another one."""

AT_WIDTHS = 5.0
"""So near, in widths, an end lies at a cut: lines are cut some widths before they cross."""
GAP = 1.05
ALONG, STRAIGHT = 4, 0.8
"""Points that tell the direction of an end; the cosine of the largest turn where a line leads on."""


def certainly_others(
    listed: tuple[ThreadCandidate, ...], occluders: UInt8[np.ndarray, "r c"] | None, image_width: int
) -> list[int]:
    """The numbers of those that are not the first one.

    Args:
        occluders: not 0 where something may hide thread, in a copy of the left image; None where nobody knows.
    """
    if len(listed) < 2:
        return []
    looks = looks_of_candidates(listed)
    unlike = unlikeness(looks, looks)[0]
    goes_on = [occluders is None or bool(hidden_ends(c.left_px, occluders, image_width).any()) for c in listed]
    return [
        k
        for k in range(1, len(listed))
        if not _leads_on(listed[0], listed[k])
        and (unlike[k] >= ANOTHER or not ((goes_on[0] and goes_on[k]) or _one_ends_at_a_cut(listed[0], listed[k])))
    ]


def alike(listed: tuple[ThreadCandidate, ...]) -> list[bool]:
    """Of each candidate, whether it may be a part of the first one by its looks."""
    looks = looks_of_candidates(listed)
    return [bool(one < ANOTHER) for one in unlikeness(looks, looks)[0]]


def _leads_on(one: ThreadCandidate, other: ThreadCandidate) -> bool:
    """Whether the other begins, or ends, near an end of the one, and in the same direction."""
    ends, others = _ends(one.left_px), _ends(other.left_px)
    near = AT_WIDTHS * max(one.width_px, other.width_px)
    gap = np.linalg.norm(ends[:, None, 0] - others[None, :, 0], axis=2)
    straight = -(ends[:, None, 1] * others[None, :, 1]).sum(axis=2)
    return bool(((gap <= near) & (straight >= STRAIGHT)).any())


def _ends(line_px: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "2 2 2"]:
    """Both ends of a line, each with its direction outward."""
    few = line_px[:ALONG], line_px[::-1][:ALONG]
    outward = np.array([end[0] - end[-1] for end in few])
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    return np.stack((line_px[[0, -1]], outward), axis=1)


def _one_ends_at_a_cut(one: ThreadCandidate, other: ThreadCandidate) -> bool:
    """Whether an end of either lies where the other ends or is cut."""
    near = AT_WIDTHS * max(one.width_px, other.width_px)
    return any(
        float(np.min(cKDTree(_cuts(line.left_px)).query(ends.left_px[[0, -1]])[0])) <= near
        for line, ends in ((one, other), (other, one))
    )


def _cuts(line_px: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "k 2"]:
    """Both ends of a line and of every gap in it, where points are farther apart than those that travel."""
    gap = np.flatnonzero(np.linalg.norm(np.diff(line_px, axis=0), axis=1) > GAP * SPACING_PX)
    return line_px[np.concatenate((np.array([0, len(line_px) - 1]), gap, gap + 1))]


def looks_of_candidates(listed: tuple[ThreadCandidate, ...]) -> Looks:
    """How candidates look, by what travels of them."""
    colour = np.array([candidate.colour_bgr for candidate in listed]).astype(np.uint8)
    length = [np.linalg.norm(np.diff(c.left_px, axis=0), axis=1).sum() / c.width_px for c in listed]
    return Looks(
        cv2.cvtColor(colour[None], cv2.COLOR_BGR2Lab)[0].astype(np.float64),
        np.array([candidate.width_px for candidate in listed]),
        np.maximum(np.array(length), 1.0),
    )
