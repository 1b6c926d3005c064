"""What the camera adds: a little blur, shot noise and read noise, on display values."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, UInt8


@dataclass(frozen=True)
class Sensor:
    """Blur in pixels; noise in grey levels: in the dark (read), and at white on top of it (shot)."""

    blur_px: float = 0.6
    read_noise: float = 1.4
    shot_noise: float = 2.2


NO_NOISE = Sensor(blur_px=0.0, read_noise=0.0, shot_noise=0.0)


def grain(shape: tuple[int, int], seed: int) -> Float32[np.ndarray, "h w 3"]:
    """Normal deviates for an image; a caller in a hurry cuts windows out of one larger grain."""
    return np.random.default_rng([seed, 3]).standard_normal((*shape, 3), dtype=np.float32)


def expose(
    image: UInt8[np.ndarray, "h w 3"], sensor: Sensor, deviates: Float32[np.ndarray, "h w 3"]
) -> UInt8[np.ndarray, "h w 3"]:
    """The image as the sensor reads it."""
    if sensor.blur_px > 0:
        image = cv2.GaussianBlur(image, (5, 5), sensor.blur_px)
    if sensor.read_noise == 0 and sensor.shot_noise == 0:
        return image.copy()
    return with_noise(image, noise_deviation(image, sensor), deviates)


def noise_deviation(image: UInt8[np.ndarray, "h w 3"], sensor: Sensor) -> Float32[np.ndarray, "h w 3"]:
    """Standard deviation of each pixel's noise, in grey levels; that of shots grows as the root of the grey level."""
    levels = np.arange(256, dtype=np.float32) / 255.0
    deviation = np.sqrt(sensor.read_noise**2 + sensor.shot_noise**2 * levels).astype(np.float32)
    return np.asarray(cv2.LUT(image, deviation), np.float32)


def with_noise(
    image: UInt8[np.ndarray, "h w 3"],
    deviation: Float32[np.ndarray, "h w 3"],
    deviates: Float32[np.ndarray, "h w 3"],
) -> UInt8[np.ndarray, "h w 3"]:
    """The image with noise of that deviation."""
    return np.asarray(cv2.add(image, cv2.multiply(deviation, deviates), dtype=cv2.CV_8U), np.uint8)
