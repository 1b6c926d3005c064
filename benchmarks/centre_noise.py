"""How exactly one pixel's length of a thread shows where its centre lies, in pixels across the thread.

In an image: the place t of a known profile I(t) among pixels of white noise σ_I can be told with a variance of at
least σ_I² / Σ I'(t)², the sum over the pixels across the thread (the Cramér-Rao bound of a shift). The profile is the
image's own along the true centreline, averaged along the thread; σ_I is what remains of the image's second
differences (Immerkær 1996), and at least the rounding to whole grey levels.

That is what the pixels allow, with everything else about the thread's looks known. What a centreline that is measured
in the image, or in a mask, achieves is told by its own deviation from a smooth line: second differences of centroids
across the thread that share no pixel. What varies slowly along the thread is no noise, and averages away for nobody.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

ACROSS_PX = 6
"""Pixels to either side of the centre that count: the thread and its borders, not its neighbours."""
ALONG_PX = 9
"""Length over which the profile is averaged."""
LAG_PX = 3
"""Between centroids that share no pixel."""
ROUNDING = 1.0 / np.sqrt(12.0)
NORMAL_MEDIAN = 0.6745
"""The median of |x| of a standard normal variable."""


def pixel_noise_px(
    image: UInt8[np.ndarray, "h w 3"], centre_px: Float64[np.ndarray, "n 2"], visible: Bool[np.ndarray, "n"]
) -> Float64[np.ndarray, "k"]:
    """Standard deviation of the centre at places that are one pixel apart, infinite where nothing is to be seen.

    Args:
        centre_px: the true centreline in this image, evenly spaced along it; `visible` where the image shows it.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    second = cv2.filter2D(grey, -1, np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32))
    noise = max(float(np.median(np.abs(second))) / NORMAL_MEDIAN / 6.0, ROUNDING)
    place, normal, seen = pixel_steps(centre_px, visible)
    profile = cv2.blur(_across(grey, place, normal, step=1.0), (1, ALONG_PX))
    squared_slope = np.sum(np.gradient(profile, axis=1) ** 2, axis=1)
    return np.where(seen & (squared_slope > 0), noise / np.sqrt(np.maximum(squared_slope, 1e-12)), np.inf)


def centroid_noise_px(
    image: UInt8[np.ndarray, "h w *c"], centre_px: Float64[np.ndarray, "n 2"], visible: Bool[np.ndarray, "n"]
) -> Float64[np.ndarray, "k"]:
    """The same for the centroid across the thread: of a mask, or of an image's difference from the ground beside it.

    One value wherever the thread is seen.
    """
    place, normal, seen = pixel_steps(centre_px, visible)
    if image.ndim == 2:
        weight = _across(image.astype(np.float32), place, normal, step=0.5)
    else:
        weight = _unlike_ground(_across(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32), place, normal, 0.5))
    total = weight.sum(axis=1)
    across = 0.5 * np.arange(-2 * ACROSS_PX, 2 * ACROSS_PX + 1)
    centroid = np.divide(weight @ across, total, out=np.zeros(len(total)), where=total > 0)
    known = seen & (total > 0)
    whole = known[: -2 * LAG_PX] & known[LAG_PX:-LAG_PX] & known[2 * LAG_PX :]
    second = (centroid[: -2 * LAG_PX] - 2 * centroid[LAG_PX:-LAG_PX] + centroid[2 * LAG_PX :])[whole]
    noise = float(np.median(np.abs(second))) / NORMAL_MEDIAN / np.sqrt(6.0) if len(second) else np.inf
    return np.where(known, noise if noise > 0 else np.inf, np.inf)


def _unlike_ground(profile: Float64[np.ndarray, "k a"]) -> Float64[np.ndarray, "k a"]:
    """How much darker or lighter than a straight line between its ends each profile is; one sign only."""
    ends = profile[:, :3].mean(axis=1)[:, None], profile[:, -3:].mean(axis=1)[:, None]
    share = np.linspace(0.0, 1.0, profile.shape[1])
    unlike = profile - (1.0 - share) * ends[0] - share * ends[1]
    sign = np.sign(unlike[:, profile.shape[1] // 2])[:, None]
    return np.maximum(sign * unlike, 0.0)


def pixel_steps(
    centre_px: Float64[np.ndarray, "n 2"], visible: Bool[np.ndarray, "n"]
) -> tuple[Float64[np.ndarray, "k 2"], Float64[np.ndarray, "k 2"], Bool[np.ndarray, "k"]]:
    """Places one pixel apart along a line in an image, its normals there, and whether it is visible there."""
    along = steps_px(centre_px)
    at = np.arange(0.5, max(along[-1], 1.0))
    place = np.column_stack([np.interp(at, along, column) for column in centre_px.T])
    tangent = np.gradient(place, axis=0) if len(place) > 1 else np.array([[1.0, 0.0]])
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    seen = np.interp(at, along, visible.astype(np.float64)) > 0.99
    return place, np.column_stack((-tangent[:, 1], tangent[:, 0])), seen


def steps_px(centre_px: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n"]:
    """Length in the image up to each sample."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(centre_px, axis=0), axis=1))))


def _across(
    image: np.ndarray, place: Float64[np.ndarray, "k 2"], normal: Float64[np.ndarray, "k 2"], step: float
) -> Float64[np.ndarray, "k a"]:
    """The image's values on lines across the thread."""
    offset = np.arange(-ACROSS_PX, ACROSS_PX + step / 2, step)
    at = (place[:, None] + offset[:, None] * normal[:, None]).astype(np.float32)
    u, v = np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])
    return cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
