"""What each pixel of an image shows, ground, thread, needle or instrument, by a trained network that OpenCV runs.

The network has the form of `network`: the four pixels of each square go in side by side at half resolution, and the
logits of their classes come out. docs/model_card.md says what it has learned.
"""

import functools
from collections import deque
from enum import IntEnum
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from agents.perception.segmentation.network import MULTIPLE_PX, USUAL_WIDTH_PX, WIDEST_PX, phases

WEIGHTS = Path(__file__).with_name("classes.onnx")


class Kind(IntEnum):
    """What a pixel shows; also the place of its score."""

    GROUND = 0
    THREAD = 1
    NEEDLE = 2
    INSTRUMENT = 3


def classes_of(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """The class of each pixel, a `Kind`: the one that scores highest."""
    return highest(scores_of(image))


def highest(scores: Float32[np.ndarray, "h w 4"]) -> UInt8[np.ndarray, "h w"]:
    """The class that scores highest at each pixel, the first of those that score alike."""
    return scores.argmax(axis=2).astype(np.uint8)


def scores_of(image: UInt8[np.ndarray, "h w 3"], weights: Path = WEIGHTS) -> Float32[np.ndarray, "h w 4"]:
    """How likely each pixel shows each class, 0 to 1, in all 1; images wider than 1280 px are looked at 960 px wide."""
    height, width = image.shape[:2]
    if width <= WIDEST_PX:
        return _looked_at(image, weights)
    size = USUAL_WIDTH_PX, max(1, round(height * USUAL_WIDTH_PX / width))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    scores = cv2.resize(_looked_at(small, weights), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(scores, np.float32)


def _looked_at(image: UInt8[np.ndarray, "h w 3"], weights: Path) -> Float32[np.ndarray, "h w 4"]:
    height, width = image.shape[:2]
    below, beside = -height % MULTIPLE_PX, -width % MULTIPLE_PX
    padded = cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REFLECT_101) if below or beside else image
    logits = _forward(phases(np.ascontiguousarray(padded)), weights)
    return np.ascontiguousarray(together(_shares(logits))[:height, :width])


def _shares(logits: Float32[np.ndarray, "1 16 r c"]) -> Float32[np.ndarray, "4 4 r c"]:
    """The scores of all classes of each of the four pixels of a square, in all 1."""
    rows, columns = logits.shape[2:]
    of_pixel = logits.reshape(4, len(Kind), rows, columns)
    raised = np.exp(of_pixel - of_pixel.max(axis=1, keepdims=True))
    return raised / raised.sum(axis=1, keepdims=True)


def together(shares: Float32[np.ndarray, "4 k r c"]) -> Float32[np.ndarray, "h w k"]:
    """What is known of the four pixels of each square, as an image."""
    _, kinds, rows, columns = shares.shape
    apart = shares.reshape(2, 2, kinds, rows, columns).transpose(3, 0, 4, 1, 2)
    return np.ascontiguousarray(apart).reshape(2 * rows, 2 * columns, kinds)


_idle: dict[Path, deque[cv2.dnn.Net]] = {}
"""One of OpenCV's networks can be run by one thread at a time."""


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
