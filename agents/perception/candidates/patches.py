"""Around places of one image: which disparities make both eyes' images the same there.

Ground is taken to be a plane, d(x, y) = d₀ + gₓ x + g_y y from a place. Gauss-Newton steps on
left(x, y) − gain · right(x − d, y) tell it, residuals beyond twice their usual size weighed less (B. D. Lucas and
T. Kanade, 1981; slopes are means of both images, S. Benhimane and E. Malis, 2004). What lies before such a plane is
matched likewise by one number.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

REACH_SHARE, EVERY_SHARE = 1 / 48, 1 / 480
"""Of the image's width: how far around a place is looked, and how far apart."""
LEAST_GROUND = 0.4
"""Of what is around a place."""
ROUNDS, LARGEST_STEP_PX, SETTLED_PX = 6, 1.5, 0.05
PLANE_SIGMA_PX = 2.0
"""Of the disparity's change over the reach: tissue is seldom steeper."""
LARGEST_DEVIATION_PX = 0.15
"""Ground that tells its disparity less well, as a plain one does, tells nothing."""
NOISE_OVER_WHITE = 1.2
"""Neighbouring places of a smoothed image err alike, so that deviations are larger than white noise gives."""
LEAST_ALIKE = 0.25
"""Correlation of the slopes of both images: a plain ground has none, and its noise holds any disparity for right."""
SMOOTH_PX = 1.0

Image = UInt8[np.ndarray, "h w 3"]
Mask = UInt8[np.ndarray, "h w 1"]
Grid = Float32[np.ndarray, "n k"]
Seen = Float32[np.ndarray, "n k 3"]
Where = Bool[np.ndarray, "n k"]


@dataclass(frozen=True)
class Patches:
    """What lies around places of the left image.

    Fields:
        images: both, a little smoothed.
        u, v: where it lies there, of each place.
        over: 1, x and y of it, in units of the reach.
    """

    images: tuple[Image, Image]
    u: Grid
    v: Grid
    over: Float64[np.ndarray, "k 3"]

    def moved(self, plane: Float64[np.ndarray, "n 3"]) -> Grid:
        """The columns of the right image that show the same, if the disparity is this."""
        return (self.u - plane @ self.over.T).astype(np.float32)


def patches_around(images: tuple[Image, Image], at_px: Float64[np.ndarray, "n 2"]) -> Patches:
    """What lies around these places of the left one of two rectified images."""
    width = images[0].shape[1]
    reach = REACH_SHARE * width
    steps = np.arange(-reach, reach + 1e-6, EVERY_SHARE * width)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    left, right = (np.asarray(cv2.GaussianBlur(image, (0, 0), SMOOTH_PX), np.uint8) for image in images)
    u, v = ((at_px[:, k : k + 1] + along).astype(np.float32) for k, along in enumerate((x, y)))
    return Patches((left, right), u, v, np.stack((np.ones_like(x), x / reach, y / reach), axis=1))


def ground_planes(
    patches: Patches, no_ground: tuple[Mask, Mask], start_px: Float64[np.ndarray, "n"]
) -> tuple[Float64[np.ndarray, "n 3"], Bool[np.ndarray, "n"]]:
    """The plane of the ground around each place, and whether both images tell it.

    Args:
        no_ground: not 0 where the left, and where the right image shows none.
        start_px: a disparity that is at most a few pixels off.
    """
    is_ground = looked_up(no_ground[0], patches.u, patches.v)[..., 0] == 0
    shown = _value_and_slope(patches.images[0], patches.u, patches.v)
    plane = np.concatenate((start_px[:, None], np.zeros((len(start_px), 2))), axis=1)
    told = np.zeros(len(plane), bool)
    for _ in range(ROUNDS):
        there = patches.moved(plane)
        valid = is_ground & (looked_up(no_ground[1], there, patches.v)[..., 0] == 0)
        seen = _value_and_slope(patches.images[1], there, patches.v)
        step, deviation = _step(shown, seen, valid, patches.over, plane)
        plane += step
        settled = np.all(np.abs(step) < SETTLED_PX, axis=1)
        told = settled & (valid.mean(axis=1) >= LEAST_GROUND) & (deviation <= LARGEST_DEVIATION_PX)
        told &= _correlation(shown[1], seen[1], valid) >= LEAST_ALIKE
        if settled.all():
            break
    return plane, told


