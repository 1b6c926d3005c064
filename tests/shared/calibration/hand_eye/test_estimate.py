"""The base's place, the delay and the point of the tool come out of simulated sightings, with honest deviations."""

import numpy as np
import pytest

from schemas.messages import RectifiedStereo
from shared.calibration import CalibrationError
from shared.calibration.hand_eye.estimate import Motion, Sightings, estimated
from shared.kinematics.psm import forward
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as X
from shared.rigid_transforms import apply, inverse, log_se3

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 0.0055, 1.0)
TIP = np.array((0.0, 0.0, 0.0102))
DELAY_S = 0.083
MIDDLE, STROKE = np.array((0, 0, 0.18, 0, 0, 0)), np.array((0.15, 0.12, 0.02, 0.6, 0.5, 0.5))


def moving(rng):
    t = np.arange(0, 20, 0.01)
    phase = 2 * np.pi * rng.uniform(0.1, 0.4, 6) * t[:, None] + rng.uniform(0, 6, 6)
    return Motion(t, forward(MIDDLE + STROKE * np.sin(phase)))


def seen(motion, rng, noise_px=1.0):
    t = np.arange(0, 20, 0.2)
    blank = Sightings(t, np.zeros((len(t), 4)), CAMERA)
    px = blank.predicted(apply(X, motion.at(t - DELAY_S, TIP))) + rng.normal(0, noise_px, (len(t), 4))
    wrong = rng.random(len(t)) < 0.1
    px[wrong] += rng.normal(0, 60, (wrong.sum(), 4))
    return Sightings(t, px, CAMERA)


@pytest.mark.slow
def test_base_delay_and_point_are_found_within_their_deviations():
    nees = []
    for seed, known in ((0, True), (1, False)):
        rng = np.random.default_rng(seed)
        motion = moving(rng)
        found = estimated(seen(motion, rng), motion, TIP if known else np.zeros(3), known)
        twist = log_se3(found.T_camera_base @ inverse(X))
        nees.append(twist @ np.linalg.solve(found.covariance, twist))
        assert found.delay_s == pytest.approx(DELAY_S, abs=0.002)
        np.testing.assert_allclose(found.point_tool, TIP, atol=2e-4)
        assert found.deviation_m(np.array((0, 0, 0.09))) < 1e-4
        assert 0.7 < np.median(found.residual) < 1.1
        assert np.median(found.held_out) == pytest.approx(np.median(found.residual), rel=0.1)
    # a chi square with 6 degrees of freedom lies within 1.6 and 12.6 nine times of ten
    assert 1.6 < np.mean(nees) < 12.6


def test_a_tool_that_stands_at_each_pose_tells_no_delay_but_the_base():
    rng = np.random.default_rng(1)
    stands = forward(MIDDLE + STROKE * rng.uniform(-1, 1, (30, 6)))
    motion = Motion(np.arange(0, 60, 0.02), np.repeat(stands, 100, axis=0))
    t = np.arange(1.0, 60, 2.0)
    points = apply(X, motion.at(t, TIP)) + rng.normal(0, 3e-4, (len(t), 3))
    found = estimated(Sightings(t, points, None), motion, TIP)
    assert found.delay_s is None
    twist = log_se3(found.T_camera_base @ inverse(X))
    assert np.linalg.norm(twist[:3]) < 1.5e-3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s, m: (s, Motion(m.time_s + 100, m.T_base_tool)), "0 of 100 sightings lie within the time"),
        (lambda s, m: (s, Motion(m.time_s, np.tile(np.eye(4), (2000, 1, 1)))), "robot's poses lie within 0.0 mm"),
        (lambda s, m: (s, Motion(m.time_s, m.T_base_tool[::-1])), "do not move alike|contradict"),
        (lambda s, m: (Sightings(s.time_s, np.tile(s.seen[:1], (100, 1)), CAMERA), m), "of one line"),
    ],
)
def test_what_tells_nothing_is_refused_in_a_sentence(change, said):
    rng = np.random.default_rng(2)
    motion = moving(rng)
    sightings, motion = change(seen(motion, rng), motion)
    with pytest.raises(CalibrationError, match=said):
        estimated(sightings, motion, TIP)
