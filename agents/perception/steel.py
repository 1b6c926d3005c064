"""How centrelines look, by which steel is told from thread, and centrelines without what is steel."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.perception.centrelines.along import Pieces, directions, gaussian
from agents.perception.centrelines.centrelines import Lines
from agents.perception.centrelines.profiles import normals, sample
from schemas.messages import Centrelines

GREY = 128.0
"""a and b, in OpenCV's 8-bit Lab, of what has no colour."""
BESIDE_PX = 4.0
"""Beyond the edges, where the ground is looked at."""


@dataclass(frozen=True)
class Looks:
    """What each point of the centrelines shows.

    Fields:
        lab: L, a and b, OpenCV's 8-bit numbers.
        ground: how coloured the ground beside it is, on the paler side.
        beside: L, a and b of the ground on either side.
    """

    lab: Float64[np.ndarray, "n 3"]
    width: Float64[np.ndarray, "n"]
    ground: Float64[np.ndarray, "n"]
    beside: Float64[np.ndarray, "2 n 3"]


def looks_along(image: UInt8[np.ndarray, "h w 3"], lines: Centrelines) -> Looks:
    """How the middle of each line looks, and what lies beside it."""
    at = np.rint(lines.point_px).astype(np.intp)
    seen = image[at[:, 1].clip(0, image.shape[0] - 1), at[:, 0].clip(0, image.shape[1] - 1)]
    across = normals(
        directions(lines.point_px, Pieces(np.cumsum(np.diff(lines.piece, prepend=-1) > 0) - 1), gaussian(2.0))
    )
    # no wider than thread: a width that grew over a reflex would look for the ground elsewhere
    beyond = np.minimum(lines.width_px, 2 * np.median(lines.width_px)) / 2 + BESIDE_PX
    beside = sample(image, lines.point_px, across, np.stack((-beyond, beyond)), cv2.BORDER_REPLICATE)
    ground = _lab(np.rint(beside).astype(np.uint8))
    coloured = colour_of(ground) / (ground[..., 0] + 1.0)
    return Looks(_lab(seen[None])[0], lines.width_px, coloured.min(axis=0), ground)


def _lab(bgr: UInt8[np.ndarray, "k n 3"]) -> Float64[np.ndarray, "k n 3"]:
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2Lab), np.float64)


def colour_of(lab: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n"]:
    """How far from grey."""
    return np.hypot(lab[..., 1] - GREY, lab[..., 2] - GREY)


def without(found: Lines, steel: Bool[np.ndarray, "n"]) -> Lines:
    """Lines without these points, which are stretches before ends, or whole pieces; what is left ends there."""
    lines, keep = found.centrelines, ~steel
    numbers, first = np.unique(lines.piece, return_index=True)
    last = np.append(first[1:], len(lines.piece)) - 1
    stays = np.isin(numbers, lines.piece[keep])
    cut = replace(
        lines,
        point_px=lines.point_px[keep],
        piece=lines.piece[keep],
        width_px=lines.width_px[keep],
        deviation_px=lines.deviation_px[keep],
    )
    return Lines(cut, (found.loose_start | steel[first])[stays], (found.loose_end | steel[last])[stays])
