"""Which thread an operator means: the one at a pixel of the left image, followed from frame to frame.

In the left image the connected piece of thread nearest to the pixel is kept alone. In the right image nobody has
pointed at anything: what looks like that piece is kept, and matching refuses what stays ambiguous.
"""

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from agents.perception.segmentation.boxes import Meant

REACH_SHARE = 0.03
"""Of the width: how far from a prompt a thread may lie and still be meant."""
ALIKE = 12.0
"""Standard deviation of a thread's own colour (OpenCV's 8-bit L, a, b)."""
FOLLOW_SHARE = 0.013
"""Of the width: standard deviation of how far a thread moves between two frames."""


def reach_px(width: int) -> float:
    """How far from a prompt a thread may lie, in an image of that width."""
    return REACH_SHARE * width


def meant_at(prompt_px: Float64[np.ndarray, "2"], shape: tuple[int, ...]) -> Meant:
    """The piece nearest to a prompt."""
    v, u = np.ogrid[: shape[0], : shape[1]]
    away = np.hypot(u - prompt_px[0], v - prompt_px[1]) / reach_px(shape[1])
    # steep, so that a small piece nearby counts for more than a large one further off
    return Meant((np.maximum(0.0, 1.0 - away) ** 4).astype(np.float32), alone=True)


def meant_like(
    image: UInt8[np.ndarray, "h w 3"], coverage: UInt8[np.ndarray, "h w"], other: UInt8[np.ndarray, "h w 3"]
) -> Meant:
    """In another image, the piece of the colour of what is covered in this one."""
    seen = cv2.cvtColor(image, cv2.COLOR_BGR2Lab)[coverage > 0]
    away = cv2.cvtColor(other, cv2.COLOR_BGR2Lab) - np.median(seen, axis=0)
    weight = np.exp(-0.5 * np.einsum("hwc,hwc->hw", away, away) / ALIKE**2)
    return Meant(weight.astype(np.float32), alone=False, other_eye=coverage)


def meant_as_before(coverage: UInt8[np.ndarray, "h w"], alone: bool) -> Meant:
    """The piece that lies most where thread was in the frame before."""
    weight: Float32[np.ndarray, "h w"] = cv2.GaussianBlur(
        coverage.astype(np.float32), (0, 0), FOLLOW_SHARE * coverage.shape[1]
    )
    return Meant(weight, alone)


def followed(prompt_px: Float64[np.ndarray, "2"], coverage: UInt8[np.ndarray, "h w"]) -> Float64[np.ndarray, "2"]:
    """The prompt on the thread that it means: the covered pixel nearest to it; itself where nothing is covered."""
    pixel = np.argwhere(coverage)[:, ::-1].astype(np.float64)
    if len(pixel) == 0:
        return prompt_px
    return pixel[int(np.argmin(np.linalg.norm(pixel - prompt_px, axis=1)))]
