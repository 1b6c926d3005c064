"""What each pixel of an image shows, ground, thread, needle or instrument, by a trained network that OpenCV runs.

The network works at half resolution and loses nothing by it: the four pixels of each square go in side by side, and
the logits of their classes come out. So its answer has the image's own resolution at a quarter of the cost.
docs/model_card.md says what it has learned.
"""

import functools
from collections import deque
from enum import IntEnum
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from agents.perception.segmentation.boxes import MULTIPLE_PX, boxes_around

WEIGHTS = Path(__file__).with_name("classes.onnx")
NARROWEST_PX, USUAL_WIDTH_PX, WIDEST_PX = 720, 960, 1280
"""Narrower and wider images are looked at in the usual width, in which the network has learned how wide threads are."""
MOST_ENLARGED = 2
"""A still narrower image is no camera's."""


Image = UInt8[np.ndarray, "h w 3"]
Logits = Float32[np.ndarray, "4 4 r c"]
"""Of each of the four pixels of a square, of each class."""
ThreadScore = UInt8[np.ndarray, "h w 2"]
"""How likely each pixel shows thread, and how likely metal, a needle or an instrument; 0 to 255."""


class Kind(IntEnum):
    """What a pixel shows; also the place of its score."""

    GROUND = 0
    THREAD = 1
    NEEDLE = 2
    INSTRUMENT = 3


def as_usual(image: Image) -> Image:
    """The image as wide as the network has learned threads in."""
    height, width = image.shape[:2]
    usual = _usual_width(width)
    return resized(image, (max(1, round(height * usual / width)), usual))