def before_planes(
    patches: Patches, plane: Float64[np.ndarray, "n 3"], where: Where, start_px: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n"]:
    """By how much larger than the plane's the disparity of what is somewhere is; NaN where that does not settle.

    Args:
        where: what of each patch of the left image is asked.
        start_px: at most a pixel or two off.
    """
    shown = _value_and_slope(patches.images[0], patches.u, patches.v)
    mask = where[..., None].astype(np.float32)
    before, step = start_px.copy(), np.full(len(start_px), np.inf)
    for _ in range(ROUNDS):
        there = patches.moved(plane + before[:, None] * (1.0, 0.0, 0.0))
        residual, rises, _ = _misfit(shown, _value_and_slope(patches.images[1], there, patches.v), mask)
        step = -(rises * residual).sum(axis=(1, 2)) / ((rises * rises).sum(axis=(1, 2)) + 1e-6)
        before += step.clip(-LARGEST_STEP_PX, LARGEST_STEP_PX)
    return np.where(np.abs(step) < SETTLED_PX, before, np.nan)


def looked_up(image: UInt8[np.ndarray, "h w c"], u: Grid, v: Grid) -> Float32[np.ndarray, "n k c"]:
    """The image at these places; beyond its border as at it."""
    found = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float32).reshape(*u.shape, -1)


def _step(
    shown: tuple[Seen, Seen],
    seen: tuple[Seen, Seen],
    valid: Where,
    over: Float64[np.ndarray, "k 3"],
    plane: Float64[np.ndarray, "n 3"],
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n"]]:
    """A Gauss-Newton step of each plane, and the deviation of its disparity at the place itself.

    Args:
        shown, seen: what the left image shows, and the right one where the plane says that it is the same; and by how
            much either changes in a pixel of the row.
        valid: which of it is ground in both.
    """
    residual, rises, count = _misfit(shown, seen, valid[..., None].astype(np.float32))
    square = residual * residual
    variance = square.sum(axis=(1, 2), keepdims=True) / (3.0 * count) + 1e-6
    weight = rises / (1.0 + square / (4.0 * variance))
    inverse = 1.0 / variance[:, 0]
    squares = inverse * (weight * rises).sum(axis=2)
    prior = np.array((1e-6, PLANE_SIGMA_PX**-2, PLANE_SIGMA_PX**-2))
    pairs = (over[:, :, None] * over[:, None, :]).reshape(-1, 9)
    covariance = np.linalg.inv((squares @ pairs).reshape(-1, 3, 3) + np.diag(prior))
    downhill = (inverse * (weight * residual).sum(axis=2)) @ over + plane * (0.0, 1.0, 1.0) * prior
    step = -np.einsum("nij,nj->ni", covariance, downhill)
    return step.clip(-LARGEST_STEP_PX, LARGEST_STEP_PX), NOISE_OVER_WHITE * np.sqrt(covariance[:, 0, 0])


def _misfit(
    shown: tuple[Seen, Seen], seen: tuple[Seen, Seen], mask: Float32[np.ndarray, "n k 1"]
) -> tuple[Seen, Seen, Float32[np.ndarray, "n 1 1"]]:
    """What both images differ by within the mask, besides gain; how that grows with disparity; of how many."""
    count = np.maximum(mask.sum(axis=1, keepdims=True), 1.0)
    slope = np.float32(0.5) * (shown[1] + seen[1])
    of_shown, of_seen, of_slope = (
        (mask * part).sum(axis=1, keepdims=True) / count for part in (shown[0], seen[0], slope)
    )
    residual = mask * (shown[0] - of_shown / np.maximum(of_seen, 1.0) * seen[0])
    return residual, mask * (slope - of_slope), count


def _correlation(one: Seen, other: Seen, valid: Where) -> Float64[np.ndarray, "n"]:
    """Of the slopes that both eyes see where it is valid."""
    products = np.stack((one * one, one * other, other * other)).sum(axis=-1) * valid
    of_one, of_both, of_other = products.sum(axis=-1)
    return np.asarray(of_both / np.sqrt(of_one * of_other + 1e-6), np.float64)


def _value_and_slope(image: Image, u: Grid, v: Grid) -> tuple[Seen, Seen]:
    half = np.float32(0.5)
    after, before = looked_up(image, u + half, v), looked_up(image, u - half, v)
    return half * (after + before), after - before
