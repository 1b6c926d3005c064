"""Thread on any ground: the pieces of an image that a trained network holds to be thread (`classes`)."""

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64, UInt8

from agents.perception.segmentation.classes import as_usual, resized, thread_score
from agents.perception.segmentation.connected import extents, of_pixels
from agents.perception.segmentation.near import Meant, Near, piece_meant

LEAST_COVERAGE = 96
"""Of a pixel by thread, where thread was found in a larger copy: a thread thinner than a pixel may fall between two."""
SEGMENTED, SURE = 104, 192
"""Score of a pixel that is thread, and that which each piece of thread must reach somewhere."""
LEAST_MEAN = 160
"""Score of a piece of thread: what is none may look like it in places, but seldom as a whole."""
FAINT_MEAN, HUE, BRIGHTNESS = 128, 3.0, 24.0
"""What is thread beyond doubt tells its colour; a piece of that colour may score so little on average. So much may it
differ: in OpenCV's 8-bit a and b together, and in L, as pieces of one thread do."""
LEAST_EXTENT_PX = 24
"""Shorter pieces are specks."""
GAP_PX = 24
"""So near to thread a piece is thread too though it is fainter or shorter: shade and glints interrupt a thread."""
LEAST_THREAD_PX = 48
"""An image whose pieces are all shorter shows no thread."""


def segment_network(
    image: UInt8[np.ndarray, "h w 3"], near: Near | None = None, meant: Meant | None = None
) -> UInt8[np.ndarray, "h w"]:
    """Coverage of each pixel by thread, 0 or 255: from where on the edges in the image tell its middle best.

    Args:
        near: where thread is looked for; anywhere, if it is None.
        meant: which piece is meant; all pieces, if it is None.
    """
    return segment_and_score(image, near, meant)[0]


def segment_and_score(
    image: UInt8[np.ndarray, "h w 3"], near: Near | None = None, meant: Meant | None = None
) -> tuple[UInt8[np.ndarray, "h w"], UInt8[np.ndarray, "h w"]]:
    """As `segment_network`, with the network's score of each pixel, 0 to 255."""
    seen, where = as_usual(image), None if near is None else near.where
    if where is not None and where.shape != seen.shape[:2]:
        where = cv2.resize(where.view(np.uint8), seen.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
    score = thread_score(seen, where)
    thread = resized(np.multiply(thread_in(score, seen), np.uint8(255), dtype=np.uint8), image.shape) >= LEAST_COVERAGE
    if meant is not None and meant.alone:
        thread = piece_meant(thread, meant.weight)
    score = np.asarray(resized(score, image.shape), np.uint8)
    return np.multiply(thread, np.uint8(255), dtype=np.uint8), score


def thread_in(
    score: UInt8[np.ndarray, "h w"], image: UInt8[np.ndarray, "h w 3"] | None = None
) -> Bool[np.ndarray, "h w"]:
    """The pieces that are thread: those that score high enough, and fainter ones beside them or of their colour.

    Args:
        image: what the score is of; if it is None, no colour counts.
    """
    high_enough = score >= SEGMENTED
    count, labelled = cv2.connectedComponents(high_enough.view(np.uint8), connectivity=8)
    # few pixels are that high, and looking at them alone takes a third of the time
    pixel = np.flatnonzero(high_enough)
    piece = np.asarray(labelled, np.int32).ravel()[pixel]
    sure, faint = _is_thread(pixel, piece, score, count)
    thread = of_pixels(pixel[sure[piece]], score.shape)
    if not sure.any() or sure[1:].all():
        return thread
    known = _alike(pixel, piece, image, sure, faint) | sure if image is not None and faint.any() else sure
    found = _and_beside(pixel, piece, score.shape, sure, faint) | known
    return of_pixels(pixel[found[piece]], score.shape)


def _and_beside(
    pixel: Int64[np.ndarray, "p"],
    piece: Int32[np.ndarray, "p"],
    shape: tuple[int, ...],
    sure: Bool[np.ndarray, "c"],
    faint: Bool[np.ndarray, "c"],
) -> Bool[np.ndarray, "c"]:
    """The pieces that are sure, those beside them, and faint ones beside these in turn, as a thread goes on."""
    reach = np.ones((2 * GAP_PX + 1, 2 * GAP_PX + 1), np.uint8)
    found, new, asked = sure, sure, ~sure
    while new.any() and (asked & ~found).any():
        beside = np.asarray(cv2.dilate(of_pixels(pixel[new[piece]], shape).view(np.uint8), reach)).view(bool)
        near = np.zeros(len(sure), bool)
        near[piece[beside.ravel()[pixel]]] = True
        new = near & asked & ~found
        found, asked = found | new, faint
    return found


def _alike(
    pixel: Int64[np.ndarray, "p"],
    piece: Int32[np.ndarray, "p"],
    image: UInt8[np.ndarray, "h w 3"],
    sure: Bool[np.ndarray, "c"],
    faint: Bool[np.ndarray, "c"],
) -> Bool[np.ndarray, "c"]:
    """Which of the faint pieces have the colour of one that is sure."""
    own, asked = (_colours(pixel, piece, image, np.flatnonzero(some)) for some in (sure, faint))
    apart = np.abs(asked[:, None] - own[None])
    near = (apart[..., 0] <= BRIGHTNESS) & (np.hypot(apart[..., 1], apart[..., 2]) <= HUE)
    alike = np.zeros(len(sure), bool)
    alike[faint] = near.any(axis=1)
    return alike


def _colours(
    pixel: Int64[np.ndarray, "p"], piece: Int32[np.ndarray, "p"], image: UInt8[np.ndarray, "h w 3"], some: np.ndarray
) -> Float64[np.ndarray, "k 3"]:
    """The median of L, a and b of some pieces."""
    seen = [image.reshape(-1, 3)[pixel[piece == number]] for number in some]
    return np.array([np.median(cv2.cvtColor(part[None], cv2.COLOR_BGR2Lab)[0], axis=0) for part in seen])


def _is_thread(
    pixel: Int64[np.ndarray, "p"], piece: Int32[np.ndarray, "p"], score: UInt8[np.ndarray, "h w"], count: int
) -> tuple[Bool[np.ndarray, "c"], Bool[np.ndarray, "c"]]:
    """Which of the connected pieces of those pixels are beyond doubt, and which fainter; the ground, 0, is neither."""
    extent = extents(piece, pixel, score.shape[1], count)
    of_pixel = score.ravel()[pixel]
    best = np.zeros(count, np.uint8)
    np.maximum.at(best, piece, of_pixel)
    mean = np.bincount(piece, weights=of_pixel, minlength=count) / np.maximum(np.bincount(piece, minlength=count), 1)
    may_be = (best >= SURE) & (extent >= LEAST_EXTENT_PX)
    thread = may_be & (mean >= LEAST_MEAN)
    thread &= bool(extent[thread].max(initial=0.0) >= LEAST_THREAD_PX)
    return thread, may_be & (mean >= FAINT_MEAN) & ~thread
