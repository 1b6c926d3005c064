"""What an image shows across a curve: profiles along the normals, and the middle and width of the thread in them."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

STEP_PX = 0.5
RISE = 40.0
"""A profile that rises again by so much (of 255) after it has fallen belongs to another strand from there on."""
AT_MIDDLE = 2
"""Places from the middle outwards at which a profile counts as what it is nearby: a curve may lie beside a ridge."""
MOST_COLUMNS = 30_000
"""OpenCV resamples at most 32767 columns at once."""


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
    at: Float64[np.ndarray, "t *n"],
    border: int = cv2.BORDER_CONSTANT,
) -> np.ndarray:
    """The image, bilinear, at `at` pixels from each point along its direction; outside it is zero by default.

    Points lie along the columns, since there are many more of them than places: operations on whole rows are fast.

    Args:
        at: of all points alike, or of each.

    Returns:
        Values as the image has them: (t, n, *c).
    """
    steps = np.asarray(at, np.float32).reshape(len(at), -1)
    u, v = (steps * direction[:, k].astype(np.float32) for k in (0, 1))
    u += point[:, 0].astype(np.float32)
    v += point[:, 1].astype(np.float32)
    parts = [
        cv2.remap(image, u[:, i : i + MOST_COLUMNS], v[:, i : i + MOST_COLUMNS], cv2.INTER_LINEAR, borderMode=border)
        for i in range(0, len(point), MOST_COLUMNS)
    ]
    return np.concatenate(parts, axis=1) if len(parts) > 1 else np.asarray(parts[0])


def by_channel(seen: Float32[np.ndarray, "t n 3"]) -> Float32[np.ndarray, "3 t n"]:
    """Profiles of colours, channel after channel."""
    return np.ascontiguousarray(seen.transpose(2, 0, 1))


def seen_around(
    image: UInt8[np.ndarray, "h w 3"],
    place: Float64[np.ndarray, "e 2"],
    direction: Float64[np.ndarray, "e 2"],
    along: Float64[np.ndarray, "#e a"],
    across: Float64[np.ndarray, "e b"],
) -> Float64[np.ndarray, "e a b 3"]:
    """The image, bilinear, so far from each place along its direction and across it; outside it as at its border.

    Args:
        direction: unit vectors.
        along: of each place, or of all alike.
    """
    at = place[:, None, None] + along[:, :, None, None] * direction[:, None, None]
    at = (at + across[:, None, :, None] * normals(direction)[:, None, None]).astype(np.float32)
    flat = at.reshape(len(place), -1, 2)
    seen = cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, np.float64).reshape(*at.shape[:3], 3)


def own_strand(profile: Float32[np.ndarray, "t n"]) -> Float32[np.ndarray, "t n"]:
    """Profiles, an odd number of places each, without what lies beyond a gap or a valley, seen from their middle."""
    centre = len(profile) // 2
    inner = profile[max(0, centre - 2) : centre + 3].max(axis=0)
    kept = _until_rise(np.stack((profile[centre:], profile[centre::-1]), axis=1), inner)
    return np.concatenate((kept[:0:-1, 1], kept[:, 0]))


def middle(own: Float32[np.ndarray, "t n"], at: Float64[np.ndarray, "t"]) -> Middle:
    """Centroid and width of profiles of coverage, 0 to 255; the offset is 0 where there is none."""
    total = own.sum(axis=0, dtype=np.float64)
    offset = (at.astype(np.float32) @ own) / np.maximum(total, 1e-6)
    return Middle(offset, total * (STEP_PX / 255.0), np.maximum(own[0], own[-1]) > RISE)


def _until_rise(outward: Float32[np.ndarray, "t 2 n"], inner: Float32[np.ndarray, "n"]) -> Float32[np.ndarray, "t 2 n"]:
    """Place by place outwards, on both sides at once: many times faster than NumPy's own accumulation."""
    kept = np.empty_like(outward)
    lowest, own = np.maximum(outward[0], inner), np.ones(outward.shape[1:], bool)
    for k, here in enumerate(outward):
        np.minimum(lowest, np.maximum(here, inner) if k < AT_MIDDLE else here, out=lowest)
        own &= (here <= lowest + np.float32(RISE)) & (lowest > 0)
        np.multiply(here, own, out=kept[k])
    return kept
