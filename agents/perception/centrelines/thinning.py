"""Thinning of a mask to lines of one pixel (Guo and Hall 1989), by tables over the eight neighbours.

Only foreground pixels are visited, as a list of indices into a padded image, so the cost follows the thread's area and
not that of the image. Neighbours are numbered clockwise from the north; bit k of a code is neighbour k.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64, UInt8

CODES = np.arange(256)
LONGEST_STEP = np.float32(1.37)
"""Of a distance transform: no step between neighbours counts for more."""


def thinned(mask: Bool[np.ndarray, "h w"], depth: Float32[np.ndarray, "h+2 w+2"]) -> UInt8[np.ndarray, "h+2 w+2"]:
    """A skeleton of the mask, as 1 in an image with a border: eight-connected, one pixel wide, of the same topology.

    Args:
        depth: distance of each pixel to the nearest one outside, by OpenCV's steps to neighbours.
    """
    padded = cv2.copyMakeBorder(mask.view(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    flat, offsets = padded.ravel(), neighbour_offsets(padded.shape[1])
    pixels = np.flatnonzero(flat.view(bool))
    # a pixel so many steps inside is surrounded until as many rounds have taken what is around it
    inside = np.ceil(depth.ravel()[pixels] / LONGEST_STEP)
    deepest = int(inside.max(initial=0))
    of_depth = [pixels[inside == steps] for steps in range(1, deepest + 1)]
    alive, rounds, unchanged = pixels[:0], 0, 0
    while unchanged < len(GUO_HALL) or rounds < deepest:
        if rounds < deepest:
            alive = np.concatenate((alive, of_depth[rounds]))
        before = len(alive)
        alive = _without(flat, alive, GUO_HALL[rounds % 2][neighbour_codes(flat, alive, offsets)])
        rounds += 1
        unchanged = unchanged + 1 if len(alive) == before else 0
    thin_corners(flat, alive, offsets, padded.shape[1])
    return padded


def thin_corners(
    flat: UInt8[np.ndarray, "a"], alive: Int64[np.ndarray, "p"], offsets: Int64[np.ndarray, "8"], stride: int
) -> Int64[np.ndarray, "q"]:
    """Drop every pixel that is neither an end nor needed for the connection, in four fields without neighbours."""
    row, column = np.divmod(alive, stride)
    field = 2 * (row & 1) + (column & 1)
    removed = np.zeros(len(alive), bool)
    for number in range(4):
        here = np.flatnonzero(field == number)
        needless = here[SIMPLE_INNER[neighbour_codes(flat, alive[here], offsets)]]
        flat[alive[needless]] = 0
        removed[needless] = True
    return alive[~removed]


def neighbour_offsets(stride: int) -> Int64[np.ndarray, "8"]:
    """What to add to an index for its eight neighbours in an image of that many columns."""
    return np.array([-stride, 1 - stride, 1, stride + 1, stride, stride - 1, -1, -stride - 1])


def neighbour_codes(
    flat: UInt8[np.ndarray, "a"], index: Int64[np.ndarray, "p"], offsets: Int64[np.ndarray, "8"]
) -> UInt8[np.ndarray, "p"]:
    """Which of the eight neighbours of each pixel are set, as bits."""
    code = flat.take(offsets[:, None] + index)
    # bits are put together by halves
    for bits in (4, 2, 1):
        code = code[:bits] | (code[bits:] << np.uint8(bits))
    return code[0]


def _without(
    flat: UInt8[np.ndarray, "a"], alive: Int64[np.ndarray, "p"], removed: Bool[np.ndarray, "p"]
) -> Int64[np.ndarray, "q"]:
    flat[alive[removed]] = 0
    return alive[~removed]


def _neighbours() -> list[Bool[np.ndarray, "256"]]:
    return [(CODES >> bit & 1).astype(bool) for bit in range(8)]


def _branches() -> Int64[np.ndarray, "256"]:
    """How many eight-connected groups the neighbours form, counting those joined at a corner as one."""
    n, ne, e, se, s, sw, w, nw = _neighbours()
    pairs = [(~n & (ne | e)), (~e & (se | s)), (~s & (sw | w)), (~w & (nw | n))]
    return np.sum(pairs, axis=0)


def _guo_hall(second: bool) -> Bool[np.ndarray, "256"]:
    """Pixels that one of the two sub-iterations may remove."""
    n, ne, e, se, s, sw, w, nw = _neighbours()
    one = np.sum([nw | n, ne | e, se | s, sw | w], axis=0)
    other = np.sum([n | ne, e | se, s | sw, w | nw], axis=0)
    count = np.minimum(one, other)
    kept_side = ((s | sw | ~nw) & w) if second else ((n | ne | ~se) & e)
    return (_branches() == 1) & (count >= 2) & (count <= 3) & ~kept_side


def _simple_inner() -> Bool[np.ndarray, "256"]:
    """Pixels that are no end, whose removal leaves their neighbours connected and opens no hole."""
    n, _, e, _, s, _, w, _ = _neighbours()
    return (_branches() == 1) & (np.sum(_neighbours(), axis=0) >= 2) & ~(n & e & s & w)


GUO_HALL = (_guo_hall(second=False), _guo_hall(second=True))
SIMPLE_INNER = _simple_inner()
NEIGHBOURS = np.sum(_neighbours(), axis=0)
"""How many neighbours a code has."""
