"""At which disparities thread may be, on any rig, by what the pair itself shows."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from schemas.messages import ThreadObservations

LEAST_PX = 1.0
NEARER = 1.5
"""Thread may be held at two thirds of the distance of all else that both eyes show, and lie as much beyond it."""
UNSHOWN_SHARE, ABOUT_SHARE = 0.25, 0.04
"""Of the width: the greatest disparity where the pair shows nothing but thread, as endoscopes have them; and how far
from the usual one that of one thread may be, at least."""


@dataclass(frozen=True)
class Disparities:
    """A range of disparities in pixels.

    Fields:
        about_px: how far from the usual disparity that of one thread may be.
    """

    least_px: float
    most_px: float
    about_px: float


def shown_disparities(farthest_px: float, nearest_px: float, image_width: int) -> Float64[np.ndarray, "2"] | None:
    """The range about those of the ground, least and most; None where that is none."""
    least = max(LEAST_PX, farthest_px / NEARER)
    most = min(nearest_px * NEARER, largest_disparity_px(image_width))
    return np.array([least, most]) if most > least else None


def largest_disparity_px(image_width: int) -> float:
    """Half the width: each eye sees half of what the other one does, and fewer common places make no rig."""
    return 0.5 * image_width


def endoscope_disparity_px(image_width: int) -> float:
    """What endoscopes show at most."""
    return UNSHOWN_SHARE * image_width


def disparities_of(observations: ThreadObservations) -> Disparities:
    """Those of a pair; by the width alone where it shows none."""
    return disparities(observations.camera.image_width, observations.disparities_px)


def disparities(image_width: int, shown_px: Float64[np.ndarray, "2"] | None = None) -> Disparities:
    """As a range.

    Args:
        shown_px: least and most, as `shown_disparities` has them.
    """
    if shown_px is not None:
        least, most = (float(told) for told in shown_px)
        # what another agent observed may be anything
        if LEAST_PX <= least < most <= largest_disparity_px(image_width):
            return Disparities(least, most, max(0.5 * (most - least), ABOUT_SHARE * image_width))
    return Disparities(LEAST_PX, endoscope_disparity_px(image_width), ABOUT_SHARE * image_width)
