"""Several threads in view that look alike, each reconstructed by itself, from the frame alone.

A thread that passes through tissue is several threads to a camera, and nobody but whoever asks for a pull knows that
they are one. A strand of it becomes shorter or longer from frame to frame and slides along itself, where a track keeps
length and places. So none of these curves goes on from a frame before, that of the thread that is meant included.
Pieces that lie farther apart than a crossing or a glint explains are strands of their own, for nobody sees what joins
them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from agents.reconstruction.refined.crossings import CANDIDATE_PX, STRANGE_WIDTHS
from agents.reconstruction.refined.method import reconstruct_refined
from schemas.messages import Centrelines, Status, ThreadObservations, ThreadReconstruction

APART_WIDTHS = 5.0
"""Of the thread, between pieces of one strand: some 2 mm, the least bite of tissue that a planner looks for."""
Pair = tuple[Centrelines, Centrelines]
MOST_GAP_M = 0.02
"""Of tissue between strands of one thread, with what the view adds; the planner joins no ends more than 15 mm apart."""


def with_strands(thread: ThreadReconstruction, observations: ThreadObservations) -> ThreadReconstruction:
    """The same thread with the curves of all strands, where tissue may part it; those that failed are left out.

    They are the one that is meant, those of the observations, and what of their centrelines is no part of this thread.
    """
    apart = [(strand.centrelines_left, strand.centrelines_right) for strand in observations.strands]
    mine = observations.centrelines_left, observations.centrelines_right
    left: list[Pair] = []
    for other in thread.other_threads:
        along = _along(mine[0], other.left_px), _along(mine[1], other.right_px)
        left.append((_only(mine[0], along[0]), _only(mine[1], along[1])))
        mine = _only(mine[0], ~along[0]), _only(mine[1], ~along[1])
    others = [lines for lines in (*apart, *left) if len(lines[0].piece) and len(lines[1].piece)]
    parts = [(part, right) for lines, right in (mine, *others) for part in _parts(lines)]
    if len(parts) < 2 or not _may_be_parted(mine[0], others, thread):
        return thread
    made = [reconstruct_refined(_alone(observations, lines)) for lines in parts]
    return replace(thread, strands=tuple(each.as_strand for each in made if each.status is Status.OK))


def _may_be_parted(mine: Centrelines, others: Sequence[Pair], thread: ThreadReconstruction) -> bool:
    """Whether tissue may part one thread, in a known unit: it is no curve, or ends of another one lie near its own."""
    camera = thread.camera
    if camera.metres_per_unit is None:
        return False
    if thread.status is not Status.OK:
        return True
    if not len(mine.piece):
        return False
    nearest = float(thread.control_points_camera[:, 2].min())
    reach_px = MOST_GAP_M / camera.metres_per_unit * camera.fx_px / nearest
    ends = cKDTree(_ends_px(mine))
    return any(bool(np.any(ends.query(_ends_px(left))[0] <= reach_px)) for left, _ in others)


def _ends_px(lines: Centrelines) -> Float64[np.ndarray, "e 2"]:
    begins = np.flatnonzero(np.diff(lines.piece, prepend=-1) != 0)
    return lines.point_px[np.concatenate((begins, np.append(begins[1:], len(lines.piece)) - 1))]


def _parts(lines: Centrelines) -> Iterator[Centrelines]:
    """Pieces that lie end to end, together."""
    if not len(lines.piece):
        return
    pieces = np.cumsum(np.diff(lines.piece, prepend=-1) != 0) - 1
    ends = _ends_px(lines)
    count = len(ends) // 2
    near = cKDTree(ends).query_pairs(APART_WIDTHS * float(np.median(lines.width_px)), output_type="ndarray")
    linked = coo_array((np.ones(len(near)), (near[:, 0] % count, near[:, 1] % count)), (count, count))
    together = connected_components(linked, directed=False)[1]
    for part in range(int(together.max(initial=-1)) + 1):
        yield _only(lines, together[pieces] == part)


def _alone(observations: ThreadObservations, lines: Pair) -> ThreadObservations:
    """Observations of these lines as if they were those of the thread that is meant."""
    left, right = lines
    none = {"trail_left": None, "trail_right": None, "candidates": (), "prompt_px": None, "strands": ()}
    return replace(observations, centrelines_left=left, centrelines_right=right, **none)


def _along(lines: Centrelines, other_px: Float64[np.ndarray, "n 2"]) -> Bool[np.ndarray, "m"]:
    """Which points are of pieces that lie along another thread for the most part."""
    if not len(other_px) or not len(lines.piece):
        return np.zeros(len(lines.piece), bool)
    reach_px = CANDIDATE_PX + STRANGE_WIDTHS * float(np.median(lines.width_px))
    near = np.asarray(cKDTree(other_px).query(lines.point_px)[0]) <= reach_px
    number = np.cumsum(np.diff(lines.piece, prepend=lines.piece[0]) > 0)
    return (np.bincount(number, near) > 0.5 * np.bincount(number))[number]


def _only(lines: Centrelines, kept: Bool[np.ndarray, "n"]) -> Centrelines:
    number = np.cumsum(np.diff(lines.piece[kept], prepend=-1) > 0) - 1
    return Centrelines(lines.point_px[kept], number, lines.width_px[kept], lines.deviation_px[kept])
