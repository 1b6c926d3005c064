"""Pixels that look like part of a line, and the connected pieces that they form."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64

from agents.perception.segmentation.connected import extents, of_pixels

LEAST_LENGTH_PX = 12
"""Pieces shorter than this are specks."""
BLOCK = 64
"""Values of which only the greatest counts while the strongest are looked for."""

GOING_ON_PX, GOING_ON_EXTENT_SHARE = 10, 0.13
GOING_ON_COLOUR_LIMIT, GOING_ON_OF_EXPECTED = 2.5, 0.4
"""A piece goes on from one that is thread where it is so close to it, no shorter than that share of it, and looks
and responds as thread does: all its pixels on the mean, those at its sides among them."""
NOT_ALIKE = 9.0
"""Deviations of colour beyond which one pixel counts no more than another."""


@dataclass(frozen=True)
class Ridges:
    """The pixels of one polarity that look a little like part of a line, and nothing of the others.

    Fields:
        shape: of the part of the reduced image that is looked at.
        pixel: indices in it.
        response: to lines, score: the same, weighted by how rare the colour is.
        colour: OpenCV's 8-bit Lab.
        apart: whether they lie apart from instruments; those that do not may extend a piece, and count for nothing.
    """

    shape: tuple[int, int]
    pixel: Int64[np.ndarray, "p"]
    response: Float32[np.ndarray, "p"]
    score: Float32[np.ndarray, "p"]
    colour: Float32[np.ndarray, "p 3"]
    apart: Bool[np.ndarray, "p"]


@dataclass(frozen=True)
class Pieces:
    """Connected pieces among ridge pixels.

    Fields:
        of: number of the piece of each ridge pixel; 0 of those in none.
        weight: the total score of each; 0 of the ground, of specks, and of what holds no seed.
        extent: the diagonal of each that holds a seed, in pixels.
    """

    of: Int32[np.ndarray, "p"]
    weight: Float64[np.ndarray, "c"]
    extent: Float64[np.ndarray, "c"]


def connected_pieces(ridges: Ridges, kept: Bool[np.ndarray, "p"], seeds: Bool[np.ndarray, "p"]) -> Pieces:
    """The connected pieces of the ridge pixels that are kept, of which only those that hold a seed have weight."""
    pixel = ridges.pixel[kept]
    mask = of_pixels(pixel, ridges.shape)
    # OpenCV's own statistics of the pieces take several times as long as the pieces
    count, labelled = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    piece = np.zeros(len(kept), np.int32)
    piece[kept] = np.asarray(labelled, np.int32).ravel()[pixel]
    seeded = np.zeros(count, bool)
    seeded[piece[seeds]] = True
    seeded[0] = False
    counting = np.flatnonzero(seeded[piece])
    of_counting = piece[counting]
    extent = extents(of_counting, ridges.pixel[counting], ridges.shape[1], count)
    weight = np.bincount(of_counting, weights=ridges.score[counting], minlength=count)
    weight[extent < LEAST_LENGTH_PX] = 0.0
    return Pieces(piece, weight, extent)


def going_on(
    ridges: Ridges,
    pieces: Pieces,
    kept: Bool[np.ndarray, "c"],
    away: Float32[np.ndarray, "p"],
    of_expected: Float32[np.ndarray, "p"],
) -> Bool[np.ndarray, "c"]:
    """Which shorter pieces are close to those that are kept, and look as thread does there.

    Args:
        away: how far each pixel's colour is from the thread's, in deviations.
        of_expected: how each responds, as a share of what thread would.
    """
    others = (pieces.weight > 0) & ~kept
    others &= pieces.extent > GOING_ON_EXTENT_SHARE * pieces.extent[kept].max(initial=0)
    if not others.any():
        return others
    size = np.bincount(pieces.of, minlength=len(kept))
    deviations, responds = (
        np.bincount(pieces.of, weights=values, minlength=len(kept)) / np.maximum(size, 1)
        for values in (np.minimum(away, NOT_ALIKE), np.minimum(of_expected, 1.0))
    )
    others &= (deviations < GOING_ON_COLOUR_LIMIT) & (responds > GOING_ON_OF_EXPECTED)
    side = 2 * GOING_ON_PX + 1
    near = cv2.dilate(
        of_pixels(ridges.pixel[kept[pieces.of]], ridges.shape).view(np.uint8), np.ones((side, side), np.uint8)
    )
    touched = np.zeros(len(kept), bool)
    touched[pieces.of[near.ravel()[ridges.pixel] > 0]] = True
    return others & touched


def weight_meant(pieces: Pieces, score: Float32[np.ndarray, "p"]) -> Float64[np.ndarray, "c"]:
    """What speaks for each piece, of those that have weight."""
    total = np.bincount(pieces.of, weights=score, minlength=len(pieces.weight))
    return np.where(pieces.weight > 0, total, 0.0)


def from_top(values: Float32[np.ndarray, "p"], places: float) -> float:
    """The value so many places below the greatest, between its neighbours; the least where there are fewer."""
    if places >= len(values) - 1:
        return float(values.min(initial=0))
    whole = int(places)
    # so many blocks have a greatest value of at least this that no smaller value counts
    blocks = values[: len(values) - len(values) % BLOCK].reshape(BLOCK, -1).max(axis=0)
    least = len(blocks) - whole - 2
    if least >= 0:
        values = values[values >= np.partition(blocks, least)[least]]
    least = len(values) - whole - 2
    below, above = np.partition(values, (least, least + 1))[least : least + 2]
    return float(above + (below - above) * (places - whole))
