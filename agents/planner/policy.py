"""Where to capture the thread (paper, section III-F).

A grasp captures the thread at one sample, slides to the goal and closes there. With P(s) the probability that a capture
at s succeeds, and p that the thread stays between the fingers from one sample to the next,

    P_grasp(s_i) = P(s_i) p^|i − g|,

with g the goal's sample; the capture is the largest of these that nothing speaks against. Capturing at the goal
itself is the direct grasp. What a plan states is more cautious: the least P(s) on the way takes the place of P(s_i)
(docs/decisions.md, 14).
"""

import enum
from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.typing import ArrayLike

from schemas.messages import Alternative, ThreadReconstruction


class Against(enum.Enum):
    """What speaks against a capture, the first that applies."""

    UNSEEN = "unseen"
    UNDECIDED = "where the thread may lead elsewhere"
    UNKNOWN_ON_THE_WAY = "unseen, undecided or hardly known up to the goal"
    STRAND_BESIDE = "another strand beside it"
    STRAND_ON_THE_WAY = "another strand on the way to the goal"
    NEEDLE_BESIDE = "the needle beside it"
    ALONG_APPROACH = "thread along the approach"
    TURNS_TOO_SHARPLY = "turns too sharply"
    UNREACHABLE = "unreachable"
    TISSUE_UNKNOWN = "tissue not known there"
    IN_TISSUE = "jaws would press into the tissue"


BETTER_ELSEWHERE = "another capture is better"


def candidates(s_goal: float, count: int) -> tuple[Float64[np.ndarray, "n"], int]:
    """Evenly spaced places along the thread, of which the one nearest to the goal is moved onto it, and its index."""
    s = np.linspace(0.0, 1.0, count)
    goal = int(np.argmin(np.abs(s - s_goal)))
    s[goal] = s_goal
    return s, goal


def capture_probability(thread: ThreadReconstruction, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """The reconstruction's confidence at places along the thread; 0 where it states none."""
    if not len(thread.confidence_s):
        return np.zeros(len(s))
    order = np.argsort(thread.confidence_s, kind="stable")
    return np.interp(s, thread.confidence_s[order], thread.confidence[order])


def grasp_probability(
    captured: Float64[np.ndarray, "n"], goal: int, keep_probability: float
) -> Float64[np.ndarray, "n"]:
    """Of a capture at each sample with a slide to the goal's, as the paper has it."""
    return captured * keep_probability ** np.abs(np.arange(len(captured)) - goal)


def least_on_the_way(captured: Float64[np.ndarray, "n"], goal: int) -> Float64[np.ndarray, "n"]:
    """The least of all samples from each one to the goal, both included."""
    after = np.minimum.accumulate(captured[goal:])
    before = np.minimum.accumulate(captured[goal::-1])[::-1]
    return np.concatenate((before[:-1], after))


def most_likely(
    probability: Float64[np.ndarray, "n"], allowed: Bool[np.ndarray, "n"], near: int, as_likely: float = 0.0
) -> int | None:
    """The allowed sample with the largest probability, of equals the nearest to `near`; None where none is allowed.

    Args:
        as_likely: how far below the largest a probability equals it.
    """
    if not allowed.any():
        return None
    best = np.flatnonzero(allowed & (probability >= probability[allowed].max() - as_likely))
    return int(best[np.argmin(np.abs(best - near))])


def first_against(found: Mapping[Against, ArrayLike]) -> Int64[np.ndarray, "n"]:
    """For each sample the place in `Against` of what speaks against it, or −1."""
    reasons = list(Against)
    return np.select([np.asarray(found[reason]) for reason in reasons], np.arange(len(reasons)), default=-1)


def reason_of(code: int) -> str:
    """What spoke against a sample, in words; where nothing did, another one was better."""
    return list(Against)[code].value if code >= 0 else BETTER_ELSEWHERE


def counted_reasons(codes: Int64[np.ndarray, "n"]) -> str:
    """What speaks against how many samples, the most frequent first: `61 unreachable, 39 unseen`."""
    found, counts = np.unique(codes[codes >= 0], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return ", ".join(f"{counts[i]} {reason_of(int(found[i]))}" for i in order)


def alternatives(
    s: Float64[np.ndarray, "n"],
    probability: Float64[np.ndarray, "n"],
    against: Int64[np.ndarray, "n"],
    goal: int,
    chosen: int | None,
    count: int,
) -> tuple[Alternative, ...]:
    """The most likely other captures, some way apart from the chosen one and from each other."""
    index = np.arange(len(s))
    apart = max(1, len(s) // (2 * count)) if count else 1
    free = np.ones(len(s), dtype=bool) if chosen is None else np.abs(index - chosen) >= apart
    found: list[Alternative] = []
    while len(found) < count and (best := most_likely(probability, free, goal)) is not None:
        found.append(Alternative(float(s[best]), float(probability[best]), reason_of(int(against[best]))))
        free &= np.abs(index - best) >= apart
    return tuple(found)
