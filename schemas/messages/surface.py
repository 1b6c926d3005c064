"""What perception saw of the tissue around the thread."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float64

from schemas.checks import Number, check_message, require
from schemas.messages.imaging import FrameStamp, RectifiedStereo
from schemas.messages.running import Consumed


@dataclass(frozen=True)
class TissueSurface:
    """Coarse depth of what lies around and behind the thread, on a regular grid of the rectified left image.

    Fields:
        u_px, v_px: the middles of the grid's columns and rows.
        depth: z in the camera frame, in the calibration's unit; 0 where it is not known.
        valid: where it is known.
        deviation: standard deviation of the depth, in its unit, 0 where that is not known; None from those who do not
            tell it.
    """

    stamp: FrameStamp
    camera: RectifiedStereo
    u_px: Float64[np.ndarray, "c"]
    v_px: Float64[np.ndarray, "r"]
    depth: Float64[np.ndarray, "r c"]
    valid: Bool[np.ndarray, "r c"]
    deviation: Float64[np.ndarray, "r c"] | None = None
    consumed: Annotated[tuple[Consumed, ...], Number(7)] = ()

    def __post_init__(self) -> None:
        check_message(self)
        for name, middles in (("u_px", self.u_px), ("v_px", self.v_px)):
            require(bool((np.diff(middles) > 0).all()), f"{name} of a surface must increase")
        require(bool(((self.depth > 0) == self.valid).all()), "depth must be positive where it is valid, else 0")
        require(bool((self.depth >= 0).all()), "depth must not be negative")
        if self.deviation is not None:
            uncertain = self.deviation > 0
            require(bool((uncertain == self.valid).all()), "a deviation must be positive where depth is valid, else 0")
            require(bool((self.deviation >= 0).all()), "a deviation must not be negative")
