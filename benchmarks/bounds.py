"""What the images allow: a Bayesian Cramér-Rao bound on the mean error of any curve that is estimated from them.

Derived in docs/testing.md, whose names are those used here: the spline B of control points P, displacements a and b
across it with coefficients c, Fisher's information F = Σ JᵀJ / σ² of the pixels of both images that show the thread,
and Λ, which grants an estimate no more smoothness than the truth's own.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8
from scipy.special import ellipe

from benchmarks.scenes import Pair, TrueThread
from schemas.messages import RectifiedStereo
from shared.camera import project
from shared.splines import basis_matrix, clamped_uniform_knots, difference_matrix

DEGREE = 3
CONTROL_POINTS = (6, 8, 10, 12, 16, 20, 24, 32, 40, 50, 64, 80, 100, 128)
ENOUGH_PX = 0.05
"""The truth has enough control points where they project to within this of it."""
PLACES = 400


@dataclass(frozen=True)
class Bound:
    """Least expected mean error: of the whole thread, and of what both images show (None where that is nothing)."""

    whole: float
    seen: float | None


def bound(
    camera: RectifiedStereo,
    truth: Float64[np.ndarray, "n 3"],
    visible: Bool[np.ndarray, "n 2"],
    noise_px: tuple[Float64[np.ndarray, "k"], Float64[np.ndarray, "l"]],
) -> Bound:
    """The bound for one thread.

    Args:
        truth: evenly spaced along the thread; `visible` whether the left and the right image show it there.
        noise_px: standard deviation of its centre per pixel of length in either image, infinite where nothing is seen.
    """
    s = np.linspace(0.0, 1.0, len(truth))
    knots, P = needed_spline(camera, truth, s)
    N = basis_matrix(knots, DEGREE, s)
    normals = normal_frame(N @ P)
    information = smoothness(knots, P)
    for eye, noise in enumerate(noise_px):
        J = sensitivity(camera, N @ P, eye, N, normals)
        along = steps_px(project(camera, truth)[eye])
        nearest = np.clip(np.floor(along).astype(int), 0, len(noise) - 1)
        weight = np.where(visible[:, eye], np.gradient(along) / noise[nearest] ** 2, 0.0)
        information += J.T @ (weight[:, None] * J)
    covariance = np.linalg.inv(information)
    at = np.unique(np.linspace(0, len(truth) - 1, PLACES).round().astype(int))
    m = len(P)
    blocks = [[covariance[i * m : (i + 1) * m, j * m : (j + 1) * m] for j in (0, 1)] for i in (0, 1)]
    spread = np.array([[np.einsum("qi,ij,qj->q", N[at], block, N[at]) for block in row] for row in blocks])
    error = mean_distance(np.moveaxis(spread, 2, 0))
    seen = visible[at].sum(axis=1) == 2
    return Bound(float(error.mean()), float(error[seen].mean()) if seen.any() else None)


def bounds_of(camera: RectifiedStereo, true: TrueThread, images: Pair, masks: Pair | None) -> dict[str, float | None]:
    """Bounds from the pixels of the images, and from the centroids of the masks or, without any, of the images."""
    shown = list(zip(project(camera, true.points), true.visible.T, strict=True))
    pixels = [pixel_noise_px(image, *of) for image, of in zip(images, shown, strict=True)]
    centroids = [centroid_noise_px(image, *of) for image, of in zip(masks or images, shown, strict=True)]
    by_pixels = bound(camera, true.points, true.visible, (pixels[0], pixels[1]))
    by_centroids = bound(camera, true.points, true.visible, (centroids[0], centroids[1]))
    return {"pixel bound": by_pixels.whole, "bound": by_centroids.whole, "bound seen": by_centroids.seen}


def needed_spline(
    camera: RectifiedStereo, truth: Float64[np.ndarray, "n 3"], s: Float64[np.ndarray, "n"]
) -> tuple[Float64[np.ndarray, "k"], Float64[np.ndarray, "m 3"]]:
    """The least-squares spline with the fewest control points that projects to the truth."""
    knots, control_points = np.zeros(0), np.zeros((0, 3))
    for count in CONTROL_POINTS:
        knots = clamped_uniform_knots(count, DEGREE)
        N = basis_matrix(knots, DEGREE, s)
        control_points = np.linalg.lstsq(N, truth, rcond=None)[0]
        views = zip(project(camera, N @ control_points), project(camera, truth), strict=True)
        if max(float(np.linalg.norm(a - b, axis=1).max()) for a, b in views) < ENOUGH_PX:
            break
    return knots, control_points


def normal_frame(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2 3"]:
    """Two unit vectors normal to a curve at each of its points, carried along it without needless turning."""
    tangent = np.gradient(points, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    frame = np.empty((len(points), 2, 3))
    first = np.eye(3)[np.abs(tangent[0]).argmin()]
    for i, t in enumerate(tangent):
        first = first - (first @ t) * t
        first = first / np.linalg.norm(first)
        frame[i] = first, np.cross(t, first)
    return frame


def sensitivity(
    camera: RectifiedStereo,
    points: Float64[np.ndarray, "n 3"],
    eye: int,
    N: Float64[np.ndarray, "n m"],
    normals: Float64[np.ndarray, "n 2 3"],
) -> Float64[np.ndarray, "n c"]:
    """J: how the distance across the projected thread changes with the coefficients of a, then of b."""
    x, y, z = (points - (eye * camera.baseline, 0.0, 0.0)).T
    zero = np.zeros_like(z)
    derivative = np.stack(
        (
            np.column_stack((camera.fx_px / z, zero, -camera.fx_px * x / z**2)),
            np.column_stack((zero, camera.fy_px / z, -camera.fy_px * y / z**2)),
        ),
        axis=1,
    )
    tangent = np.gradient(project(camera, points)[eye], axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    across = np.column_stack((-tangent[:, 1], tangent[:, 0]))
    moved = np.einsum("ni,nij,nkj->nk", across, derivative, normals)
    return np.hstack((moved[:, :1] * N, moved[:, 1:] * N))


def smoothness(knots: Float64[np.ndarray, "k"], P: Float64[np.ndarray, "m 3"]) -> Float64[np.ndarray, "c c"]:
    """Λ: third differences as large as those of the truth, and nothing else, about the coefficients of a and b."""
    third = difference_matrix(knots, DEGREE, 3)
    variance = max(float(np.mean((third @ P) ** 2)), 1e-12)
    return np.kron(np.eye(2), third.T @ third / variance)


def mean_distance(spread: Float64[np.ndarray, "q 2 2"]) -> Float64[np.ndarray, "q"]:
    """The mean length of normal variables in the plane with these covariances."""
    small, large = np.linalg.eigvalsh(spread).T
    large = np.maximum(large, 1e-300)
    return np.sqrt(2.0 / np.pi * large) * ellipe(1.0 - np.clip(small, 0.0, None) / large)


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
