"""Where the demo asks for a grasp: where the thread is known least, for that is what capturing elsewhere is for."""

from collections.abc import Sequence

import numpy as np

from schemas.messages import ThreadReconstruction

PLACES = 100
FROM_END = 0.1
"""The ends of the thread are left out: little thread is left there to slide along."""
APART = 0.1


def least_known(threads: Sequence[ThreadReconstruction], count: int) -> list[tuple[float, float]]:
    """Up to so many places with the mean confidence there over some frames, the least confident first.

    No two of them are near each other. There is none where no thread states its confidence.
    """
    s = np.linspace(FROM_END, 1.0 - FROM_END, PLACES)
    stated = [np.interp(s, thread.confidence_s, thread.confidence) for thread in threads if len(thread.confidence_s)]
    if not stated:
        return []
    confidence = np.mean(stated, axis=0)
    free, found = np.ones(PLACES, bool), list[tuple[float, float]]()
    while len(found) < count and free.any():
        least = np.flatnonzero(free)[np.argmin(confidence[free])]
        found.append((float(s[least]), float(confidence[least])))
        free &= np.abs(s - s[least]) >= APART
    return found
