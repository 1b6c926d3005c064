"""Whether a curve follows a thread whose course in both raw images is known to some pixels."""

import cv2
import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import KDTree

from benchmarks.measures import sampled
from benchmarks.pictures import Points
from benchmarks.tables import Row
from schemas.messages import StereoCalibration, ThreadReconstruction

ON_THREAD = 14 / 1280
"""Of the image's width: what lies so near to the thread lies on it."""
CURVE_RIGHT, THREAD_FOLLOWED = 0.90, 0.70
RIGHT, WRONG, REFUSED = "right", "wrong though ok", "refused"
BothEyes = tuple[Points, Points]


def projected(points: Float64[np.ndarray, "n 3"], calibration: StereoCalibration) -> BothEyes:
    """Where both raw images show points of the left camera, px."""
    if not len(points):
        return np.zeros((0, 2)), np.zeros((0, 2))
    T = calibration.T_right_left
    left, right = (
        cv2.projectPoints(points, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], K, distortion)[0][:, 0]
        for K, distortion, pose in (
            (calibration.K_left, calibration.distortion_left, np.eye(4)),
            (calibration.K_right, calibration.distortion_right, T),
        )
    )
    return np.asarray(left, np.float64), np.asarray(right, np.float64)


def curve_of(result: ThreadReconstruction, calibration: StereoCalibration) -> BothEyes:
    """A reconstructed curve in both raw images, px, where rectification does not turn the left camera."""
    return projected(sampled(result), calibration)


def verdict(curve: BothEyes, threads: list[tuple[BothEyes, BothEyes]], width: int) -> Row:
    """Right where, in both eyes, at least 90 % of the curve lies on one thread and 70 % of what they see is followed.

    Args:
        threads: the whole of each in both images, and what both eyes see of it.
    """
    within_px = ON_THREAD * width
    shares = [
        tuple(
            min(float(near(a, b, within_px).mean()) if len(a) else 0.0 for a, b in zip(*pair, strict=True))
            for pair in ((curve, whole), (seen, curve))
        )
        for whole, seen in threads
    ]
    on, followed = max(shares, key=min, default=(0.0, 0.0))
    right = on >= CURVE_RIGHT and followed >= THREAD_FOLLOWED
    return {"on thread %": 100 * on, "followed %": 100 * followed, "verdict": RIGHT if right else WRONG}


def near(points: Points, others: Points, within_px: float) -> Bool[np.ndarray, "n"]:
    """Which points lie so near to others."""
    if not (len(points) and len(others)):
        return np.zeros(len(points), bool)
    return np.asarray(KDTree(others).query(points)[0]) <= within_px
