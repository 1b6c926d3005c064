"""Thread on textured ground without weights: elongated ridges, then the colour of the most thread-like of them.

Found on a reduced image, where a thread is one to four pixels wide; its width comes from the full one at the end.

1. What is darker than its surroundings and what is brighter are looked at apart, so that the gap between two glints
   is no dark line.
2. Oriented filters, a second derivative across and a long Gaussian along, answer to lines of the thread's width and
   hardly to specks. Strong ridges are seeds, weaker ones connected to them extend them.
3. Of the connected ridges the one whose colour is rarest in the image, weighted by its contrast, is taken to be
   thread. Its colour decides which other ridges belong to it: vessels and folds are ridges too, of another colour.
   A pixel that is only partly thread has a mixture of the thread's colour and the ground's, and is judged as one.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, UInt8

from agents.perception.segmentation.threshold import components_with_seed

DETECTION_WIDTH_PX = 480
"""Width of the reduced image; the sizes in pixels below are of this image."""
ACROSS_PX, ALONG_PX = 1.1, 3.0
"""Standard deviations of the oriented filter: it answers best to a line 2.2 px wide, and well from 1 to 4."""
ORIENTATIONS = 12
BACKGROUND_WINDOW = 7
"""Of the median that is the local background, in pixels of twice the size: several times the thread's width."""
STRONG_PERCENTILE = 99.7
SEED_SHARE, GROW_SHARE = 0.5, 0.25
"""Of the response of the image's strongest ridges: what seeds a piece of thread, and what extends it."""
FAINT_SHARE = 0.15
"""What extends it where its colour is known to be the thread's: over dark ground a dark thread has little contrast."""
LEAST_LENGTH_PX = 12
"""Pieces shorter than this are specks."""
LEAST_WEIGHT_SHARE, LEAST_EXTENT_SHARE = 0.06, 0.2
"""Pieces with less response, or less extent, than this share of the greatest are clutter."""
COLOUR_LIMIT, GROWN_COLOUR_LIMIT = 3.0, 4.5
"""Deviations from the thread's colour up to which a pixel seeds, or extends, a piece of thread."""
COLOUR_DEVIATION_RANGE = np.array([[8.0, 4.0, 4.0], [24.0, 8.0, 8.0]], np.float32)
"""Least and greatest deviation of a thread's own colour (OpenCV's 8-bit L, a, b)."""
LEAST_SHARE_OF_THREAD, MOSTLY_THREAD = 0.4, 0.8
"""In a mixed pixel: what is credited at least, and what is enough to learn the thread's colour from."""
RAREST = 6.0
"""Deviations from the image's colours beyond which a colour is not rarer still."""
EDGE_SHARE = 0.6
"""Of the contrast in the thread's middle: its edge. Blur and shadow widen the thread, so more than one half."""
LEAST_COLOUR_PIXELS = 8

MEAN_OF_CHANNELS = np.full((1, 3), 1 / 3, np.float32)
EIGHT_NEIGHBOURS = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class _Found:
    """Ridge pixels of one polarity that look like thread, the contrast they were found in, and their strength."""

    ridge: Bool[np.ndarray, "h w"]
    contrast: Float32[np.ndarray, "h w"]
    strength: float


