"""Perception finds a tool that is 8 mm and 3 degrees off, and the bridge brings it within a millimetre of its plan."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.tool_tracker.agent import ToolTracker
from agents.tool_tracker.placed import placed_at
from schemas.codec import decode
from schemas.messages import (
    Arm,
    CommandAnswer,
    ExecutionKind,
    FrameStamp,
    GraspPlan,
    Heartbeat,
    Outcome,
    Phase,
    Policy,
    RobotMode,
    RobotState,
    Status,
    ToolStatus,
    Waypoint,
)
from schemas.topics import ARM, CALIBRATION, EXECUTION, HEARTBEAT, PLAN, ROBOT_STATE, TOOL, topic_of
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as T_TRUE
from shared.rigid_transforms import apply, exp_so3, transform
from shared.runtime.agent import Output
from shared.runtime.commands import new_header
from shared.runtime.replay import replay
from tests.rigs.drawn_tool import JAW

TIP = np.array([[0.0, 0.0, 0.0102]])


def armed(session: Any, T_camera_tool: np.ndarray, plan_id: str) -> CommandAnswer:
    """The answer to arming a plan that brings the tool there."""
    stamp = FrameStamp(1, session.now_ns, session.now_ns, session.last[TOOL].stamp.calibration_id)
    grasp = (0.5, 0.4, 0.9, 0.0, (Waypoint(T_camera_tool, JAW, Phase.APPROACH, None),), ())
    plan = GraspPlan(plan_id, "psm1", "g", stamp, Status.OK, "", Policy.DIRECT, *grasp)
    session.tell([Output(PLAN, plan)])
    header = new_header("ann")
    answer = session.command(ARM, Arm(header, "psm1", plan_id))
    if answer.outcome is Outcome.ACCEPTED:
        for _ in range(100):
            session.tell([Output(HEARTBEAT, Heartbeat("psm1", plan_id, session.now_ns, header.id))], "psm1")
            session.run(0.05)
            if session.last[EXECUTION].kind in (ExecutionKind.FINISHED, ExecutionKind.HELD):
                break
    return answer


@pytest.mark.slow
def test_a_tool_far_off_is_brought_within_a_millimetre_and_one_that_is_lost_is_not_moved(begun_session: Any):
    session, camera, found = begun_session
    found_ns = session.now_ns
    stages = [topic_of(entry.key) for entry in session.entries]
    assert 0.006 < found.tip_off_m < 0.01
    assert stages.count(TOOL) <= 8, "three seconds of searching"
    session.run(0.6)
    before = session.last[ROBOT_STATE]
    assert before.T_camera_base_registered is not None, "the state tells the corrected base and the registered one"
    to = transform(exp_so3(np.array((0.05, 0.1, 0.1))), np.array((0.004, 0.003, -0.003)))
    T_camera_tool = T_TRUE @ before.T_base_tool @ to
    assert armed(session, T_camera_tool, "p").outcome is Outcome.ACCEPTED
    assert session.last[EXECUTION].kind is ExecutionKind.FINISHED, session.last[EXECUTION].reason
    ended = session.last[ROBOT_STATE]
    wanted, is_at = apply(T_camera_tool, TIP)[0], apply(T_TRUE @ ended.T_base_tool, TIP)[0]
    assert np.linalg.norm(wanted - is_at) < 1e-3
    assert np.linalg.norm(apply(before.T_camera_base_registered @ ended.T_base_tool, TIP)[0] - is_at) > 6e-3
    bases = [s.T_camera_base for s in states(session) if s.mode is RobotMode.MOVING]
    assert len(bases) > 20
    assert all(np.array_equal(one, bases[0]) for one in bases), "while it moves its base stays"
    # a recording that begins in the middle gives the same again
    later = [e for e in session.entries if topic_of(e.key) is CALIBRATION or e.received_ns >= found_ns]
    repeated = [one for one in replay(ToolTracker, later) if topic_of(one.key) is TOOL]
    assert sum(one.same for one in repeated) >= len(repeated) - 1 > 3

    camera.shown = False
    session.run(1.6)
    assert session.last[TOOL].status in (ToolStatus.LOST, ToolStatus.CONVERGING)
    answer = armed(session, T_camera_tool, "q")
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "correction_lost")
    assert session.last[ROBOT_STATE].T_camera_base_registered is None


def states(session: Any) -> list[RobotState]:
    return [decode(RobotState, one.payload) for one in session.entries if topic_of(one.key) is ROBOT_STATE]


def test_where_a_tool_was_is_taken_from_before_and_after_a_frame_or_not_at_all(begun_session: Any):
    state = next(iter(states(begun_session.session)))
    moved = transform(np.eye(3), np.array((0.0, 0.0, 0.002)))
    one = dataclasses.replace(state, measured_ns=1_000_000_000)
    other = dataclasses.replace(
        state, measured_ns=1_010_000_000, T_base_tool=state.T_base_tool @ moved, jaw_rad=state.jaw_rad + 0.2
    )
    between = placed_at([one, other], 1_002_500_000)
    assert between is not None
    np.testing.assert_allclose(
        between.T_base_tool[:3, 3], apply(state.T_base_tool, np.array([[0, 0, 0.0005]]))[0], atol=1e-12
    )
    assert abs(between.jaw_rad - state.jaw_rad - 0.05) < 1e-12
    assert placed_at([one, other], 1_200_000_000) is None
    # between two states of an arm at rest lie frames that are far from both
    assert ROBOT_STATE.resting_hz is not None
    next_ns = one.measured_ns + round(1e9 / ROBOT_STATE.resting_hz)
    resting = placed_at([one, dataclasses.replace(one, measured_ns=next_ns)], (one.measured_ns + next_ns) // 2)
    assert resting is not None
    np.testing.assert_allclose(resting.T_base_tool, one.T_base_tool, atol=1e-12)
