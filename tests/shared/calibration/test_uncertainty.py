"""What an error of the calibration does to a point is what a wrong calibration makes of its pixels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.messages import RectifiedStereo
from shared.calibration.uncertainty import ERRORS, bending, displacements, field_of
from shared.rigid_transforms import exp_so3

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)
POINTS = np.array([[x, y, z] for x in (-20.0, 0.0, 15.0) for y in (-10.0, 8.0) for z in (70.0, 80.0, 95.0)])
SMALL = 1e-6


def measured(points, error):
    """Where points are seen that a calibration with one small error is asked about."""
    amount = dict.fromkeys(ERRORS, 0.0) | {error: SMALL}
    left = points[:, :2] / points[:, 2:]
    right_eye = points - (CAMERA.baseline, 0, 0)
    turned = right_eye @ exp_so3(np.array([amount["pitch"], amount["vergence"], amount["roll"]])).T
    right = turned[:, 0] / turned[:, 2] * (1 + amount["focal_apart"])
    centre = np.array([amount["cx"], amount["cy"]])
    left, right = (left - centre) / (1 + amount["focal"]), (right - centre[0]) / (1 + amount["focal"])
    depth = CAMERA.baseline * (1 + amount["baseline"]) / (left[:, 0] - right)
    return np.column_stack((left * depth[:, None], depth))


@pytest.mark.parametrize("error", ERRORS)
def test_a_point_moves_as_a_wrong_calibration_moves_it(error):
    moved = (measured(POINTS, error) - POINTS) / SMALL
    told = displacements(CAMERA, POINTS)[:, :, ERRORS.index(error)]
    np.testing.assert_allclose(told, moved, rtol=1e-3, atol=0.05)


@given(st.floats(0.3, 3.0), st.floats(2.0, 50.0))
def test_no_rigid_motion_of_the_field_is_left_and_what_stretches_it_is(zoom, baseline):
    camera = RectifiedStereo(960, 540, 1000.0 * zoom, 1000.0 * zoom, 479.5, 269.5, baseline, None)
    depth = float(f"{15.0 * baseline * zoom:.2g}")
    field = field_of(camera, depth)
    bent = bending(camera, field, depth)
    size = np.abs(displacements(camera, field)).max(axis=(0, 1))
    assert (np.abs(bent.mean(axis=0)) < 1e-6 * size).all()
    turning = np.cross(field[:, :, None] - field.mean(axis=0)[:, None], bent, axis=1).mean(axis=0)
    assert (np.abs(turning) < 1e-6 * size * depth).all()
    # a longer baseline stretches all, which no motion undoes
    apart = field[-1] - field[0]
    stretched = (bent[-1] - bent[0])[:, ERRORS.index("baseline")]
    np.testing.assert_allclose(stretched, apart, rtol=0.02, atol=0.02 * depth)
