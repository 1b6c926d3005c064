"""What an image shows across a curve: profiles along the normals, and the middle and width of the thread in them."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

STEP_PX = 0.5
RISE = 40.0
"""A profile that rises again by so much (of 255) after it has fallen belongs to another strand from there on."""
MOST_ROWS = 30_000
"""OpenCV resamples at most 32767 rows at once."""


@dataclass(frozen=True)
class Middle:
    """What a profile says about the thread.

    Fields:
        offset_px: its middle, from the curve along the normal.
        width_px: its width, as the sum of its coverage.
        open: whether it still covers the outermost samples.
    """

    offset_px: Float64[np.ndarray, "n"]
    width_px: Float64[np.ndarray, "n"]
    open: Bool[np.ndarray, "n"]


def normals(tangent: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    """Unit vectors a quarter turn from the tangents."""
    return np.column_stack((-tangent[:, 1], tangent[:, 0]))


def offsets(reach_px: float) -> Float64[np.ndarray, "t"]:
    """Where a profile is sampled, symmetrically about 0."""
    half = int(np.ceil(reach_px / STEP_PX))
    return np.arange(-half, half + 1) * STEP_PX


def sample(
    image: Float32[np.ndarray, "h w"] | UInt8[np.ndarray, "h w c"],
    point: Float64[np.ndarray, "n 2"],
    direction: Float64[np.ndarray, "n 2"],
    at: Float64[np.ndarray, "t"],
    border: int = cv2.BORDER_CONSTANT,
) -> Float32[np.ndarray, "n t *c"]:
    """The image, bilinear, at `at` pixels from each point along its direction; outside it is zero by default."""
    u = (point[:, :1] + direction[:, :1] * at).astype(np.float32)
    v = (point[:, 1:] + direction[:, 1:] * at).astype(np.float32)
    parts = [
        cv2.remap(image, u[i : i + MOST_ROWS], v[i : i + MOST_ROWS], cv2.INTER_LINEAR, borderMode=border)
        for i in range(0, len(u), MOST_ROWS)
    ]
    return np.concatenate([np.asarray(part, np.float32) for part in parts]) if parts else np.zeros_like(u)


def own_strand(profile: Float32[np.ndarray, "n t"]) -> Float32[np.ndarray, "n t"]:
    """Profiles without what lies beyond a gap or a valley, seen from their middle sample."""
    centre = profile.shape[1] // 2
    inner = profile[:, max(0, centre - 2) : centre + 3].max(axis=1)
    own = np.empty_like(profile)
    own[:, centre:] = _until_rise(profile[:, centre:], inner)
    own[:, centre::-1] = _until_rise(profile[:, centre::-1], inner)
    return own


def middle(own: Float32[np.ndarray, "n t"], at: Float64[np.ndarray, "t"]) -> Middle:
    """Centroid and width of profiles of coverage, 0 to 255; the offset is 0 where there is none."""
    total = own.sum(axis=1, dtype=np.float64)
    offset = own @ at / np.maximum(total, 1e-6)
    return Middle(offset, total * (STEP_PX / 255.0), np.maximum(own[:, 0], own[:, -1]) > RISE)


def _until_rise(outward: Float32[np.ndarray, "n t"], inner: Float32[np.ndarray, "n"]) -> Float32[np.ndarray, "n t"]:
    start = np.maximum(outward, 0.0)
    start[:, :2] = np.maximum(start[:, :2], inner[:, None])
    lowest = np.minimum.accumulate(start, axis=1)
    other = np.logical_or.accumulate((outward > lowest + RISE) | (lowest <= 0), axis=1)
    return np.where(other, np.float32(0), outward)
