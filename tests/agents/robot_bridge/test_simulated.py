import numpy as np

from agents.robot_bridge.backend import Readiness
from agents.robot_bridge.simulated import SIMULATED_START, SimulatedPsm, waiting
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER, forward, within_limits
from shared.kinematics.simulated_setup import SIMULATED_BASES, SIMULATED_T_CAMERA_BASE

SECOND = 10**9
START = np.array(SIMULATED_START)


def test_each_arm_waits_on_its_own_side_beside_the_field_of_view_and_before_the_camera() -> None:
    assert within_limits(START) is None
    right, up, away = (SIMULATED_T_CAMERA_BASE @ forward(START))[:3, 3]
    assert 0.02 < away < 0.07
    assert right / away > 0.48
    base = SIMULATED_BASES["psm2"]
    assert waiting(SIMULATED_T_CAMERA_BASE) == SIMULATED_START
    left = (base @ forward(np.array(waiting(base))))[:3, 3]
    np.testing.assert_allclose(left, (-right, up, away), atol=1e-12)


def test_without_a_set_point_and_where_the_clock_goes_backwards_it_stands_still() -> None:
    arm = SimulatedPsm()
    for tick in (0, 1, 2):
        state = arm.state(tick * SECOND)
        np.testing.assert_array_equal(state.joints, START)
        assert (state.measured_ns, state.readiness) == (tick * SECOND, Readiness.READY)
    arm.move(START + 0.1, 1.0, "a")
    np.testing.assert_array_equal(arm.state(0).joints, START)


def test_no_joint_nor_the_jaw_moves_faster_than_it_can_and_it_arrives() -> None:
    arm = SimulatedPsm()
    state = arm.state(0)
    target = np.array((-0.5, 0.4, 0.2, 3.0, -1.0, 1.0))
    arm.move(target, 1.2, "a")
    for tick in range(1, 101):
        before, state = state.joints, arm.state(tick * SECOND // 100)
        speed = np.abs(state.joints - before) * 100
        assert (speed <= LARGE_NEEDLE_DRIVER.max_speeds * (1 + 1e-9)).all()
    np.testing.assert_allclose(state.joints, target)
    assert state.jaw_rad == 1.2


def test_hold_stops_it_at_once() -> None:
    arm = SimulatedPsm()
    arm.state(0)
    arm.move(START + 0.1, 1.0, "a")
    stopped = arm.state(SECOND // 1000)
    assert not arm.holds
    arm.hold()
    np.testing.assert_array_equal(arm.state(SECOND).joints, stopped.joints)
    assert arm.state(2 * SECOND).jaw_rad == stopped.jaw_rad
    assert arm.holds


def test_set_points_beyond_a_limit_are_clipped_as_the_robot_clips_them() -> None:
    arm = SimulatedPsm()
    arm.state(0)
    arm.move(np.full(6, 10.0), 10.0, "a")
    state = arm.state(100 * SECOND)
    np.testing.assert_allclose(state.joints, LARGE_NEEDLE_DRIVER.limits[:, 1])
    assert state.jaw_rad == LARGE_NEEDLE_DRIVER.jaw_limit[1]
