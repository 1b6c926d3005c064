"""Principal points that count pixels from their corners.

Here integer coordinates are pixel centres, so the middle of an image W pixels wide is (W - 1) / 2. A renderer that
looks through the middle of its image calls that W / 2. An estimated principal point is never exactly there; a stated
one that is, in both images and without distortion, is the middle of the image and is taken as such: the published
synthetic scenes show their true curves half a pixel to the right and below otherwise.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from schemas.messages import Judgement, Severity, StereoCalibration

HALF_PIXEL = 0.5


def counted_from_centres(calibration: StereoCalibration) -> tuple[StereoCalibration, tuple[Judgement, ...]]:
    """The calibration with principal points among pixel centres, and a note where they were not."""
    if not _is_ideal(calibration):
        return calibration, ()
    finding = "The principal point is exactly half the image's size, the middle of it where pixels count from a corner."
    remedy = "Half a pixel was taken off, since integer coordinates are pixel centres here; nothing needs to be done."
    return (
        replace(calibration, K_left=_shifted(calibration.K_left), K_right=_shifted(calibration.K_right)),
        (Judgement("pixels_from_corners", Severity.NOTE, finding, remedy),),
    )


def _is_ideal(calibration: StereoCalibration) -> bool:
    middle = np.array([calibration.image_width, calibration.image_height]) / 2
    exact = all(bool((K[:2, 2] == middle).all()) for K in (calibration.K_left, calibration.K_right))
    return exact and not calibration.distortion_left.any() and not calibration.distortion_right.any()


def _shifted(K: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3 3"]:
    moved = K.copy()
    moved[:2, 2] -= HALF_PIXEL
    return moved
