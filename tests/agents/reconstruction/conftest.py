"""A camera, a thread whose every point is known, and observations of it."""

import dataclasses

import numpy as np
import pytest

from schemas.messages import FrameStamp, Image, ImageEncoding, RectifiedStereo, Status, ThreadObservations
from shared.arc_length import even_parameters
from shared.splines import clamped_uniform_knots, evaluate

CAMERA = RectifiedStereo(960, 540, 1000.0, 1010.0, 479.5, 269.5, 5.5, 1e-3)


@dataclasses.dataclass(frozen=True)
class Thread:
    """A clamped uniform cubic spline of 20 control points, in millimetres."""

    knots: np.ndarray
    control_points: np.ndarray

    def at(self, share):
        """Points at shares of the arc length, from a fine table."""
        s = np.interp(share, np.linspace(0, 1, 4001), even_parameters(self.knots, self.control_points, 3, 4001))
        return evaluate(self.knots, self.control_points, 3, s)


def winding_thread():
    t = np.linspace(0, 1, 20)
    control_points = np.column_stack((-28 + 56 * t, 9 * np.sin(5 * t), 95 + 6 * np.cos(4 * t)))
    return Thread(clamped_uniform_knots(20), control_points)


def observations_of(points, camera=CAMERA, half_size_px=2.0, **changes):
    n = len(points)
    mask = Image(ImageEncoding.RAW, 1, 1, 1, b"\0")
    observations = ThreadObservations(
        stamp=FrameStamp(7, 100, 200, "calibration"),
        camera=camera,
        status=Status.OK,
        reason="",
        segmenter="by hand",
        points_camera=np.asarray(points, np.float64),
        half_size_px=np.broadcast_to(np.asarray(half_size_px, np.float64), (n, 2)),
        matched_px=np.zeros((0, 3)),
        match_cost=np.zeros((0, 2)),
        inlier=np.zeros(0, bool),
        mask_left=mask,
        mask_right=mask,
    )
    return dataclasses.replace(observations, **changes)


@pytest.fixture(scope="session")
def camera():
    return CAMERA


@pytest.fixture(scope="session")
def thread():
    return winding_thread()


@pytest.fixture(scope="session")
def observe():
    return observations_of


def checked(reconstruction, observations):
    """What must hold of every reconstruction beside what its message checks."""
    assert reconstruction.stamp == observations.stamp
    assert reconstruction.camera == observations.camera
    assert reconstruction.method == "paper"
    if reconstruction.status is Status.FAILED:
        assert len(reconstruction.reason) > 10
        return
    knots, P = reconstruction.knots, reconstruction.control_points_camera
    assert len(P) == 20
    assert len(reconstruction.regions.s) == len(observations.points_camera)
    assert len(reconstruction.confidence) == 100
    assert (reconstruction.unseen[:, 0] <= reconstruction.unseen[:, 1]).all()
    assert evaluate(knots, P, 3, even_parameters(knots, P, 3, 50))[:, 2].min() > 0


@pytest.fixture(scope="session")
def check_sound():
    return checked
