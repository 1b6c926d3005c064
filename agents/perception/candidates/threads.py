"""Which pieces of a centreline are one thread: those that a thread of one colour and width leads through."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from agents.perception.candidates.links import Looks, end_costs, linked, looks_of, unlikeness, ways
from schemas.messages import Centrelines

MOST_PIECES = 40
"""The longest ones; time grows with their square, and a thread in so many pieces is clutter."""


@dataclass(frozen=True)
class Threads:
    """The threads of one image.

    Fields:
        points: of each, the indices of its points among the centrelines', in order along it.
        looks: of each.
    """

    points: list[Int64[np.ndarray, "n"]]
    looks: Looks


def threads_of(image: UInt8[np.ndarray, "h w 3"], lines: Centrelines) -> Threads:
    """The threads of one image, the one that is seen longest first; pieces that have no direction are left out."""
    pieces = pieces_of(lines)
    if not pieces:
        return Threads([], looks_of(image, lines, []))
    if len(pieces) > 1:
        looks = looks_of(image, lines, pieces)
        cost = end_costs(lines, pieces, unlikeness(looks, looks), image.shape[1])
        found = [np.concatenate([pieces[p][:: 1 if on else -1] for p, on in way]) for way in ways(linked(cost))]
        pieces = sorted(found, key=lambda points: -len(points))
    return Threads(pieces, looks_of(image, lines, pieces))


def pieces_of(lines: Centrelines) -> list[Int64[np.ndarray, "k"]]:
    """The indices of the points of each piece, of the longest ones in their order."""
    if not len(lines.piece):
        return []
    every = np.split(np.arange(len(lines.piece)), np.flatnonzero(np.diff(lines.piece)) + 1)
    long = sorted(every, key=len)[::-1][:MOST_PIECES]
    return sorted((piece for piece in long if len(piece) >= 3), key=lambda piece: int(piece[0]))


def lengths_px(lines: Centrelines, threads: Threads) -> Float64[np.ndarray, "t"]:
    """How much of each thread is seen: gaps do not count."""
    step = np.linalg.norm(np.diff(lines.point_px, axis=0), axis=1) * (np.diff(lines.piece) == 0)
    before = np.concatenate((step, [0.0]))
    return np.array([before[points].sum() for points in threads.points])
