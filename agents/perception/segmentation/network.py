"""Thread on any ground: the pieces of an image that a trained network holds to be thread (`classes`)."""

import cv2
import numpy as np
from jaxtyping import Bool, Int32, Int64, UInt8

from agents.perception.segmentation.classes import as_usual, resized, thread_score
from agents.perception.segmentation.connected import extents, of_pixels
from agents.perception.segmentation.near import Meant, Near, piece_meant

LEAST_COVERAGE = 96
"""Of a pixel by thread, where thread was found in a larger copy: a thread thinner than a pixel may fall between two."""
SEGMENTED, SURE = 104, 192
"""Score of a pixel that is thread, and that which each piece of thread must reach somewhere."""
LEAST_MEAN = 160
"""Score of a piece of thread: what is none may look like it in places, but seldom as a whole."""
LEAST_EXTENT_PX = 24
"""Shorter pieces are specks."""
FAINTEST, AROUND_PX = 32, 9
"""Score down to which a line goes on from thread, where it is a line: where it scores no less against what lies so near
than the border of a thread does. So it stays as wide as the thread is, wherever it is faint."""
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
    thread = resized(np.multiply(thread_in(score), np.uint8(255), dtype=np.uint8), image.shape) >= LEAST_COVERAGE
    if meant is not None and meant.alone:
        thread = piece_meant(thread, meant.weight)
    score = np.asarray(resized(score, image.shape), np.uint8)
    return np.multiply(thread, np.uint8(255), dtype=np.uint8), score


def thread_in(score: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The connected pieces that are thread, long ones that score high, on average and at best, and how they go on.

    As edges are told by two thresholds (Canny 1986): what is faint is thread where it is connected to what is not.
    """
    high_enough = score >= SEGMENTED
    count, labelled = cv2.connectedComponents(high_enough.view(np.uint8), connectivity=8)
    # few pixels are that high, and looking at them alone takes a third of the time
    pixel = np.flatnonzero(high_enough)
    piece = np.asarray(labelled, np.int32).ravel()[pixel]
    is_thread = _is_thread(pixel, piece, score, count)
    thread = of_pixels(pixel[is_thread[piece]], score.shape)
    return _gone_on(thread, score) if thread.any() else thread


def _gone_on(thread: Bool[np.ndarray, "h w"], score: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Thread with the fainter lines that are connected to it."""
    highest = np.asarray(cv2.dilate(score, np.ones((2 * AROUND_PX + 1, 2 * AROUND_PX + 1), np.uint8)))
    border = cv2.convertScaleAbs(highest, alpha=SEGMENTED / 255)
    line = (score >= FAINTEST) & (score >= border) | thread
    _, labelled = cv2.connectedComponents(line.view(np.uint8), connectivity=8)
    pixel = np.flatnonzero(line)
    piece = np.asarray(labelled, np.int32).ravel()[pixel]
    goes_on = np.zeros(int(piece.max()) + 1, bool)
    goes_on[piece[thread.ravel()[pixel]]] = True
    return of_pixels(pixel[goes_on[piece]], score.shape)


def _is_thread(
    pixel: Int64[np.ndarray, "p"], piece: Int32[np.ndarray, "p"], score: UInt8[np.ndarray, "h w"], count: int
) -> Bool[np.ndarray, "c"]:
    """Which of the connected pieces of those pixels are thread; the ground, 0, is none."""
    extent = extents(piece, pixel, score.shape[1], count)
    of_pixel = score.ravel()[pixel]
    best = np.zeros(count, np.uint8)
    np.maximum.at(best, piece, of_pixel)
    mean = np.bincount(piece, weights=of_pixel, minlength=count) / np.maximum(np.bincount(piece, minlength=count), 1)
    thread = (best >= SURE) & (extent >= LEAST_EXTENT_PX) & (mean >= LEAST_MEAN)
    return np.asarray(thread & bool(extent[thread].max(initial=0.0) >= LEAST_THREAD_PX))
