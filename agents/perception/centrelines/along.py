"""Operations along ordered points of several pieces at once: smoothing, direction, even spacing."""

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64


def bounds(piece: Int64[np.ndarray, "n"]) -> tuple[Int64[np.ndarray, "k"], Int64[np.ndarray, "k"]]:
    """Index of the first point of each piece, and one after its last."""
    first = np.flatnonzero(np.diff(piece, prepend=-1))
    return first, np.append(first[1:], len(piece))[: len(first)]


def places_to_ends(piece: Int64[np.ndarray, "n"]) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "n"]]:
    """How many points of its piece lie before each point, and how many after it."""
    first, end = bounds(piece)
    count = end - first
    index = np.arange(len(piece))
    return index - np.repeat(first, count), np.repeat(end - 1, count) - index


def gaussian(sigma: float) -> Float64[np.ndarray, "m"]:
    """A normalised kernel out to three standard deviations."""
    x = np.arange(-np.ceil(3 * sigma), np.ceil(3 * sigma) + 1)
    kernel = np.exp(-0.5 * (x / sigma) ** 2)
    return kernel / kernel.sum()


def local_quadratic(sigma: float) -> Float64[np.ndarray, "m"]:
    """A Gaussian kernel of fourth order: a curve that bends evenly is not drawn inwards."""
    x = np.arange(-np.ceil(3 * sigma), np.ceil(3 * sigma) + 1)
    w = np.exp(-0.5 * (x / sigma) ** 2)
    m0, m2, m4 = w.sum(), (w * x**2).sum(), (w * x**4).sum()
    return w * (m4 - m2 * x**2) / (m0 * m4 - m2**2)


def smoothed(
    values: Float64[np.ndarray, "n d"], piece: Int64[np.ndarray, "n"], kernel: Float64[np.ndarray, "m"]
) -> Float64[np.ndarray, "n d"]:
    """Values convolved along each piece, which continues at its ends by its reflection through the end point."""
    if len(values) == 0:
        return values
    reach = len(kernel) // 2
    mirrored, nearest, inside = _reflection(piece, reach)
    outside = (mirrored != nearest)[:, None]
    padded = np.where(outside, 2 * values[nearest] - values[mirrored], values[mirrored])
    result = np.empty_like(values)
    for column in range(values.shape[1]):
        result[:, column] = np.convolve(padded[:, column], kernel, mode="same")[inside]
    return result


def blurred(
    rows: Float32[np.ndarray, "n t"], piece: Int64[np.ndarray, "n"], kernel: Float64[np.ndarray, "m"]
) -> Float32[np.ndarray, "n t"]:
    """Rows averaged with their neighbours along each piece, which goes on at its ends as in a mirror."""
    mirrored, _, inside = _reflection(piece, len(kernel) // 2)
    return np.asarray(cv2.sepFilter2D(rows[mirrored], cv2.CV_32F, np.ones(1), kernel), np.float32)[inside]


def _reflection(
    piece: Int64[np.ndarray, "n"], reach: int
) -> tuple[Int64[np.ndarray, "q"], Int64[np.ndarray, "q"], Int64[np.ndarray, "n"]]:
    """All pieces in a row, each with `reach` points more at both ends.

    Returns which point mirrors each place, which point of the piece is nearest to it, and where the points stand.
    """
    first, end = bounds(piece)
    length = end - first
    start = np.cumsum(length + 2 * reach) - length - 2 * reach
    owner = np.repeat(np.arange(len(first)), length + 2 * reach)
    local = np.arange(len(owner)) - start[owner] - reach
    last = length[owner] - 1
    mirrored = np.clip(np.where(local < 0, -local, np.where(local > last, 2 * last - local, local)), 0, last)
    nearest = np.clip(local, 0, last)
    return first[owner] + mirrored, first[owner] + nearest, np.flatnonzero(local == nearest)


def directions(
    point: Float64[np.ndarray, "n 2"], piece: Int64[np.ndarray, "n"], kernel: Float64[np.ndarray, "m"]
) -> Float64[np.ndarray, "n 2"]:
    """Unit tangents of the smoothed points; (1, 0) where a piece has a single one."""
    smooth = smoothed(point, piece, kernel)
    first, end = bounds(piece)
    ahead, behind = np.arange(len(point)) + 1, np.arange(len(point)) - 1
    ahead[end - 1], behind[first] = end - 1, first
    step = smooth[ahead] - smooth[behind]
    length = np.hypot(step[:, 0], step[:, 1])
    return np.where(length[:, None] > 1e-9, step / np.maximum(length, 1e-9)[:, None], [1.0, 0.0])


def evenly_spaced(
    point: Float64[np.ndarray, "n 2"], piece: Int64[np.ndarray, "n"], spacing: float
) -> tuple[Float64[np.ndarray, "m 2"], Int64[np.ndarray, "m"]]:
    """Points about `spacing` apart along the polyline of each piece, its ends included."""
    first, end = bounds(piece)
    step = np.linalg.norm(np.diff(point, axis=0, prepend=point[:1]), axis=1)
    step[first] = 0.0
    travelled = np.cumsum(step)
    start, stop = travelled[first], travelled[end - 1]
    count = np.maximum(np.rint((stop - start) / spacing).astype(np.int64), 0) + 1
    owner = np.repeat(np.arange(len(first)), count)
    local = np.arange(len(owner)) - (np.cumsum(count) - count)[owner]
    share = local / np.maximum(count - 1, 1)[owner]
    # a long leap between pieces keeps interpolation within each of them
    leap = 1.0 + np.arange(len(first))
    where = start[owner] + share * (stop - start)[owner] + leap[owner]
    known = travelled + np.repeat(leap, end - first)
    resampled = np.column_stack([np.interp(where, known, point[:, axis]) for axis in (0, 1)])
    return resampled, piece[first][owner]
