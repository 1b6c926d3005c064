"""Thread on any ground: the pieces of an image that a trained network holds to be thread (`classes`)."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64, UInt8

from agents.perception.segmentation.boxes import Meant, Near, extents, of_pixels, piece_meant
from agents.perception.segmentation.classes import ThreadScore, as_usual, resized, thread_score
from agents.perception.segmentation.line_ends import mean_log_odds, without_needles

LEAST_COVERAGE = 96
"""Of a pixel by thread, where thread was found in a larger copy: a thread thinner than a pixel may fall between two."""
FAINTEST, BORDER, AROUND_PX = 32, 0.4, 9
"""A pixel is part of a line where it scores so much at least, and such a share of the best that lies so near: so a line
is as wide as the thread is, wherever it is faint."""
WEIGHTS = 0.9, 0.32, 0.51, -1.0
"""Of what speaks for a line's being thread (`evidence`), in log-odds: fitted by `benchmarks.training.line_odds`."""
LEAST_LOG_ODDS = math.log(2)
"""From which a line, or its end, counts as thread: a false one costs twice what a missed one does."""


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
    of_thread = np.asarray(resized(np.ascontiguousarray(score[..., 0]), image.shape), np.uint8)
    return np.multiply(thread, np.uint8(255), dtype=np.uint8), of_thread


def thread_in(score: ThreadScore) -> Bool[np.ndarray, "h w"]:
    """The lines that are thread, by the odds of each as a whole."""
    lines = lines_in(score)
    log_odds = evidence(lines) @ WEIGHTS
    return of_pixels(lines.pixel[log_odds[lines.line] >= LEAST_LOG_ODDS], score.shape[:2])


@dataclass(frozen=True)
class Lines:
    """Connected lines of what may be thread.

    Fields:
        pixel: indices of their pixels; line: which each belongs to, from 1.
        length_px: of each, the diagonal of what it reaches over.
        of_ground, of_metal: the mean log-odds of its pixels of being thread and not the one or the other.
    """

    pixel: Int64[np.ndarray, "p"]
    line: Int32[np.ndarray, "p"]
    length_px: Float64[np.ndarray, "c"]
    of_ground: Float64[np.ndarray, "c"]
    of_metal: Float64[np.ndarray, "c"]


def evidence(lines: Lines) -> Float64[np.ndarray, "c 4"]:
    """What speaks for each line: its log-odds against ground and metal, its length's logarithm, and 1."""
    length = np.log(np.maximum(lines.length_px, 1) / 100)
    return np.column_stack((lines.of_ground, lines.of_metal, length, np.ones(len(length))))


def lines_in(score: ThreadScore) -> Lines:
    """The lines of a score, without needles at their ends, with what each shows."""
    is_line = without_needles(score, higher_than_around(score), LEAST_LOG_ODDS)
    count, labelled = cv2.connectedComponents(is_line.view(np.uint8), connectivity=8)
    # few pixels are that high, and looking at them alone takes a third of the time
    pixel = np.flatnonzero(is_line)
    line = np.asarray(labelled, np.int32).ravel()[pixel]
    of_ground, of_metal = mean_log_odds(score, pixel, line, count).T
    return Lines(pixel, line, extents(line, pixel, score.shape[1], count), of_ground, of_metal)


def higher_than_around(score: ThreadScore) -> Bool[np.ndarray, "h w"]:
    """Pixels that are likelier thread than their surroundings."""
    thread = np.ascontiguousarray(score[..., 0])
    best = np.asarray(cv2.dilate(thread, np.ones((2 * AROUND_PX + 1, 2 * AROUND_PX + 1), np.uint8)))
    return (thread >= FAINTEST) & (thread >= cv2.convertScaleAbs(best, alpha=BORDER))
