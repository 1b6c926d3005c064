"""Where a thread leaves the left image and the right one still shows it.

The right camera sees what lies beyond the left image's right border, and neither a match nor a left point is there.
The left chain is continued by the right points, moved by the last disparity: enough to begin with, after which only
the right points themselves, and the smoothness of the curve, say where it goes.
"""

import numpy as np
from jaxtyping import Int64

from agents.reconstruction.refined.alignment import Alignment, reversed_along
from agents.reconstruction.refined.pieces import Chain
from schemas.messages import Centrelines, RectifiedStereo

ADDED = -1
"""The piece of points that the left image does not show; their index is that of the right point."""
BORDER_PX = 4.0
SHORTEST_PX = 3
LAST_MATCHES = 5
DEVIATION_PX = 10.0
"""Of a disparity that is carried on unseen."""


def continued(left: Chain, right: Centrelines, aligned: Alignment, camera: RectifiedStereo) -> tuple[Chain, Alignment]:
    """The chain with what only the right image shows of it at either end, and the alignment along it."""
    for _ in range(2):
        left = _continued_at_its_end(left, right, aligned, camera)
        left, aligned = _reversed(left, aligned)
    return left, aligned


def _continued_at_its_end(left: Chain, right: Centrelines, aligned: Alignment, camera: RectifiedStereo) -> Chain:
    u, v = left.point_px[-1]
    if min(u, v, camera.image_width - 1 - u, camera.image_height - 1 - v) > BORDER_PX:
        return left
    index = _beyond(left, right, aligned)
    if len(index) < SHORTEST_PX:
        return left
    disparity = float(np.median(aligned.disparity_px[-LAST_MATCHES:]))
    points = right.point_px[index] + (disparity, 0.0)
    steps = np.linalg.norm(np.diff(np.vstack((left.point_px[-1:], points)), axis=0), axis=1)
    return Chain(
        np.vstack((left.point_px, points)),
        np.concatenate((left.along_px, left.along_px[-1] + np.cumsum(steps))),
        np.concatenate((left.width_px, right.width_px[index])),
        np.concatenate((left.deviation_px, np.full(len(index), DEVIATION_PX))),
        np.concatenate((left.piece, np.full(len(index), ADDED))),
        np.concatenate((left.index, index)),
    )


def _beyond(left: Chain, right: Centrelines, aligned: Alignment) -> Int64[np.ndarray, "k"]:
    """Indices of the right points that follow after the left chain's end, in order."""
    last = int(aligned.right_index[-1])
    before = aligned.right_index[-LAST_MATCHES:]
    if right.piece[int(before[0])] != right.piece[last] or before[-1] == before[0]:
        return np.zeros(0, np.int64)
    mine = np.flatnonzero(right.piece == right.piece[last])
    after = mine[mine > last] if before[-1] > before[0] else mine[mine < last][::-1]
    if not len(after):
        return after
    way = np.vstack((right.point_px[last], right.point_px[after]))
    along = np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))
    return after[along > left.along_px[-1] - aligned.along_px[-1] + 1.0]


def _reversed(left: Chain, aligned: Alignment) -> tuple[Chain, Alignment]:
    total = left.along_px[-1]
    chain = Chain(
        left.point_px[::-1],
        total - left.along_px[::-1],
        left.width_px[::-1],
        left.deviation_px[::-1],
        left.piece[::-1],
        left.index[::-1],
    )
    return chain, reversed_along(aligned, float(total))
