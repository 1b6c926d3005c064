"""Thread on a plain ground: pixels that differ from the local background by more than its noise.

Made for synthetic scenes and for images that already are segmented (a thread on white). The contrast is relative to
the local background, because the thinnest thread is only a little darker than its ground.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Int64, UInt8

from agents.perception.segmentation.boxes import Meant, Near, piece_meant

BACKGROUND_SHARE = 0.06
"""Side of the window of the local background, as a share of the image's width: many times the thread's width."""
NOISE_FACTOR = 6.0
"""Contrast below so many standard deviations of the ground is noise."""
LEAST_CONTRAST = 6.0
"""Compression leaves steps of a few grey levels even on a uniform ground."""
SEED_SHARE, GROW_SHARE = 0.45, 0.25
"""Of the thread's own contrast: what makes a pixel thread, and what extends it to its neighbours."""
FAINT_SHARE = 0.7
"""Of the least contrast: what still connects two clear stretches."""
BRIDGE_PX = 4
"""How far from a clear stretch faint pixels may close a gap."""
LEAST_AREA_SHARE = 4e-5
"""Of the image: what is smaller is a speck."""


def segment_threshold(
    image: UInt8[np.ndarray, "h w 3"], near: Near | None = None, meant: Meant | None = None
) -> UInt8[np.ndarray, "h w"]:
    """Coverage of each pixel by thread, 0 to 255, from its contrast to the local background.

    Args:
        near: where thread is looked for; pieces of which no clear part lies there are left out.
        meant: which piece is meant; all pieces, if it is None.
    """
    contrast = local_contrast(image)
    counts = np.bincount(contrast.ravel(), minlength=256)
    noise = 1.4826 * _quantile(counts, 0, 0.5)
    floor = max(LEAST_CONTRAST, NOISE_FACTOR * min(noise, LEAST_CONTRAST))
    if not (contrast > floor).any():
        return np.zeros(contrast.shape, np.uint8)
    full = _quantile(counts, floor, 0.8)
    visible = contrast > FAINT_SHARE * floor
    seeds = contrast > max(floor, SEED_SHARE * full)
    if near is not None:
        seeds &= near.where
    connected = components_with_seed(visible, seeds, LEAST_AREA_SHARE * contrast.size)
    clear = connected & (contrast > GROW_SHARE * full)
    # a thread thinner than a pixel fades between two rows or columns; what is faint there closes the gap
    closed = cv2.morphologyEx(clear.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0
    kept = with_bridges(clear | (closed & connected), connected)
    if meant is not None and meant.alone:
        kept = piece_meant(kept, meant.weight)
    coverage = np.clip(np.arange(256, dtype=np.float32) * (255.0 / full), 128.0, 255.0).astype(np.uint8)
    return np.where(kept, coverage[contrast], np.uint8(0))


def with_bridges(pieces: Bool[np.ndarray, "h w"], faint: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The pieces, and whatever is faint and leads over some pixels from one of them to another."""
    count, labels = cv2.connectedComponents(pieces.astype(np.uint8), connectivity=8)
    if count <= 2:
        return pieces
    reach = np.ones((2 * BRIDGE_PX + 1, 2 * BRIDGE_PX + 1), np.uint8)
    gaps = faint & ~pieces & (cv2.dilate(pieces.astype(np.uint8), reach) > 0)
    bridges, of_bridge = cv2.connectedComponents(gaps.astype(np.uint8), connectivity=8)
    # each faint pixel's neighbours among the pieces: the largest number, and the smallest
    beside = np.ones((3, 3), np.uint8)
    largest = cv2.dilate(labels.astype(np.float32), beside)[gaps].astype(np.int64)
    smallest = count - cv2.dilate(np.where(pieces, count - labels, 0).astype(np.float32), beside)[gaps].astype(np.int64)
    most, least = np.zeros(bridges, np.int64), np.full(bridges, count)
    touching = largest > 0
    numbers: Int64[np.ndarray, "h w"] = np.asarray(of_bridge, np.int64)
    bridge = numbers[gaps]
    np.maximum.at(most, bridge[touching], largest[touching])
    np.minimum.at(least, bridge[touching], smallest[touching])
    leads = most > least
    leads[0] = False
    return pieces | leads[numbers]


def _quantile(counts: Int64[np.ndarray, "256"], above: float, share: float) -> float:
    """A quantile of the grey levels above another, from how often each occurs; 0 where there are none."""
    counts = np.where(np.arange(len(counts)) > above, counts, 0)
    until = np.cumsum(counts)
    if until[-1] == 0:
        return 0.0
    rank = share * (until[-1] - 1)
    low, high = np.searchsorted(until, [np.floor(rank), np.ceil(rank)], side="right")
    return float(low + (high - low) * (rank - np.floor(rank)))


def local_contrast(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """The largest difference over the channels between each pixel and the median colour around it, in grey levels."""
    height, width = image.shape[:2]
    step = max(1, round(width / 320))
    small = cv2.resize(image, (max(1, width // step), max(1, height // step)), interpolation=cv2.INTER_AREA)
    window = max(3, round(BACKGROUND_SHARE * small.shape[1]) | 1)
    background = cv2.resize(cv2.medianBlur(small, window), (width, height), interpolation=cv2.INTER_LINEAR)
    blue, green, red = cv2.split(cv2.absdiff(image, background))
    return np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)


def components_with_seed(grown: np.ndarray, seeds: np.ndarray, least_area: float) -> np.ndarray:
    """The connected pieces of `grown` that hold a seed and are large enough: hysteresis."""
    count, labelled, stats, _ = cv2.connectedComponentsWithStats(grown.astype(np.uint8), connectivity=8)
    labels = np.asarray(labelled, np.int32)
    seeded = np.zeros(count, dtype=bool)
    seeded[labels[seeds & grown]] = True
    seeded[0] = False
    return (seeded & (stats[:, cv2.CC_STAT_AREA] >= least_area))[labels]
