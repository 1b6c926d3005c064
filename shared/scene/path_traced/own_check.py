"""Whether a scene's truth is what its images show: masks against projected centrelines."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from shared.scene.path_traced.eyes import Eye
from shared.scene.path_traced.splines import arc_lengths

REACH_PX = 12.0
SPARE_PX = 1.5


def offset_from_truth(
    cover: Float32[np.ndarray, "h w"],
    eye: Eye,
    points: Float64[np.ndarray, "n 3"],
    shown: Bool[np.ndarray, "n"],
    radius_mm: float,
) -> Float64[np.ndarray, "k"]:
    """Across the projected centreline, how far the middle of its mask lies from it, in px, at places a pixel apart.

    Only where all around is visible and no other strand is near, since elsewhere the middle means nothing.
    """
    pixels = eye.project(points)
    travelled = arc_lengths(np.column_stack((pixels, np.zeros(len(pixels)))))
    even = np.arange(REACH_PX, travelled[-1] - REACH_PX)
    if not len(even):
        return np.zeros(0)
    place = np.column_stack([np.interp(even, travelled, axis) for axis in pixels.T])
    ahead = np.column_stack([np.interp(even + 2.0, travelled, axis) for axis in pixels.T])
    along = ahead - place
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.column_stack((-along[:, 1], along[:, 0]))
    reach = np.linspace(-REACH_PX, REACH_PX, 193)
    profile = _bilinear(cover, place[:, None] + reach[:, None] * normal[:, None])
    whole = np.interp(even, travelled, shown.astype(np.float64))
    window = np.ones(2 * round(REACH_PX) + 1)
    near = np.convolve(np.pad(whole, round(REACH_PX), mode="edge"), window, "valid") > len(window) - 0.01
    half = np.interp(even, travelled, eye.focal_px * radius_mm / eye.seen_from(points)[:, 2])
    aside = np.abs(reach) > half[:, None] + SPARE_PX
    clear = near & (np.where(aside, profile, 0.0).max(axis=1, initial=0) == 0)
    weight = profile.sum(axis=1)
    kept = clear & (weight > 0)
    return (profile[kept] @ reach) / weight[kept]


def _bilinear(image: np.ndarray, where: np.ndarray) -> np.ndarray:
    u, v = where[..., 0].astype(np.float32), where[..., 1].astype(np.float32)
    # remap takes fewer than 32768 rows
    parts = [
        cv2.remap(image, u[k : k + 8192], v[k : k + 8192], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        for k in range(0, len(u), 8192)
    ]
    return np.concatenate(parts).astype(np.float64)
