"""Operations along ordered points of several pieces at once: smoothing, direction, even spacing."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

KERNELS_KEPT = 64
"""Two threads of a pair, seen again and again, need a few each."""
REACH = 12
"""Points by which pieces are continued beyond their ends: half the longest kernel."""
ONE, SHORTEST = np.ones(1), 1e-9
STRIDE = 2


@dataclass(frozen=True)
class Pieces:
    """Which piece each of a sequence of points belongs to, from 0, never decreasing and without gaps."""

    number: Int64[np.ndarray, "n"]

    @cached_property
    def first(self) -> Int64[np.ndarray, "k"]:
        """Index of the first point of each piece."""
        return np.flatnonzero(np.diff(self.number, prepend=-1))

    @cached_property
    def last(self) -> Int64[np.ndarray, "k"]:
        """Index of the last point of each piece."""
        return np.flatnonzero(np.diff(self.number, append=-1))

    @cached_property
    def before(self) -> Int64[np.ndarray, "n"]:
        """How many points of its piece precede each point."""
        return np.arange(len(self.number)) - self.first[self.number]

    @cached_property
    def after(self) -> Int64[np.ndarray, "n"]:
        """How many points of its piece follow each point."""
        return self.last[self.number] - np.arange(len(self.number))

    @cached_property
    def beside(self) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "n"]]:
        """The point after each and the one before, in its piece; at an end the point itself."""
        here = np.arange(len(self.number))
        return np.minimum(here + 1, self.last[self.number]), np.maximum(here - 1, self.first[self.number])

    @cached_property
    def continued(self) -> "Continued":
        """The pieces in a row, each with REACH points more at both ends."""
        count, pieces = len(self.number), np.arange(len(self.first))
        inside = np.arange(count) + REACH * (2 * self.number + 1)
        mirrored = np.empty(count + 2 * REACH * len(pieces), np.int64)
        mirrored[inside] = np.arange(count)
        # a place as far behind an end as it is beyond it, or the other end of a shorter piece
        back = np.minimum(np.arange(1, REACH + 1), (self.last - self.first)[:, None])
        starts, ends = inside[self.first][:, None], inside[self.last][:, None]
        before, after = starts - np.arange(1, REACH + 1), ends + np.arange(1, REACH + 1)
        mirrored[before], mirrored[after] = self.first[:, None] + back, self.last[:, None] - back
        beyond = np.concatenate((before, after), axis=None)
        return Continued(mirrored, inside, beyond, np.repeat(np.concatenate((self.first, self.last)), REACH))

    @cached_property
    def every_second(self) -> tuple[Int64[np.ndarray, "m"], "Pieces"]:
        """Every second point of each piece, and its last one: what neighbours see they hardly see apart."""
        some = self.every(STRIDE)
        return some, Pieces(self.number[some])

    def every(self, stride: int) -> Int64[np.ndarray, "m"]:
        """Every so many points of each piece, and its last one."""
        return np.flatnonzero((self.before % stride == 0) | (self.after == 0))


def numbered(piece: Int64[np.ndarray, "n"]) -> Int64[np.ndarray, "n"]:
    """The numbers of pieces without gaps."""
    return np.cumsum(np.diff(piece, prepend=piece[:1]) != 0)


@dataclass(frozen=True)
class Continued:
    """For each place of pieces that go on beyond their ends, the point it mirrors; within them, the point itself.

    Fields:
        inside: at which places the points themselves stand.
        beyond, end: the other places, and the end that each lies beyond.
    """

    mirrored: Int64[np.ndarray, "q"]
    inside: Int64[np.ndarray, "n"]
    beyond: Int64[np.ndarray, "b"]
    end: Int64[np.ndarray, "b"]


@lru_cache(KERNELS_KEPT)
def gaussian(sigma: float) -> Float64[np.ndarray, "m"]:
    """A normalised kernel out to three standard deviations."""
    x = np.arange(-np.ceil(3 * sigma), np.ceil(3 * sigma) + 1)
    kernel = np.exp(-0.5 * (x / sigma) ** 2)
    return kernel / kernel.sum()


@lru_cache(KERNELS_KEPT)
def local_quadratic(sigma: float) -> Float64[np.ndarray, "m"]:
    """A Gaussian kernel of fourth order: a curve that bends evenly is not drawn inwards."""
    x = np.arange(-np.ceil(3 * sigma), np.ceil(3 * sigma) + 1)
    w = np.exp(-0.5 * (x / sigma) ** 2)
    m0, m2, m4 = w.sum(), (w * x**2).sum(), (w * x**4).sum()
    return w * (m4 - m2 * x**2) / (m0 * m4 - m2**2)


def smoothed(
    values: Float64[np.ndarray, "n d"], pieces: Pieces, kernel: Float64[np.ndarray, "m"]
) -> Float64[np.ndarray, "n d"]:
    """Values convolved along each piece, which goes on at its ends as its reflection through the end point."""
    if len(values) == 0:
        return values
    # taking from what lies in another order copies all of it first
    at, columns = pieces.continued, np.ascontiguousarray(values.T)
    padded = columns.take(at.mirrored, axis=1)
    # beyond an end, the point that lies as far behind it as the mirrored one before it
    padded[:, at.beyond] = 2 * columns.take(at.end, axis=1) - padded.take(at.beyond, axis=1)
    # for a single row of weights, OpenCV's separable filter takes half as long again
    along = cv2.filter2D(padded, cv2.CV_64F, kernel[None], borderType=cv2.BORDER_CONSTANT)
    return np.asarray(along).take(at.inside, axis=1).T


def blurred(
    values: Float32[np.ndarray, "t n *c"] | UInt8[np.ndarray, "t n *c"],
    pieces: Pieces,
    kernel: Float64[np.ndarray, "m"],
    some: Int64[np.ndarray, "s"] | None = None,
) -> Float32[np.ndarray, "t s *c"]:
    """Columns averaged with their neighbours along each piece, which goes on at its ends as in a mirror.

    Args:
        some: the points at which they are needed; all, if it is None.
    """
    at = pieces.continued
    along = cv2.sepFilter2D(values.take(at.mirrored, axis=1), cv2.CV_32F, kernel, ONE)
    return np.asarray(along, np.float32).take(at.inside if some is None else at.inside[some], axis=1)


def directions(
    point: Float64[np.ndarray, "n 2"], pieces: Pieces, kernel: Float64[np.ndarray, "m"]
) -> Float64[np.ndarray, "n 2"]:
    """Unit tangents of the smoothed points; (1, 0) where a piece has a single one."""
    smooth = smoothed(point, pieces, kernel).T
    ahead, behind = pieces.beside
    step = smooth.take(ahead, axis=1) - smooth.take(behind, axis=1)
    squared = step * step
    length = np.sqrt(squared[0] + squared[1])
    tangent = step / np.maximum(length, SHORTEST)
    if (nowhere := length <= SHORTEST).any():
        tangent[:, nowhere] = np.array([[1.0], [0.0]])
    return tangent.T


def evenly_spaced(
    point: Float64[np.ndarray, "n 2"], pieces: Pieces, spacing: float
) -> tuple[Float64[np.ndarray, "m 2"], Pieces]:
    """Points about `spacing` apart along the polyline of each piece, its ends included."""
    first, last = pieces.first, pieces.last
    along = point[1:] - point[:-1]
    along *= along
    step = np.zeros(len(point))
    # over an axis of two, NumPy's own norm takes five times as long
    np.sqrt(along[:, 0] + along[:, 1], out=step[1:])
    step[first] = 0.0
    travelled = np.cumsum(step)
    start, stop = travelled[first], travelled[last]
    count = np.maximum(np.rint((stop - start) / spacing).astype(np.int64), 0) + 1
    owner = np.repeat(np.arange(len(first)), count)
    local = np.arange(len(owner)) - (np.cumsum(count) - count)[owner]
    share = local / np.maximum(count - 1, 1)[owner]
    # a long leap between pieces keeps interpolation within each of them
    leap = 1.0 + np.arange(len(first))
    where = start[owner] + share * (stop - start)[owner] + leap[owner]
    known = travelled + leap[pieces.number]
    resampled = np.empty((len(where), 2))
    for axis in (0, 1):
        resampled[:, axis] = np.interp(where, known, point[:, axis])
    return resampled, Pieces(owner)
