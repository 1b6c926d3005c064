"""What a calibration file states, before it is judged, and the one error of this package."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


class CalibrationError(ValueError):
    """A calibration that cannot be used: the text says what is wrong with it and what to do."""


class OtherSizeError(CalibrationError):
    """A calibration for images of another size, which is `size`: width and height in pixels."""

    def __init__(self, sentence: str, size: tuple[int, int]) -> None:
        super().__init__(sentence)
        self.size = size


@dataclass(frozen=True)
class ImageSize:
    """The size of the images that a calibration was made with, as its file states it.

    Some files write a bare pair of numbers, and nobody agrees on its order; then `order_is_known` is false.
    """

    width: int
    height: int
    order_is_known: bool


@dataclass(frozen=True)
class StatedCalibration:
    """Two cameras with `x_right = R_right_left x_left + t_right_left`, whatever the file's format.

    `size`, `unit` and `covariance` are None where the file says nothing. A unit `by_convention` is what the format's
    users agree on, which a given unit overrides; one that the file states itself is binding.
    """

    K_left: Float64[np.ndarray, "3 3"]
    K_right: Float64[np.ndarray, "3 3"]
    distortion_left: Float64[np.ndarray, "d_left"]
    distortion_right: Float64[np.ndarray, "d_right"]
    R_right_left: Float64[np.ndarray, "3 3"]
    t_right_left: Float64[np.ndarray, "3"]
    size: ImageSize | None = None
    unit: str | None = None
    covariance: Float64[np.ndarray, "8 8"] | None = None
    unit_by_convention: bool = False
