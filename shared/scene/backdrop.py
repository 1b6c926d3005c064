"""What lies behind a thread, as both cameras see it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

from shared.scene.surface import Surface


class SceneError(ValueError):
    """A scene that cannot be rendered: the text names what is wrong and what would do."""


@dataclass(frozen=True)
class Light:
    """A lamp beside the lens: where it is, in mm in the left camera's frame, and its share of the light."""

    place_mm: tuple[float, float, float]
    share: float


@dataclass(frozen=True)
class Backdrop:
    """What lies behind the thread, seen by both cameras, without noise; depths in mm along each camera's axis.

    Fields:
        shadows: whether a thread casts any.
        lights: those that cast them; none: the light renderer's own.
    """

    surface: Surface
    left_bgr: UInt8[np.ndarray, "h w 3"]
    right_bgr: UInt8[np.ndarray, "h w 3"]
    depth_left_mm: Float32[np.ndarray, "h w"]
    depth_right_mm: Float32[np.ndarray, "h w"]
    shadows: bool
    lights: tuple[Light, ...] = ()
