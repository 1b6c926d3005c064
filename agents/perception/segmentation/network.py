"""Thread on textured ground by a trained network, which OpenCV runs: docs/model_card.md says what it has learned.

The network works at half resolution and loses nothing by it: the four pixels of each square go in side by side, and
four coverages come out. So its answer has the image's own resolution at a quarter of the cost. Where it is known about
where the thread is, only boxes around that are looked at.
"""

import functools
from collections import deque
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64, UInt8

from agents.perception.segmentation.boxes import boxes_around
from agents.perception.segmentation.connected import extents, of_pixels
from agents.perception.segmentation.near import Meant, Near, piece_meant

WEIGHTS = Path(__file__).with_name("network.onnx")
MULTIPLE_PX = 16
"""Sides of what the network takes: it halves them four times."""
WIDEST_PX, USUAL_WIDTH_PX = 1280, 960
"""Wider images are looked at in the usual width, in which the network has learned how wide threads are."""
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
    where = None if near is None else near.where
    if image.shape[1] > WIDEST_PX:
        share = USUAL_WIDTH_PX / image.shape[1]
        size = USUAL_WIDTH_PX, max(1, round(image.shape[0] * share))
        small = None if where is None else cv2.resize(where.view(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        score = thread_score(cv2.resize(image, size, interpolation=cv2.INTER_AREA), small)
        score = np.asarray(cv2.resize(score, image.shape[1::-1], interpolation=cv2.INTER_LINEAR), np.uint8)
    else:
        score = thread_score(image, where)
    thread = thread_in(score if where is None else np.where(where, score, np.uint8(0)), image)
    if meant is not None and meant.alone:
        thread = piece_meant(thread, meant.weight)
    return np.multiply(thread, np.uint8(255), dtype=np.uint8), score


def thread_score(
    image: UInt8[np.ndarray, "h w 3"], where: Bool[np.ndarray, "h w"] | None = None
) -> UInt8[np.ndarray, "h w"]:
    """How much of each pixel the network holds to be thread, 0 to 255; 0 where it has not looked.

    Args:
        where: what is looked at, with what lies around; everything, if it is None.
    """
    if where is None:
        return _looked_at(image)
    score = np.zeros(image.shape[:2], np.uint8)
    for box in boxes_around(where):
        inner = box.inner
        score[inner] = _looked_at(np.ascontiguousarray(image[box.outer]))[box.inner_in_outer]
    return score


def score_within(image: UInt8[np.ndarray, "h w 3"], box: tuple[slice, slice]) -> UInt8[np.ndarray, "r c"]:
    """How much of each pixel of a box the network holds to be thread, 0 to 255; it sees nothing of what lies around."""
    part = np.ascontiguousarray(image[box])
    if image.shape[1] <= WIDEST_PX:
        return _looked_at(part)
    share = USUAL_WIDTH_PX / image.shape[1]
    score = _looked_at(np.asarray(cv2.resize(part, None, fx=share, fy=share, interpolation=cv2.INTER_AREA), np.uint8))
    return np.asarray(cv2.resize(score, part.shape[1::-1], interpolation=cv2.INTER_LINEAR), np.uint8)


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


def _looked_at(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    height, width = image.shape[:2]
    below, beside = -height % MULTIPLE_PX, -width % MULTIPLE_PX
    padded = cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REFLECT_101) if below or beside else image
    return together(_forward(phases(padded)))[:height, :width]


def phases(image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "1 12 r c"]:
    """An image as the network takes it: at half size, the four pixels of each square as channels, 0 to 1."""
    rows, columns = image.shape[0] // 2, image.shape[1] // 2
    apart = image.reshape(rows, 2, columns, 2, 3).transpose(1, 3, 4, 0, 2)
    return np.multiply(apart, np.float32(1 / 255), dtype=np.float32, order="C").reshape(1, 12, rows, columns)


def together(coverage: Float32[np.ndarray, "1 4 r c"]) -> UInt8[np.ndarray, "h w"]:
    """Coverage as the network gives it, of 0 to 1, as an image of 0 to 255."""
    rows, columns = coverage.shape[2:]
    of_row = cv2.convertScaleAbs(coverage.reshape(4, -1), alpha=255).reshape(2, 2, rows, columns)
    image = np.empty((2 * rows, 2 * columns), np.uint8)
    for row, (even, odd) in enumerate(of_row):
        image[row::2] = cv2.merge((even, odd)).reshape(rows, -1)
    return image


_idle: deque[cv2.dnn.Net] = deque()
"""Both eyes are looked at at once, and one of OpenCV's networks can be run by one thread at a time."""


def _forward(pixels: Float32[np.ndarray, "1 12 r c"]) -> Float32[np.ndarray, "1 4 r c"]:
    try:
        net = _idle.pop()
    except IndexError:
        # the newer engine is slower, and takes images of one size only
        net = cv2.dnn.readNetFromONNX(_weights(), cv2.dnn.ENGINE_CLASSIC)
    net.setInput(pixels)
    coverage = np.asarray(net.forward(), np.float32)
    _idle.append(net)
    return coverage


@functools.cache
def _weights() -> UInt8[np.ndarray, "b"]:
    return np.frombuffer(WEIGHTS.read_bytes(), np.uint8)
