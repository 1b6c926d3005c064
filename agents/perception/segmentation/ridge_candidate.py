"""Ridges that are darker than their surroundings, or brighter, and the piece of them that is thread if any is.

Clutter of the other polarity than the thread's has many times the ridges that thread has. So every second pixel of
every second row tells first what speaks for either, and one for which far less does is looked at only where the other
turns out to be no thread.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from agents.perception.segmentation.full_size import mean_excess
from agents.perception.segmentation.line_filter import Bends, bends_of, line_response, sparse_line_response
from agents.perception.segmentation.near import Meant, Near
from agents.perception.segmentation.ridge_colour import lab_of, rarity
from agents.perception.segmentation.ridge_pieces import Pieces, Ridges, connected_pieces, from_top, weight_meant
from agents.perception.segmentation.ridge_view import View

GLINT = 60.0
"""In grey levels: the contrast from which on what is bright counts alike."""
SEED_SHARE, GROW_SHARE, FAINT_SHARE = 0.5, 0.25, 0.15
"""Of the response of the image's strongest ridges: what seeds a piece of thread, what extends it, and what does so
where its colour is known to be the thread's: over dark ground a dark thread has little contrast."""
UNLIKELY_SHARE = 0.25
"""Of what speaks for one polarity at every second pixel: with less the other is no rival. In 144 images none with up to
0.4, the share of a rival in full, was one."""
EVERY_SECOND = np.s_[::2, ::2]


@dataclass(frozen=True)
class Polarity:
    """What is darker, or brighter, than its surroundings.

    Fields:
        contrast: of every pixel that is looked at.
        line: the same as far as it counts for lines.
        bends: of that, where lines are looked for.
    """

    is_bright: bool
    contrast: Float32[np.ndarray, "h w"]
    line: Float32[np.ndarray, "h w"]
    bends: Bends


@dataclass(frozen=True)
class Candidate:
    """Ridges of one polarity, and the piece of them that is thread if any is.

    Fields:
        strong: the response of the image's strongest ridges.
        weight: what speaks for the piece; 0 where there is none.
    """

    polarity: Polarity
    ridges: Ridges
    strong: float
    piece: Bool[np.ndarray, "p"]
    weight: float


def polarities(view: View, near: Near | None) -> tuple[list[Polarity], list[Polarity]]:
    """Those of which one may be thread, and those that may be only if none of these is."""
    if near is not None:
        return [_polarity(view, near.is_bright)], []
    both = [_polarity(view, is_bright) for is_bright in (False, True)]
    if view.meant is not None:
        return both, []
    weights = [_weight_at_a_glance(polarity, view) for polarity in both]
    least = UNLIKELY_SHARE * max(weights)
    likely = [polarity for polarity, weight in zip(both, weights, strict=True) if weight >= least]
    return likely, [polarity for polarity, weight in zip(both, weights, strict=True) if weight < least]


def candidate_of(polarity: Polarity, view: View) -> Candidate:
    """The ridges of one polarity, and what speaks for the best piece of them."""
    response = _response(polarity.bends, view)
    about = None if view.instruments is None else view.instruments.about
    ridges = _ridges(response, view.seen, about, view, view.strong)
    if len(ridges.pixel) == 0:
        return Candidate(polarity, ridges, 0.0, np.zeros(0, bool), 0.0)
    pieces = _pieces(ridges, view.strong)
    weight = pieces.weight if view.meant is None else weight_meant(pieces, meant_score(ridges, view.meant))
    of_strongest = from_top(ridges.response[ridges.apart], view.strong)
    return Candidate(polarity, ridges, of_strongest, pieces.of == int(np.argmax(weight)), float(weight.max()))


def meant_score(ridges: Ridges, meant: Meant) -> Float32[np.ndarray, "p"]:
    """What speaks for each pixel."""
    return ridges.score * meant.weight.ravel()[ridges.pixel]


def _polarity(view: View, is_bright: bool) -> Polarity:
    contrast = mean_excess(*((view.seen, view.background) if is_bright else (view.background, view.seen)))
    line = np.minimum(contrast, np.float32(GLINT)) if is_bright else contrast
    return Polarity(is_bright, contrast, line, bends_of(line, *_box(view)))


def _box(view: View) -> tuple[slice, slice]:
    """The rows and columns of what is looked at where lines may be."""
    if view.near is None:
        return slice(None), slice(None)
    left, top, columns, rows = cv2.boundingRect(view.near.view(np.uint8))
    return slice(top, top + rows), slice(left, left + columns)


def _weight_at_a_glance(polarity: Polarity, view: View) -> float:
    """What speaks for the best piece of a polarity, at every second pixel of every second row."""
    about = None if view.instruments is None else view.instruments.about[EVERY_SECOND]
    strong = view.strong / 4
    ridges = _ridges(sparse_line_response(polarity.bends), view.seen[EVERY_SECOND], about, view, strong)
    return float(_pieces(ridges, strong).weight.max()) if len(ridges.pixel) else 0.0


def _response(bends: Bends, view: View) -> Float32[np.ndarray, "h w"]:
    """The response to lines where thread may be, 0 elsewhere."""
    if view.near is None:
        return line_response(bends)
    box, response = _box(view), np.zeros(view.near.shape, np.float32)
    np.multiply(line_response(bends), view.near[box], out=response[box])
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
