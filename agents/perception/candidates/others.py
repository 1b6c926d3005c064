"""Which candidates are certainly not the thread that is meant.

That is one that looks different; and one that looks the same where not both have an end that something may hide, so
that neither can go on as the other.
"""

import cv2
import numpy as np
from jaxtyping import UInt8

from agents.perception.candidates.appearance import Looks, unlikeness
from schemas.messages import ThreadCandidate
from shared.occluded import hidden_ends

ANOTHER = 14.0
"""What looks so unlike the thread that is meant (see `unlikeness`) is another one."""


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
    return [k for k in range(1, len(listed)) if unlike[k] >= ANOTHER or not (goes_on[0] and goes_on[k])]


def looks_of_candidates(listed: tuple[ThreadCandidate, ...]) -> Looks:
    """How candidates look, by what travels of them."""
    colour = np.array([candidate.colour_bgr for candidate in listed]).astype(np.uint8)
    length = [np.linalg.norm(np.diff(c.left_px, axis=0), axis=1).sum() / c.width_px for c in listed]
    return Looks(
        cv2.cvtColor(colour[None], cv2.COLOR_BGR2Lab)[0].astype(np.float64),
        np.array([candidate.width_px for candidate in listed]),
        np.maximum(np.array(length), 1.0),
    )