def resized(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Of so many rows and columns; the image itself, where it has them."""
    size = shape[1], shape[0]
    if image.shape[1::-1] == size:
        return image
    way = cv2.INTER_AREA if size[0] < image.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size, interpolation=way))


def highest(scores: Float32[np.ndarray, "h w 4"]) -> UInt8[np.ndarray, "h w"]:
    """The class that scores highest at each pixel, a `Kind`; the first of those that score alike."""
    return scores.argmax(axis=2).astype(np.uint8)


def scores_of(image: Image, weights: Path = WEIGHTS) -> Float32[np.ndarray, "h w 4"]:
    """How likely each pixel shows each class, 0 to 1, in all 1."""
    seen = as_usual(image)
    scores = together(_shares(_logits(seen, weights)))[: seen.shape[0], : seen.shape[1]]
    return np.asarray(resized(np.ascontiguousarray(scores), image.shape[:2]), np.float32)


def scores_where(image: Image, where: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w 4"]:
    """As `scores_of`, within a part of an image and some pixels around it; 0 elsewhere."""
    seen = as_usual(image)
    within = where if where.shape == seen.shape[:2] else resized(where.view(np.uint8), seen.shape) > 0
    scores = np.zeros((*seen.shape[:2], len(Kind)), np.float32)
    for box in boxes_around(within):
        part = np.ascontiguousarray(seen[box.outer])
        rows, columns = part.shape[:2]
        scores[box.inner] = together(_shares(_logits(part, WEIGHTS)))[:rows, :columns][box.inner_in_outer]
    return np.asarray(resized(scores, image.shape[:2]), np.float32)


def thread_score(image: Image, where: Bool[np.ndarray, "h w"] | None = None) -> ThreadScore:
    """How likely each pixel of an image of usual width shows thread, and metal; 0 where the network has not looked.

    Args:
        where: what is looked at, with what lies around; everything, if it is None.
    """
    if where is None:
        return _thread_score(image)
    score = np.zeros((*image.shape[:2], 2), np.uint8)
    for box in boxes_around(where):
        score[box.inner] = _thread_score(np.ascontiguousarray(image[box.outer]))[box.inner_in_outer]
    return np.where(where[..., None], score, np.uint8(0))


def score_within(image: Image, box: tuple[slice, slice]) -> ThreadScore:
    """As `thread_score`, of each pixel of a box; the network sees nothing of what lies around."""
    part = np.ascontiguousarray(image[box])
    share = _usual_width(image.shape[1]) / image.shape[1]
    seen = resized(part, (max(1, round(part.shape[0] * share)), max(1, round(part.shape[1] * share))))
    return np.asarray(resized(_thread_score(seen), part.shape[:2]), np.uint8)


def kinds_of_squares(image: Image) -> UInt8[np.ndarray, "r c"]:
    """The class of each square of four pixels, the one with the greatest mean logit: half as many rows and columns."""
    rows, columns = ((side + 1) // 2 for side in image.shape[:2])
    return _logits(image, WEIGHTS).mean(axis=0)[:, :rows, :columns].argmax(axis=0).astype(np.uint8)


def phases(image: Image) -> Float32[np.ndarray, "1 12 r c"]:
    """An image as the network takes it: at half size, the four pixels of each square as channels, 0 to 1."""
    rows, columns = image.shape[0] // 2, image.shape[1] // 2
    apart = image.reshape(rows, 2, columns, 2, 3).transpose(1, 3, 4, 0, 2)
    return np.multiply(apart, np.float32(1 / 255), dtype=np.float32, order="C").reshape(1, 12, rows, columns)


def together(shares: Float32[np.ndarray, "4 k r c"]) -> Float32[np.ndarray, "h w k"]:
    """What is known of the four pixels of each square, as an image."""
    _, kinds, rows, columns = shares.shape
    apart = shares.reshape(2, 2, kinds, rows, columns).transpose(3, 0, 4, 1, 2)
    return np.ascontiguousarray(apart).reshape(2 * rows, 2 * columns, kinds)


def _usual_width(width: int) -> int:
    return width if NARROWEST_PX <= width <= WIDEST_PX else min(USUAL_WIDTH_PX, MOST_ENLARGED * width)


def _thread_score(image: Image) -> ThreadScore:
    height, width = image.shape[:2]
    logits = _logits(image, WEIGHTS)
    thread = logits[:, Kind.THREAD]
    ground, needle, instrument = (np.exp(logits[:, kind] - thread) for kind in Kind if kind is not Kind.THREAD)
    metal = needle + instrument
    share = 1 / (1 + ground + metal)
    rows, columns = thread.shape[1:]
    whole = np.empty((2 * rows, 2 * columns, 2), np.uint8)
    for channel, of_squares in enumerate((share, metal * share)):
        levels = cv2.convertScaleAbs(of_squares.reshape(4, -1), alpha=255)
        for row, (even, odd) in enumerate(levels.reshape(2, 2, rows, columns)):
            whole[row::2, :, channel] = cv2.merge((even, odd)).reshape(rows, -1)
    return whole[:height, :width]


def _shares(logits: Logits) -> Float32[np.ndarray, "4 4 r c"]:
    """The scores of all classes of each of the four pixels of a square, in all 1."""
    raised = np.exp(logits - logits.max(axis=1, keepdims=True))
    return raised / raised.sum(axis=1, keepdims=True)


def _logits(image: Image, weights: Path) -> Logits:
    """Of an image, mirrored at its lower and right borders to sides that the network can halve."""
    height, width = image.shape[:2]
    below, beside = -height % MULTIPLE_PX, -width % MULTIPLE_PX
    padded = cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REFLECT_101) if below or beside else image
    logits = _forward(phases(np.ascontiguousarray(padded)), weights)
    return logits.reshape(4, len(Kind), *logits.shape[2:])


_idle: dict[Path, deque[cv2.dnn.Net]] = {}
"""Both eyes are looked at at once, and one of OpenCV's networks can be run by one thread at a time."""


def _forward(pixels: Float32[np.ndarray, "1 12 r c"], weights: Path) -> Float32[np.ndarray, "1 16 r c"]:
    idle = _idle.setdefault(weights, deque())
    try:
        net = idle.pop()
    except IndexError:
        # the newer engine is slower, and takes images of one size only
        net = cv2.dnn.readNetFromONNX(_bytes(weights), cv2.dnn.ENGINE_CLASSIC)
    net.setInput(pixels)
    # what a network returns is its own memory, which its next image overwrites
    logits = np.array(net.forward(), np.float32)
    idle.append(net)
    return logits


@functools.cache
def _bytes(weights: Path) -> UInt8[np.ndarray, "b"]:
    return np.frombuffer(weights.read_bytes(), np.uint8)
