"""Where the demo asks for a grasp: where the thread is known least of what can be grasped at all.

Capturing elsewhere is for such places; at places that are known too little no plan may end, so they come last.
"""

from collections.abc import Sequence

import numpy as np

from schemas.messages import ThreadReconstruction

PLACES = 100
FROM_END = 0.1
"""The ends of the thread are left out: little thread is left there to slide along."""
APART = 0.1


def goals_of(threads: Sequence[ThreadReconstruction], count: int, enough: float) -> list[tuple[float, float]]:
    """Up to so many places with the mean confidence there over some frames, those to be asked for first in front.

    First come places that every frame holds for at least `enough` likely, the least confident first, then all others,
    the most confident first. No two of them are near each other. There is none where no thread states its confidence.
    """
    s = np.linspace(FROM_END, 1.0 - FROM_END, PLACES)
    stated = [np.interp(s, thread.confidence_s, thread.confidence) for thread in threads if len(thread.confidence_s)]
    if not stated:
        return []
    confidence, least = np.mean(stated, axis=0), np.min(stated, axis=0)
    turn = np.where(least >= enough, confidence, 2.0 - confidence)
    free, found = np.ones(PLACES, bool), list[tuple[float, float]]()
    while len(found) < count and free.any():
        next_one = np.flatnonzero(free)[np.argmin(turn[free])]
        found.append((float(s[next_one]), float(confidence[next_one])))
        free &= np.abs(s - s[next_one]) >= APART
    return found
