"""How soft the sharpest edges of an image are, in pixels, along the rows and along the columns.

An edge that is a step blurred by a Gaussian of standard deviation s has a gradient that falls by

    R = sqrt(1 + (s0 / s)^2),   so that   s = s0 / sqrt(R^2 - 1),

where it is blurred again by s0 (Zhuo and Sim 2011). It is taken where gradients are strongest, apart for edges across
the rows and across the columns, since motion blurs along one direction alone. An image without strong edges tells
nothing.
"""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

WIDTH_PX = 960
"""Wider images are reduced to this, which takes noise away and time."""
AGAIN_PX = 1.5
"""The second blur: about as much as what is looked for."""
BEFORE_PX = 0.8
"""Noise has gradients too: this much blur is laid on first, and taken off the result."""
LEAST_EDGES = 200
LEAST_STEP, LEAST_STEEPNESS = 30.0, 1.0
"""Grey levels from one side of an edge to the other, and per pixel on it, of one that stands out of noise."""
SHARPEST_SHARE = 0.2
"""Of the edges: the softness that so many of them are below is the image's."""
SOFTEST_PX = 20.0


def softness_px(grey: UInt8[np.ndarray, "h w"]) -> tuple[float | None, float | None]:
    """Of the sharpest edges across the rows and across the columns; None where there are too few to tell."""
    height, width = grey.shape
    share = min(1.0, WIDTH_PX / width)
    if share < 1:
        size = max(1, round(share * width)), max(1, round(share * height))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), BEFORE_PX)
    again = cv2.GaussianBlur(smooth, (0, 0), AGAIN_PX)
    found = _along(smooth, again, 1, 0), _along(smooth, again, 0, 1)
    return found[0] and found[0] / share, found[1] and found[1] / share


def _along(smooth: Float32[np.ndarray, "h w"], again: Float32[np.ndarray, "h w"], dx: int, dy: int) -> float | None:
    steep = np.abs(cv2.Sobel(smooth, cv2.CV_32F, dx, dy, ksize=3, scale=0.125))
    across = np.abs(cv2.Sobel(smooth, cv2.CV_32F, dy, dx, ksize=3, scale=0.125))
    # of each edge only its middle, and only those that run straight across
    peak = steep >= cv2.dilate(steep, np.ones((1 + 4 * dy, 1 + 4 * dx), np.uint8))
    edge = peak & (steep > 2 * across) & (steep > LEAST_STEEPNESS)
    steepness, blurred = steep[edge], np.abs(cv2.Sobel(again, cv2.CV_32F, dx, dy, ksize=3, scale=0.125))[edge]
    fall = np.maximum(steepness / np.maximum(blurred, 1e-3), 1.0 + 1e-4)
    soft = np.minimum(AGAIN_PX / np.sqrt(fall**2 - 1), SOFTEST_PX)
    strong = steepness * np.sqrt(2 * np.pi * (soft**2 + BEFORE_PX**2)) > LEAST_STEP
    if strong.sum() < LEAST_EDGES:
        return None
    sharpest = float(np.quantile(soft[strong], SHARPEST_SHARE))
    return float(np.sqrt(max(sharpest**2 - BEFORE_PX**2, 0.0)))