def segment_ridge(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """Coverage of each pixel by thread, 0 or 255: dark or bright thread, whichever stands out more."""
    reduced = _reduced(image, min(1.0, DETECTION_WIDTH_PX / image.shape[1]))
    background = _background(reduced)
    colour, ground = _lab(reduced), _lab(background)
    rarity = _rarity(colour)
    dark, bright = (
        _thread_among(contrast, rarity, colour, ground)
        for contrast in (_mean_excess(background, reduced), _mean_excess(reduced, background))
    )
    full_background = cv2.resize(background, image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    if bright.strength > dark.strength:
        return _at_full_size(bright, _mean_excess(image, full_background))
    return _at_full_size(dark, _mean_excess(full_background, image))


def line_response(contrast: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """How much each pixel looks like part of a line: its contrast in grey levels, seen by the best oriented filter."""
    strongest = np.zeros(contrast.shape, np.float32)
    for kernel in ORIENTED_KERNELS:
        answer = cv2.filter2D(contrast, cv2.CV_32F, kernel, borderType=cv2.BORDER_REFLECT)
        np.maximum(strongest, answer, out=strongest)
    return strongest


def _oriented_kernels() -> list[Float32[np.ndarray, "k k"]]:
    """Second derivative across, Gaussian along; each sums to 0 and its magnitudes to 2."""
    radius = round(2.5 * ALONG_PX)
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float32)
    kernels: list[np.ndarray] = []
    for angle in np.arange(ORIENTATIONS) * (np.pi / ORIENTATIONS):
        u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        kernel = (1 - (v / ACROSS_PX) ** 2) * np.exp(-0.5 * (v / ACROSS_PX) ** 2 - 0.5 * (u / ALONG_PX) ** 2)
        kernel -= kernel.mean()
        kernels.append((2 * kernel / np.abs(kernel).sum()).astype(np.float32))
    return kernels


ORIENTED_KERNELS = _oriented_kernels()


def _reduced(image: np.ndarray, share: float) -> np.ndarray:
    size = (max(1, round(image.shape[1] * share)), max(1, round(image.shape[0] * share)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _background(image: UInt8[np.ndarray, "h w 3"]) -> np.ndarray:
    median = cv2.medianBlur(_reduced(image, 0.5), BACKGROUND_WINDOW)
    return cv2.resize(median, image.shape[1::-1], interpolation=cv2.INTER_LINEAR)


def _lab(image: np.ndarray) -> Float32[np.ndarray, "h w 3"]:
    return cv2.cvtColor(image, cv2.COLOR_BGR2Lab).astype(np.float32)


def _mean_excess(image: np.ndarray, other: np.ndarray) -> Float32[np.ndarray, "h w"]:
    """How much brighter an image is than the other, the mean over the channels of what is above 0."""
    return cv2.transform(cv2.subtract(image, other).astype(np.float32), MEAN_OF_CHANNELS).astype(np.float32, copy=False)


def _rarity(colour: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w"]:
    """Mahalanobis distance of each pixel's colour from those of the whole image, up to a limit."""
    sample = colour[::4, ::4].reshape(-1, 3)
    from_mean = sample - sample.mean(axis=0)
    spread, axes = np.linalg.eigh(from_mean.T @ from_mean / len(sample) + 4.0 * np.eye(3))
    whitened = (colour - np.median(sample, axis=0)) @ (axes / np.sqrt(spread)).astype(np.float32)
    return np.minimum(np.linalg.norm(whitened, axis=2), RAREST)


def _thread_among(
    contrast: Float32[np.ndarray, "h w"],
    rarity: Float32[np.ndarray, "h w"],
    colour: Float32[np.ndarray, "h w 3"],
    ground: Float32[np.ndarray, "h w 3"],
) -> _Found:
    """The thread among the ridges of a contrast."""
    response = line_response(contrast)
    score = response * rarity
    labels, weight, _ = _pieces(_hysteresis(score), score)
    if not weight.any():
        return _Found(np.zeros(score.shape, bool), contrast, 0.0)
    strong = float(np.percentile(response, STRONG_PERCENTILE))
    ridge = response > FAINT_SHARE * strong
    away = np.full(score.shape, np.inf, np.float32)
    piece = labels == int(np.argmax(weight))
    away[ridge] = _colour_distance(colour[ridge], ground[ridge], score[ridge], piece[ridge])
    alike = ridge & (away < GROWN_COLOUR_LIMIT)
    seeds = (response > SEED_SHARE * strong) & (away < COLOUR_LIMIT)
    labels, weight, extent = _pieces(components_with_seed(alike, seeds, 0), score)
    kept = (weight > LEAST_WEIGHT_SHARE * weight.max()) & (
        extent > LEAST_EXTENT_SHARE * extent[weight > 0].max(initial=0)
    )
    # faint pixels would count for whichever polarity has more clutter to grow into
    _, clear_weight, _ = _pieces(components_with_seed(alike & (response > GROW_SHARE * strong), seeds, 0), score)
    return _Found(kept[labels], contrast, float(clear_weight.max()))


def _hysteresis(score: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    strong = float(np.percentile(score, STRONG_PERCENTILE))
    return components_with_seed(score > GROW_SHARE * strong, score > SEED_SHARE * strong, 0)


def _pieces(
    mask: Bool[np.ndarray, "h w"], score: Float32[np.ndarray, "h w"]
) -> tuple[Int32[np.ndarray, "h w"], Float64[np.ndarray, "c"], Float64[np.ndarray, "c"]]:
    """Labels of the connected pieces; the total score (0 of ground and of specks) and the extent of each."""
    count, labelled, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    extent = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    labels = np.asarray(labelled, np.int32)
    weight = np.bincount(labels.ravel(), weights=score.ravel(), minlength=count)
    weight[0] = 0.0
    weight[extent < LEAST_LENGTH_PX] = 0.0
    return labels, weight, extent


def _colour_distance(
    colour: Float32[np.ndarray, "p 3"],
    ground: Float32[np.ndarray, "p 3"],
    score: Float32[np.ndarray, "p"],
    piece: Bool[np.ndarray, "p"],
) -> Float32[np.ndarray, "p"]:
    """How many deviations each pixel's colour is from a mixture of the thread's and its own ground's, in two rounds.

    The colour c of a pixel with the share α of thread is α t + (1 − α) g; what α leaves over of c − g, over α, is how
    far the thread in it would have to be from t. The piece of thread may have grown into vessels that it crosses, so t
    is first the median of its best-scored quarter.
    """
    own = piece & (score >= np.percentile(score[piece], 75, method="lower")) if piece.any() else piece
    away = np.full(len(colour), np.inf, np.float32)
    for least in (1, LEAST_COLOUR_PIXELS):
        if own.sum() < least:
            break
        thread = np.median(colour[own], axis=0)
        deviation = np.clip(1.4826 * np.median(np.abs(colour[own] - thread), axis=0), *COLOUR_DEVIATION_RANGE)
        seen, whole = (colour - ground) / deviation, (thread - ground) / deviation
        along = np.einsum("pc,pc->p", seen, whole) / np.maximum(np.einsum("pc,pc->p", whole, whole), 1e-6)
        share = np.clip(along, LEAST_SHARE_OF_THREAD, 1.0)
        away = np.linalg.norm(seen - share[:, None] * whole, axis=1) / share
        own = piece & (away < COLOUR_LIMIT) & (share > MOSTLY_THREAD)
    return away


def _at_full_size(found: _Found, contrast: Float32[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """The thread's pixels in the full image: beside the ridge, with enough of the contrast of its middle."""
    ridge = found.ridge.astype(np.uint8)
    middle = cv2.dilate(np.where(found.ridge, found.contrast, 0.0).astype(np.float32), EIGHT_NEIGHBOURS)
    level = cv2.GaussianBlur(middle * ridge, (0, 0), 2.0) / np.maximum(
        cv2.GaussianBlur(ridge.astype(np.float32), (0, 0), 2.0), 1e-3
    )
    size = contrast.shape[::-1]
    beside = cv2.resize(cv2.dilate(ridge, EIGHT_NEIGHBOURS), size, interpolation=cv2.INTER_NEAREST) > 0
    edge = EDGE_SHARE * cv2.resize(level, size, interpolation=cv2.INTER_LINEAR)
    return np.where(beside & (contrast > edge), 255, 0).astype(np.uint8)
