"""Ridges that are darker than their surroundings, or brighter, and the piece of them that is thread if any is.

Clutter of the other polarity than the thread's has many times the ridges that thread has. So an image of half the width
and height tells first what speaks for either, and one for which far less does is looked at only where the other turns
out to be no thread.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from agents.perception.segmentation.near import Meant, Near
from benchmarks.ridge.colour import lab_of, rarity
from benchmarks.ridge.full_size import mean_excess
from benchmarks.ridge.line_filter import line_response, rough_line_response
from benchmarks.ridge.pieces import Pieces, Ridges, connected_pieces, from_top, weight_meant
from benchmarks.ridge.view import View

GLINT = 60.0
"""In grey levels: the contrast from which on what is bright counts alike."""
SEED_SHARE, GROW_SHARE, FAINT_SHARE = 0.5, 0.25, 0.15
"""Of the response of the image's strongest ridges: what seeds a piece of thread, what extends it, and what does so
where its colour is known to be the thread's: over dark ground a dark thread has little contrast."""
UNLIKELY_SHARE = 0.3
"""Of what speaks for one polarity at half the size: with less the other is no rival. In 144 images none with up to 0.4,
the share of a rival in full, was one."""
EVERY_SECOND = np.s_[::2, ::2]


@dataclass(frozen=True)
class Candidate:
    """Ridges of one polarity, and the piece of them that is thread if any is.

    Fields:
        contrast: of every pixel that is looked at, not of ridges alone.
        line: the same as far as it counts for lines.
        strong: the response of the image's strongest ridges.
        weight: what speaks for the piece; 0 where there is none.
    """

    is_bright: bool
    contrast: Float32[np.ndarray, "h w"]
    line: Float32[np.ndarray, "h w"]
    ridges: Ridges
    strong: float
    piece: Bool[np.ndarray, "p"]
    weight: float


def polarities(view: View, near: Near | None) -> tuple[list[bool], list[bool]]:
    """Whether thread may be brighter than its surroundings, or darker; and what only if it is none of these."""
    if near is not None:
        return [near.is_bright], []
    if view.meant is not None:
        return [False, True], []
    height, width = view.shape
    size = -(-width // 2), -(-height // 2)
    seen, background = (
        np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.uint8)
        for part in (view.seen, view.background)
    )
    weights = [_weight_at_a_glance(seen, background, is_bright, view) for is_bright in (False, True)]
    least = UNLIKELY_SHARE * max(weights)
    likely = [is_bright for is_bright in (False, True) if weights[is_bright] >= least]
    return likely, [is_bright for is_bright in (False, True) if is_bright not in likely]


def candidate_of(view: View, is_bright: bool) -> Candidate:
    """The ridges of one polarity, and what speaks for the best piece of them."""
    contrast, line = _contrast(view.seen, view.background, is_bright)
    about = None if view.instruments is None else view.instruments.about
    ridges = _ridges(_response(line, view.near), view.seen, about, view, view.strong)
    if len(ridges.pixel) == 0:
        return Candidate(is_bright, contrast, line, ridges, 0.0, np.zeros(0, bool), 0.0)
    pieces = _pieces(ridges, view.strong)
    weight = pieces.weight if view.meant is None else weight_meant(pieces, meant_score(ridges, view.meant))
    piece = pieces.of == int(np.argmax(weight))
    of_strongest = from_top(ridges.response[ridges.apart], view.strong)
    return Candidate(is_bright, contrast, line, ridges, of_strongest, piece, float(weight.max()))


def meant_score(ridges: Ridges, meant: Meant) -> Float32[np.ndarray, "p"]:
    """What speaks for each pixel."""
    return ridges.score * meant.weight.ravel()[ridges.pixel]


def _contrast(
    seen: UInt8[np.ndarray, "h w 3"], background: UInt8[np.ndarray, "h w 3"], is_bright: bool
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """How much brighter, or darker, each pixel is than its background; and the same as far as it counts for lines."""
    contrast = mean_excess(*((seen, background) if is_bright else (background, seen)))
    return contrast, np.minimum(contrast, np.float32(GLINT)) if is_bright else contrast


def _weight_at_a_glance(
    seen: UInt8[np.ndarray, "r c 3"], background: UInt8[np.ndarray, "r c 3"], is_bright: bool, view: View
) -> float:
    """What speaks for the best piece of a polarity in an image of half the width and height."""
    about = None if view.instruments is None else view.instruments.about[EVERY_SECOND]
    strong = view.strong / 4
    response = rough_line_response(_contrast(seen, background, is_bright)[1])
    ridges = _ridges(response, seen, about, view, strong)
    return float(_pieces(ridges, strong).weight.max()) if len(ridges.pixel) else 0.0


def _response(line: Float32[np.ndarray, "h w"], near: Bool[np.ndarray, "h w"] | None) -> Float32[np.ndarray, "h w"]:
    """The response to lines where thread may be, 0 elsewhere."""
    if near is None:
        return line_response(line)
    left, top, columns, rows = cv2.boundingRect(near.view(np.uint8))
    box = np.s_[top : top + rows, left : left + columns]
    response = np.zeros_like(line)
    np.multiply(line_response(line, *box), near[box], out=response[box])
    return response


def _ridges(
    response: Float32[np.ndarray, "h w"],
    seen: UInt8[np.ndarray, "h w 3"],
    about: Bool[np.ndarray, "h w"] | None,
    view: View,
    strong: float,
) -> Ridges:
    """The pixels that respond to lines enough to be looked at further.

    Args:
        about: where instruments are, or close; None where none are known.
        strong: how many pixels of the whole image are among its strongest.
    """
    free = response if about is None else np.where(about, np.float32(0), response)
    pixel = np.flatnonzero(response > FAINT_SHARE * from_top(free.ravel(), strong))
    of_pixel = response.ravel()[pixel]
    colour = lab_of(seen.reshape(-1, 3)[pixel])
    score = of_pixel * rarity(colour, view.rare)
    apart = np.ones(len(pixel), bool)
    if about is not None:
        apart = ~about.ravel()[pixel]
        score *= apart
    return Ridges(response.shape, pixel, of_pixel, score, colour, apart)


def _pieces(ridges: Ridges, strong: float) -> Pieces:
    """The connected pieces of ridges by their scores."""
    most = from_top(ridges.score, strong)
    return connected_pieces(ridges, ridges.score > GROW_SHARE * most, ridges.score > SEED_SHARE * most)
