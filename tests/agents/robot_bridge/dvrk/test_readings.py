"""What a console tells of an arm: what of it counts, by the robot's own clock, and what speaks against moving."""

import numpy as np
import pytest

from agents.dvrk_emulator.messages import JointState, OperatingState, String, header
from agents.robot_bridge.backend import Readiness
from agents.robot_bridge.dvrk.readings import CLOCK_SET_NS, POSE_AGE_NS, Readings
from schemas.messages import StateWord
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.rigid_transforms import exp_so3, transform
from shared.ros import crtk

MS, ARRIVED = 10**6, 10**18
STAMP = 77 * 10**15
"""The robot's clock is elsewhere."""
HERE = np.array((0.2, 0.0, 0.13, 0.0, 0.0, 0.0))
POSE = LARGE_NEEDLE_DRIVER.forward(HERE)


class Told:
    """Readings, told of an arm that is enabled and homed and stands at HERE."""

    def __init__(self):
        self.readings, self.now_ns = Readings("PSM1", "", LARGE_NEEDLE_DRIVER), ARRIVED
        self.state(homed=True, busy=False)
        self.tell(0)

    def state(self, homed, busy):
        state = OperatingState(header(1), "ENABLED", homed, busy)
        self.readings.hear_state(state.serialize(), self.now_ns)

    def tell(self, at_ms, joints=HERE, pose=None, late_ms=0):
        """Everything, measured so long after STAMP, at 1 ms on its way and later."""
        self.now_ns = ARRIVED + (at_ms + late_ms + 1) * MS
        self.joints(at_ms, joints)
        self.hear("jaw/measured_js", crtk.joint_command(np.zeros(1), STAMP + at_ms * MS))
        self.pose(at_ms, LARGE_NEEDLE_DRIVER.forward(joints) if pose is None else pose)

    def joints(self, at_ms, joints=HERE):
        self.hear("measured_js", crtk.joint_command(joints, STAMP + at_ms * MS))

    def pose(self, at_ms, T=POSE):
        self.hear("local/measured_cp", crtk.pose_command(T, STAMP + at_ms * MS))

    def hear(self, kind, data):
        self.readings.hear(kind, data, self.now_ns)

    def judged(self):
        """What was measured, and the code of what speaks against moving; None where nothing does."""
        measured = self.readings.measured()
        judged = self.readings.judge(measured, 0, self.now_ns)
        return measured, None if judged.readiness is Readiness.READY else judged.code.value


@pytest.fixture
def told():
    told = Told()
    assert told.judged()[1] is None
    return told


def test_a_state_has_come_about_once_the_arm_makes_no_motion_any_more(told):
    assert told.readings.reached(StateWord.ENABLE)
    for homed, busy in ((True, True), (True, False), (False, False)):
        told.state(homed, busy)
        assert told.readings.reached(StateWord.HOME) is (homed and not busy)


def test_a_measurement_that_was_overtaken_does_not_count_unless_the_robots_clock_was_set_back(told):
    told.tell(20_000, HERE + 0.01)
    told.judged()
    told.joints(19_990)
    assert np.array_equal(told.judged()[0].joints, HERE + 0.01)
    told.tell(20_000 - CLOCK_SET_NS // MS - 5_000, HERE + 0.02, late_ms=6_020)
    measured, against = told.judged()
    assert np.array_equal(measured.joints, HERE + 0.02)
    assert told.now_ns - measured.measured_ns < 10 * MS, "nor is it taken for late"
    assert against is None


@pytest.mark.parametrize(
    ("kind", "values"), [("measured_js", [0.0] * 5), ("jaw/measured_js", [0.0] * 2), ("measured_js", [np.nan] * 6)]
)
def test_joints_that_are_too_few_too_many_or_not_finite_are_an_error(told, kind, values):
    told.hear(kind, JointState(header(STAMP), [], values, [], []).serialize())
    assert told.judged()[1] == "error_state"


@pytest.mark.parametrize(
    ("turned_rad", "aside_m", "code"),
    [(0.11, 0.0, "other_pose"), (0.09, 0.0, None), (0.0, 0.0031, "other_pose"), (0.0, 0.0029, None)],
)
def test_a_tool_that_the_console_has_turned_or_elsewhere_is_another(told, turned_rad, aside_m, code):
    change = transform(exp_so3(np.array((turned_rad, 0, 0))), np.array((aside_m, 0, 0)))
    told.tell(100, pose=POSE @ change)
    assert told.judged()[1] == code


@pytest.mark.parametrize("late_ms", [-40, -10, 0, 10, 40])
def test_a_pose_is_compared_with_the_joints_of_its_own_time_whichever_comes_first_and_however_fast_they_move(
    told, late_ms
):
    def joints(at_ms):
        return HERE + 1e-3 * at_ms * np.array((0.5, 0.3, 0.02, 2.0, 1.0, 1.0))

    end_ms, beside = 2 * POSE_AGE_NS // MS, transform(np.eye(3), np.array((0.0, 0.0, 0.004)))
    for at_ms in range(50, end_ms, 10):
        told.now_ns += 10 * MS
        told.joints(at_ms, joints(at_ms))
        told.pose(at_ms - late_ms, LARGE_NEEDLE_DRIVER.forward(joints(at_ms - late_ms)))
        assert told.judged()[1] is None
    for at_ms in range(end_ms, end_ms + 50, 10):
        told.now_ns += 10 * MS
        told.joints(at_ms, joints(at_ms))
        told.pose(at_ms - late_ms, LARGE_NEEDLE_DRIVER.forward(joints(at_ms - late_ms)) @ beside)
        told.judged()
    assert told.judged()[1] == "other_pose"


def test_a_pose_between_two_measurements_far_apart_of_a_moving_arm_says_nothing_and_of_one_that_stands_it_does(told):
    turned = HERE + np.array((0.2, 0, 0, 0.3, 0, 0))
    told.joints(100)
    told.joints(200, turned)
    told.pose(150)
    assert told.judged()[1] is None
    told.joints(400, turned)
    told.pose(300)
    assert told.judged()[1] == "other_pose"


def test_poses_that_come_without_joints_are_told_after_a_while(told):
    told.now_ns += POSE_AGE_NS + MS
    told.pose(POSE_AGE_NS // MS)
    assert told.judged()[1] == "stale_state"


@pytest.mark.parametrize(
    ("effort", "told_nm"), [([-0.3], -0.3), ([], None), ([float("nan")], None), ([1.0, 2.0], None)]
)
def test_the_effort_of_a_jaw_is_told_where_it_is_one_finite_number_and_speaks_against_nothing(told, effort, told_nm):
    told.tell(10)
    told.hear("jaw/measured_js", JointState(header(STAMP + 11 * MS), ["jaw"], [0.2], [], effort).serialize())
    measured, against = told.judged()
    assert (measured.jaw_rad, measured.jaw_effort, against) == (0.2, told_nm, None)


@pytest.mark.parametrize(("said", "instrument"), [("LND:400006", "LND:400006"), ("", ""), ("a\x00b", "")])
def test_the_instrument_is_what_the_console_calls_the_tool_where_that_is_a_name(told, said, instrument):
    told.readings.hear_tool(String(said).serialize(), told.now_ns)
    assert told.readings.instrument == instrument


def test_a_pose_that_does_not_come_any_more_is_stale(told):
    told.now_ns += POSE_AGE_NS + 2 * MS
    told.joints(POSE_AGE_NS // MS + 2)
    assert told.judged()[1] == "stale_state"
