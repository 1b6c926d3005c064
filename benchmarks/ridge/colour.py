"""Colours of ridges: how rare they are in the image, and how far from the thread's."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

RAREST = 6.0
"""Deviations from the image's colours beyond which a colour is not rarer still."""
COLOUR_LIMIT = 3.0
"""Deviations from the thread's colour up to which a pixel is certainly thread."""
COLOUR_DEVIATION_RANGE = np.array([[8.0, 4.0, 4.0], [24.0, 8.0, 8.0]], np.float32)
"""Least and greatest deviation of a thread's own colour (OpenCV's 8-bit L, a, b)."""
LEAST_SHARE_OF_THREAD, MOSTLY_THREAD = 0.4, 0.8
"""In a mixed pixel: what is credited at least, and what is enough to learn the thread's colour from."""
LEAST_COLOUR_PIXELS = 8
LEAST_EXPECTED = 8.0
"""In grey levels: over ground of the thread's own colour no contrast is expected, and nothing is told by its share."""

THIRDS = np.full(3, 1 / 3, np.float32)


@dataclass(frozen=True)
class Rare:
    """The usual colour of an image, and what takes differences from it to deviations."""

    usual: Float32[np.ndarray, "3"]
    whitening: Float32[np.ndarray, "3 3"]


def lab_of(colour: UInt8[np.ndarray, "p 3"]) -> Float32[np.ndarray, "p 3"]:
    """OpenCV's 8-bit Lab of colours, blue first."""
    if len(colour) == 0:
        return np.zeros((0, 3), np.float32)
    return np.asarray(cv2.cvtColor(colour[None], cv2.COLOR_BGR2Lab), np.float32)[0]


def rare_in(sample: UInt8[np.ndarray, "h w 3"]) -> Rare:
    """What is rare in an image, by a sample of it."""
    channels = np.ascontiguousarray(lab_of(sample.reshape(-1, 3)).T)
    from_mean = channels - channels.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(from_mean @ from_mean.T / channels.shape[1] + 4.0 * np.eye(3))
    return Rare(medians(channels)[:, 0], (axes / np.sqrt(spread)).astype(np.float32))


def rarity(colour: Float32[np.ndarray, "p 3"], rare: Rare) -> Float32[np.ndarray, "p"]:
    """Mahalanobis distance of each colour from those of the whole image, up to a limit."""
    # subtracted first: the usual colour then is not rare at all, not even by a rounding error
    away = (colour - rare.usual) @ rare.whitening
    return np.minimum(np.sqrt(np.einsum("pc,pc->p", away, away)), np.float32(RAREST))


def deviations_from_thread(
    colour: Float32[np.ndarray, "p 3"],
    ground: Float32[np.ndarray, "p 3"],
    best: Bool[np.ndarray, "p"],
    piece: Bool[np.ndarray, "p"],
) -> Float32[np.ndarray, "p"]:
    """How many deviations each pixel's colour is from a mixture of the thread's and its own ground's, in two rounds.

    The colour c of a pixel with the share α of thread is α t + (1 − α) g; what α leaves over of c − g, over α, is how
    far the thread in it would have to be from t. The piece of thread may have grown into vessels that it crosses, so t
    is first the median of its best part.
    """
    own, away = best, np.full(len(colour), np.inf, np.float32)
    channels, ground_channels = (np.ascontiguousarray(part.T) for part in (colour, ground))
    from_ground = channels - ground_channels
    for least in (1, LEAST_COLOUR_PIXELS):
        if np.count_nonzero(own) < least:
            break
        known = channels[:, own]
        thread = medians(known)
        spread = 1.4826 * medians(np.abs(known - thread))
        per_deviation = 1 / np.clip(spread, *COLOUR_DEVIATION_RANGE[:, :, None])
        seen, whole = from_ground * per_deviation, (thread - ground_channels) * per_deviation
        along = (seen * whole).sum(axis=0) / np.maximum((whole * whole).sum(axis=0), 1e-6)
        share = np.clip(along, LEAST_SHARE_OF_THREAD, 1.0)
        left = seen - share * whole
        away = np.sqrt((left * left).sum(axis=0)) / share
        own = piece & (away < COLOUR_LIMIT) & (share > MOSTLY_THREAD)
    return away


def expected_contrast(
    thread: Float32[np.ndarray, "3"], ground: UInt8[np.ndarray, "p 3"], is_bright: bool, most: float
) -> Float32[np.ndarray, "p"]:
    """How much brighter, or darker, thread of a colour would be than each ground, up to a limit."""
    excess = (thread - ground) if is_bright else (ground - thread)
    # over an axis of three, NumPy's own mean takes three times as long
    return np.clip(np.maximum(excess, 0) @ THIRDS, LEAST_EXPECTED, most).astype(np.float32, copy=False)


def medians(channels: Float32[np.ndarray, "c p"]) -> Float32[np.ndarray, "c 1"]:
    """Of at least one value of each channel: NumPy's own takes twice as long."""
    half, odd = divmod(channels.shape[1], 2)
    both = half - 1 + odd, half
    ordered = np.partition(channels, both, axis=1)
    return np.float32(0.5) * (ordered[:, both[0], None] + ordered[:, both[1], None])
