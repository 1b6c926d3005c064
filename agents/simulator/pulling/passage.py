"""The thread within the tissue, between its two holes: how much tension its friction holds back.

Tissue that presses on the thread all along holds back c a millimetre, and where the thread turns, Coulomb friction
holds back in proportion to the tension: dT/ds = μ κ T + c. Over a stretch of length ℓ that turns by φ this is

    T₁ = T₀ e^(μφ) + c ℓ (e^(μφ) − 1) / (μφ),

the capstan equation with a drag. The bite is half a circle through both holes, as a needle leaves it, and at either
hole the thread turns from there to how its strand lies.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

INWARD = np.array([0.0, 0.0, 1.0])
"""Into the tissue: the camera looks straight down."""


@dataclass(frozen=True)
class Passage:
    """The thread in a bite. Millimetres and newtons.

    Fields:
        length: of it; `turn`: by how much it turns over that length, in radians.
        friction: Coulomb's coefficient between thread and tissue.
        drag: held back by each millimetre.
    """

    length: float
    turn: float
    friction: float
    drag: float


def bite(gap_mm: float, friction: float, drag: float) -> Passage:
    """Half a circle between holes so far apart."""
    return Passage(0.5 * float(np.pi) * gap_mm, float(np.pi), friction, drag)


def most_tension(
    passage: Passage,
    before_n: float,
    before: Float64[np.ndarray, "3"] | None,
    after: Float64[np.ndarray, "3"] | None,
) -> float:
    """The tension in newtons above which the thread moves, and which it has while it does.

    Args:
        before_n: tension of the strand that is drawn in.
        before, after: unit vectors from their holes along that strand and along the one that pulls; None where there
            is none, or it turns nowhere.
    """
    held = before_n * np.exp(passage.friction * (0.0 if before is None else _angle(-before, INWARD)))
    grown = np.exp(passage.friction * passage.turn)
    turned = passage.friction * passage.turn
    along = passage.drag * passage.length * ((grown - 1.0) / turned if turned > 1e-9 else 1.0)
    out = np.exp(passage.friction * (0.0 if after is None else _angle(-INWARD, after)))
    return float((held * grown + along) * out)


def _angle(a: Float64[np.ndarray, "3"], b: Float64[np.ndarray, "3"]) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
