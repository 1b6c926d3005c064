"""Strands that perception saw beside the reconstructed thread, in space: the pixels of both images joined row by row.

A rectified pair shows one place in one row. So each place of the left polyline has its counterpart where the right one
passes that row; of several the one that lies as far along counts. A pixel is known to ε along and across, and of a
strand that runs at the angle φ to the rows the disparity to √2 ε / sin φ.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo, ThreadCandidate
from shared.camera import backproject, depth_of_disparity

OFF_PX = 0.5
"""ε: candidates are told in pixels."""
LEAST_SINE = 0.1
"""Along the rows nothing tells disparity but the ends of a strand."""
FEWEST = 3


def other_strands(
    candidates: Sequence[ThreadCandidate], camera: RectifiedStereo
) -> Iterator[tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3 3"]]]:
    """Places along each strand with their covariance, in the unit of the camera's baseline and the camera frame."""
    for candidate in candidates:
        for right in (candidate.right_px, candidate.right_px[::-1]):
            found = _joined(candidate.left_px, right, camera)
            if found is not None:
                yield found
                break


def _joined(
    left: Float64[np.ndarray, "n 2"], right: Float64[np.ndarray, "m 2"], camera: RectifiedStereo
) -> tuple[Float64[np.ndarray, "k 3"], Float64[np.ndarray, "k 3 3"]] | None:
    """None where the strand runs the other way in the right image, or too little of it is in both."""
    if min(len(left), len(right)) < FEWEST or (left[-1, 1] - left[0, 1]) * (right[-1, 1] - right[0, 1]) < 0:
        return None
    share_left, share_right = np.linspace(0.0, 1.0, len(left)), np.linspace(0.0, 1.0, len(right))
    kept, disparity = list[int](), list[float]()
    for i, (u, v) in enumerate(left):
        before, after = right[:-1], right[1:]
        passes = np.flatnonzero((before[:, 1] <= v) != (after[:, 1] <= v))
        if not len(passes):
            continue
        j = int(passes[np.argmin(np.abs(share_right[passes] - share_left[i]))])
        share = (v - before[j, 1]) / (after[j, 1] - before[j, 1])
        apart = float(u - (before[j, 0] + share * (after[j, 0] - before[j, 0])))
        if apart > 0:
            kept.append(i)
            disparity.append(apart)
    if len(kept) < FEWEST:
        return None
    px = left[kept]
    points = backproject(camera, px, depth_of_disparity(camera, np.array(disparity)))
    way = np.gradient(px, axis=0)
    sine = np.abs(way[:, 1]) / np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    depth_off = points[:, 2] / np.array(disparity) * np.sqrt(2.0) * OFF_PX / np.maximum(sine, LEAST_SINE)
    rays = points / points[:, 2:]
    beside = (points[:, 2] / camera.fx_px * OFF_PX) ** 2
    across = np.eye(3) * np.array([1.0, 1.0, 0.0])
    deep = depth_off[:, None, None] ** 2 * rays[:, :, None] * rays[:, None, :]
    return points, beside[:, None, None] * across + deep
