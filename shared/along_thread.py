"""A reconstructed thread at places along it, named by s: the share of its length that lies before each."""

import numpy as np
from jaxtyping import Bool, Float64

from schemas.messages import ThreadReconstruction
from shared import splines


def nearly_even(
    knots: Float64[np.ndarray, "k"],
    control_points: Float64[np.ndarray, "m 3"],
    degree: int,
    count: int,
    chords_per_span: int,
) -> tuple[Float64[np.ndarray, "n"], float]:
    """Parameters of evenly spaced points and the curve's length, both by chords: ten times as fast as the exact ones.

    The length is in the unit of the control points.
    """
    breaks = np.unique(knots)
    spans = len(breaks) - 1
    cuts = np.interp(np.arange(chords_per_span * spans + 1) / chords_per_span, np.arange(spans + 1), breaks)
    # huge numbers overflow when they are squared
    scale = np.abs(control_points).max() or 1.0
    chords = np.linalg.norm(np.diff(splines.evaluate(knots, control_points / scale, degree, cuts), axis=0), axis=1)
    lengths = np.concatenate(([0.0], np.cumsum(chords)))
    return np.interp(np.linspace(0.0, lengths[-1], count), lengths, cuts), float(scale * lengths[-1])


def confidence_at(thread: ThreadReconstruction, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """The stated confidence at places; NaN where none is stated."""
    if not len(thread.confidence):
        return np.full(len(s), np.nan)
    order = np.argsort(thread.confidence_s)
    return np.interp(s, thread.confidence_s[order], thread.confidence[order])


def unseen_at(thread: ThreadReconstruction, s: Float64[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Whether places lie where not both images show the thread."""
    begins, ends = thread.unseen[:, :1], thread.unseen[:, 1:]
    return np.logical_or.reduce((begins <= s) & (s <= ends), axis=0)
