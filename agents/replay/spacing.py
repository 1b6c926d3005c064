"""How well a replay keeps the spacing of what it replays.

Of two messages of one key that follow each other, recorded d apart and sent at rate r, the error is how much their
sending was more or less than d / r apart.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64


@dataclass(frozen=True)
class Spacing:
    """Errors of spacing in milliseconds, over so many pairs."""

    pairs: int
    p50_ms: float
    p99_ms: float
    worst_ms: float


def spacing_errors_ms(
    sent_s: Float64[np.ndarray, "n"], recorded_ns: Int64[np.ndarray, "n"], run: Int64[np.ndarray, "n"], rate: float
) -> Float64[np.ndarray, "m"]:
    """The error of each pair of neighbours that belong to one run: of the same key, and nothing held between."""
    same = run[1:] == run[:-1]
    between_s = np.diff(recorded_ns) * 1e-9 / rate
    return np.abs(np.diff(sent_s) - between_s)[same] * 1e3


def spacing_of(errors_ms: Float64[np.ndarray, "n"]) -> Spacing | None:
    """Percentiles of errors; None where there are none."""
    if not errors_ms.size:
        return None
    p50, p99 = np.percentile(errors_ms, (50, 99))
    return Spacing(errors_ms.size, float(p50), float(p99), float(errors_ms.max()))
