"""How soft the sharpest edges of an image are in each direction, in pixels.

An edge that is a step blurred by a Gaussian of standard deviation s has a gradient that falls by

    R = sqrt(1 + (s0 / s)^2),   so that   s = s0 / sqrt(R^2 - 1),

where it is blurred again by s0 (Zhuo and Sim 2011). Edges of things may be soft, as those of ink on paper and of
folds are: only what the lens or a motion softens is soft everywhere. A motion by a deviation m softens an edge whose
normal is at an angle a to it by m |cos a|, so no edge lets m be more than

    s / |cos a|.

The sharpest few edges tell, whichever way they run, a slanting thread's among them. Noise, and things thinner than
their blur, let these look sharper than they are, by up to half.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

WIDTH_PX = 960
"""Wider images are reduced to this, which takes noise away and time."""
AGAIN_PX = 1.5
"""The second blur: about as much as what is looked for."""
BEFORE_PX = 0.8
"""Noise has gradients too: this much blur is laid on first, and taken off the result."""
LEAST_EDGES = 200
LEAST_STEP, LEAST_STEEPNESS = 30.0, 1.0
"""Grey levels from one side of an edge to the other, and per pixel on it, of one that stands out of noise."""
LEAST_COSINE = 0.5
"""Edges that run closer to a direction than this tell nothing about a motion along it."""
SHARPEST_SHARE = 0.02
"""Of the edges: so many may look sharper than they are, for noise and for what is thinner than its blur."""
SOFTEST_PX = 20.0
BORDER_SHARE = 0.125
"""Of each side: lenses draw worst there, and rectification and video overlays have sharp borders of their own."""

DIRECTIONS_DEG = (0.0, 45.0, 90.0, 135.0)
"""From right to down. The one across each is two further on."""

Image = Float32[np.ndarray, "h w"]


def softness_px(grey: UInt8[np.ndarray, "h w"]) -> tuple[float | None, ...]:
    """Of the sharpest edges, along each of `DIRECTIONS_DEG`; None where too few cross that direction to tell."""
    height, width = grey.shape
    share = min(1.0, WIDTH_PX / width)
    if share < 1:
        size = max(1, round(share * width)), max(1, round(share * height))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    dv, du = (round(BORDER_SHARE * side) for side in grey.shape)
    soft, normal = _edges(grey[dv : grey.shape[0] - dv, du : grey.shape[1] - du].astype(np.float32))
    angles = np.radians(DIRECTIONS_DEG)
    cosines = np.abs(np.stack((np.cos(angles), np.sin(angles)), axis=1).astype(np.float32) @ normal)
    return tuple(_of_sharpest(soft, cosine, share) for cosine in cosines)


def _of_sharpest(soft: Float32[np.ndarray, "n"], cosine: Float32[np.ndarray, "n"], share: float) -> float | None:
    telling = cosine > LEAST_COSINE
    if telling.sum() < LEAST_EDGES:
        return None
    return float(np.quantile(soft[telling] / cosine[telling], SHARPEST_SHARE)) / share


def _edges(image: Image) -> tuple[Float32[np.ndarray, "n"], Float32[np.ndarray, "2 n"]]:
    """How soft each edge is in its middle, and its normal: right, down."""
    smooth = cv2.GaussianBlur(image, (0, 0), BEFORE_PX)
    gradient = _gradient(smooth)
    again = _gradient(cv2.GaussianBlur(smooth, (0, 0), AGAIN_PX))
    steepness = np.asarray(cv2.magnitude(*gradient))
    at = np.flatnonzero(_is_middle(steepness, gradient))
    steep = steepness.ravel()[at]
    normal = np.stack([along.ravel()[at] for along in gradient]) / steep
    blurred = np.abs(again[0].ravel()[at] * normal[0] + again[1].ravel()[at] * normal[1])
    fall = np.maximum(steep / np.maximum(blurred, 1e-3), 1.0 + 1e-4)
    soft = np.minimum(AGAIN_PX / np.sqrt(fall**2 - 1), SOFTEST_PX)
    strong = steep * np.sqrt(2 * np.pi * (soft**2 + BEFORE_PX**2)) > LEAST_STEP
    return np.sqrt(np.maximum(soft**2 - BEFORE_PX**2, 0.0))[strong], normal[:, strong]


def _gradient(image: Image) -> tuple[Image, Image]:
    along_rows = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    return np.asarray(along_rows), np.asarray(cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=3, scale=0.125))


def _is_middle(steepness: Image, gradient: tuple[Image, Image]) -> Bool[np.ndarray, "h w"]:
    """Where it is steepest within two pixels, along the row or the column, whichever crosses the edge more."""
    more_along_rows = np.abs(gradient[0]) >= np.abs(gradient[1])
    in_row = more_along_rows & (steepness >= cv2.dilate(steepness, np.ones((1, 5), np.uint8)))
    in_column = ~more_along_rows & (steepness >= cv2.dilate(steepness, np.ones((5, 1), np.uint8)))
    return (in_row | in_column) & (steepness > LEAST_STEEPNESS)
