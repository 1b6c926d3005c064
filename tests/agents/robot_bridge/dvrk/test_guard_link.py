"""What a bridge sent to its guard is known again when the console gets it."""

import numpy as np

from agents.robot_bridge.dvrk.guard_link import REMEMBERED, GuardLink
from shared.ros import crtk


def test_a_jaw_that_stands_through_a_long_motion_is_ours_to_its_end():
    link = GuardLink("PSM1", lambda _key, _payload: True, lambda: 0)
    for number in range(REMEMBERED + 100):
        joints = tuple(1e-4 * number + 0.1 * axis for axis in range(6))
        link.move((*joints, 0.5), "a")
        assert link.ours(crtk.joint_command(np.array(joints), 0))
        assert link.ours(crtk.joint_command(np.array([0.5]), 0))
    assert not link.ours(crtk.joint_command(np.array([0.6]), 0))
