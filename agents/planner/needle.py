"""The needle as an obstacle: places on it, and how far from each nothing of the instrument may come."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from schemas.messages import NeedlePose, Status, ThreadReconstruction
from schemas.topics import NEEDLE

POINTS = 40
RADIUS_M = 0.00045
"""Of a suture needle's wire, the thickest that thread of this size is swaged to."""
SIGMAS = 2.0
"""Of how well each place is known, that are kept clear of."""


@dataclass(frozen=True)
class NeedleAround:
    """Places on a needle in the camera frame, the swage first.

    Fields:
        reach_m: half of how thick it is there, with what is not known of it.
        swage_seen: whether both eyes see the swage; otherwise it lies where needles of its kind have it.
    """

    points_camera: Float64[np.ndarray, "n 3"]
    reach_m: Float64[np.ndarray, "n"]
    swage_seen: bool = False

    @property
    def swage_camera(self) -> Float64[np.ndarray, "3"]:
        """Where the thread enters it."""
        return self.points_camera[0]

    def off(self, places_camera: Float64[np.ndarray, "k 3"]) -> Float64[np.ndarray, "k"]:
        """How far places are from its surface at the least."""
        apart = np.linalg.norm(places_camera[:, None] - self.points_camera[None], axis=2)
        return (apart - self.reach_m).min(axis=1)


def needle_around(pose: NeedlePose | None, thread: ThreadReconstruction, now_ns: int) -> NeedleAround | None:
    """The needle beside a thread; None where none is known, or it was seen otherwise, or too long ago."""
    if pose is None or pose.status is not Status.OK or pose.camera != thread.camera:
        return None
    unit_m = pose.camera.metres_per_unit
    age_ms = 1e-6 * (now_ns - min(pose.stamp.capture_left_ns, pose.stamp.capture_right_ns))
    same = pose.stamp.calibration_id == thread.stamp.calibration_id
    if unit_m is None or not same or abs(age_ms) > (NEEDLE.maximum_age_ms or math.inf):
        return None
    angle = np.linspace(0.0, pose.arc_rad, POINTS)
    variance = [float(np.linalg.eigvalsh(pose.covariance_at(float(one)))[-1]) for one in angle]
    reach_m = RADIUS_M + SIGMAS * unit_m * np.sqrt(np.maximum(variance, 0.0))
    return NeedleAround(unit_m * pose.at(angle), reach_m, bool(pose.ends_seen[0]))
