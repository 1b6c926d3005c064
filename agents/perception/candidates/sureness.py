"""How sure the segmenter is of each thread."""

import numpy as np
from jaxtyping import Float64, UInt8

from agents.perception.candidates.threads import Threads
from schemas.messages import Centrelines


def sureness(
    left: Centrelines, threads: Threads, score: UInt8[np.ndarray, "r c"] | None, width: int
) -> Float64[np.ndarray, "t"]:
    """The mean of the segmenter's score along each thread, 0 to 1; 1 where there is none."""
    if score is None:
        return np.ones(len(threads.points))
    at = np.rint((left.point_px + 0.5) * (score.shape[1] / width) - 0.5).astype(np.intp)
    sure = score[at[:, 1].clip(0, score.shape[0] - 1), at[:, 0].clip(0, score.shape[1] - 1)] / 255.0
    return np.array([sure[points].mean() for points in threads.points])
