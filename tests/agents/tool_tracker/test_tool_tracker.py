"""A drawn instrument is found from 8 mm and 3 degrees off, followed, brought where it should go, and lost.

Its arm has a wrong registration; agents in step draw it, move it and look for it.
"""

import functools
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from agents.camera.scene_source import calibration_of
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.correction import CorrectionLimits
from agents.robot_bridge.simulated import SimulatedPsm
from agents.tool_tracker.agent import ToolTracker
from agents.tool_tracker.correction import Correction, about, twist_about
from agents.tool_tracker.evidence import SHRINK, learnt
from agents.tool_tracker.outline import outline, silhouette
from agents.tool_tracker.refinement import View, elsewhere, refined
from agents.tool_tracker.search import Begin, acquired, lined, looking, prior, soft_pair
from agents.tool_tracker.track import MISSES, Following, followed
from agents.tool_tracker.track_message import track_of
from agents.tool_tracker.tubes import SHAFT, placed_at, tubes
from schemas.codec import decode
from schemas.messages import (
    Arm,
    ExecutionKind,
    FrameStamp,
    GraspPlan,
    Heartbeat,
    ImageEncoding,
    Outcome,
    Phase,
    Policy,
    RobotMode,
    RobotState,
    Status,
    StereoFrame,
    ToolStatus,
    Waypoint,
)
from schemas.topics import ARM, CALIBRATION, EXECUTION, FRAMES, HEARTBEAT, MAIN, PLAN, ROBOT_STATE, TOOL, topic_of
from shared.calibration.identity import calibration_id
from shared.images import encode_image
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER as PSM
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as T_TRUE
from shared.rendering.tool_view import Instrument, draw_solids, solids_of
from shared.rigid_transforms import apply, exp_se3, exp_so3, inverse, transform
from shared.runtime.agent import Agent, Input, Output, Received, Tick
from shared.runtime.commands import new_header
from shared.runtime.replay import Lockstep, replay
from tests.rigs.drawn_tool import BEHIND, CAMERA, IN_MM, JAW, joints, pair, pair_of
from tests.rigs.drawn_tool import TOOL as DRAWN

TIP = np.array([[0.0, 0.0, 0.0102]])
AT_FIRST = PSM.forward(joints(0))
CALIBRATED = calibration_of(IN_MM)
REGISTERED = about(apply(T_TRUE @ AT_FIRST, TIP)[0], np.array((0.005, -0.004, 0.0048, 0.03, -0.03, 0.03))) @ T_TRUE
"""Where the base is told to be: 8 mm and 3 degrees off, about the tip."""


class DrawnCamera(Agent):
    """Draws the arm's instrument where it really is, five times a second; `shown` False hides it."""

    kind, instance, tick_hz = "camera", MAIN, 5.0
    inputs = (Input(ROBOT_STATE, "psm1"),)
    outputs = (FRAMES, CALIBRATION)
    commands = ()

    def __init__(self):
        self.shown, self._state, self._sequence = True, None, 0

    def step(self, arrived):
        if isinstance(arrived, Received):
            self._state = arrived.message
        if not isinstance(arrived, Tick):
            return
        if self._sequence == 0:
            yield Output(CALIBRATION, CALIBRATED)
        self._sequence += 1
        if isinstance(self._state, RobotState):
            images = pair_of(self._state.T_base_tool, self._state.jaw_rad, self._sequence, self.shown)
            left, right = (encode_image(one, ImageEncoding.RAW) for one in images)
            stamp = FrameStamp(self._sequence, arrived.now_ns, arrived.now_ns, calibration_id(CALIBRATED))
            yield Output(FRAMES, StereoFrame(stamp, left, right))


@functools.cache
def begun() -> Any:
    """Agents in step until the instrument was followed, the camera, and what was told then; one test goes on."""
    camera = DrawnCamera()
    config = RobotBridgeConfig(T_camera_base=REGISTERED, correction=CorrectionLimits())
    bridge = RobotBridge(config, SimulatedPsm(tuple(joints(0)), JAW))
    session = Lockstep(bridge, camera, ToolTracker(), rig="lab")
    for _ in range(30):
        session.run(0.1)
        told = session.last.get(TOOL)
        if told is not None and told.status is ToolStatus.CONVERGED:
            return session, camera, told
    raise AssertionError(session.last[TOOL].reason)


def states(session):
    return [decode(RobotState, one.payload) for one in session.entries if topic_of(one.key) is ROBOT_STATE]


def armed(session, T_camera_tool, plan_id):
    """The answer to arming a plan that brings the tool there."""
    stamp = FrameStamp(1, session.now_ns, session.now_ns, session.last[TOOL].stamp.calibration_id)
    grasp = (0.5, 0.4, 0.9, 0.0, (Waypoint(T_camera_tool, JAW, Phase.APPROACH, None),), ())
    session.tell([Output(PLAN, GraspPlan(plan_id, "psm1", "g", stamp, Status.OK, "", Policy.DIRECT, *grasp))])
    header = new_header("ann")
    answer = session.command(ARM, Arm(header, "psm1", plan_id))
    for _ in range(100 if answer.outcome is Outcome.ACCEPTED else 0):
        session.tell([Output(HEARTBEAT, Heartbeat("psm1", plan_id, session.now_ns, header.id))], "psm1")
        session.run(0.05)
        if session.last[EXECUTION].kind in (ExecutionKind.FINISHED, ExecutionKind.HELD):
            break
    return answer


def test_where_a_tool_was_is_taken_from_before_and_after_a_frame_or_not_at_all():
    one = replace(states(begun()[0])[0], measured_ns=1_000_000_000)
    there = one.T_base_tool @ transform(np.eye(3), np.array((0.0, 0.0, 0.002)))
    other = replace(one, measured_ns=1_010_000_000, T_base_tool=there, jaw_rad=one.jaw_rad + 0.2)
    between = placed_at([one, other], 1_002_500_000)
    assert between is not None
    a_quarter = apply(one.T_base_tool, np.array([[0, 0, 0.0005]]))[0]
    np.testing.assert_allclose(between.T_base_tool[:3, 3], a_quarter, atol=1e-12)
    assert abs(between.jaw_rad - one.jaw_rad - 0.05) < 1e-12
    assert placed_at([one, other], 1_200_000_000) is None
    # between two states of an arm at rest lie frames that are far from both
    assert ROBOT_STATE.resting_hz is not None
    next_ns = one.measured_ns + round(1e9 / ROBOT_STATE.resting_hz)
    resting = placed_at([one, replace(one, measured_ns=next_ns)], (one.measured_ns + next_ns) // 2)
    assert resting is not None
    np.testing.assert_allclose(resting.T_base_tool, one.T_base_tool, atol=1e-12)


@pytest.mark.slow
def test_a_tool_far_off_is_brought_within_a_millimetre_and_one_that_is_lost_is_not_moved():
    session, camera, found = begun()
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


def seen(at_s, T_camera_base=REGISTERED):
    return View(CAMERA, (), T_camera_base, PSM.forward(joints(at_s)), JAW)


@pytest.mark.slow
def test_it_is_found_and_followed_to_within_its_covariance():
    track: Any = track_of(begun()[2])
    for at_s in (0.2, 0.4, 0.6):
        track = followed(track, soft_pair(*pair(at_s, round(10 * at_s))), seen(at_s), 0.2, 5)
    assert track.consistent, track.reason
    T_base_tool = PSM.forward(joints(0.6))
    before = apply(REGISTERED @ T_base_tool, TIP)
    error = apply(track.correction.matrix, before)[0] - apply(T_TRUE @ T_base_tool, TIP)[0]
    assert np.linalg.norm(error) < 1e-3
    assert error @ np.linalg.solve(track.correction.point_covariance(before[0]), error) < 16


def test_it_is_lost_with_a_reason_where_it_is_not_seen_or_goes_elsewhere():
    track = track_of(begun()[2])
    jumped = exp_se3(np.array((0.0, 0.03, 0.0, 0.0, 0.0, 0.0))) @ REGISTERED
    elsewhere = followed(track, soft_pair(*pair(0.2, 2)), seen(0.2, jumped), 0.2, 9)
    assert not elsewhere.consistent and elsewhere.reason
    empty = soft_pair(*pair(0.2, 1, shown=False))
    for i in range(MISSES):
        assert track.state is Following.FOLLOWED
        track = followed(track, empty, seen(0.2), 0.2, i)
        assert not track.consistent
    assert track.state is Following.LOST
    assert "of its outline is where it should be" in track.reason


def test_the_outline_is_that_of_what_is_drawn():
    tool = Instrument()
    for eye_x in (0.0, CAMERA.baseline):
        _, cover = draw_solids(BEHIND, IN_MM, solids_of(T_TRUE, AT_FIRST, JAW, tool), tool, 1e3 * eye_x, 0)
        parts = tubes(T_TRUE, AT_FIRST, JAW)
        found = outline(CAMERA, parts, eye_x)
        shaft = found.only(found.part == SHAFT)
        within, beyond = (cover[tuple(np.rint(shaft.px + by * shaft.normal).astype(int).T[::-1])] for by in (-1.5, 1.5))
        assert (within > 128).mean() > 0.95
        assert (beyond < 128).mean() > 0.95
        size = (90, 160)
        small = cv2.resize(cover, size[::-1], interpolation=cv2.INTER_AREA) > 128
        covered = silhouette(CAMERA, parts, eye_x, size) > 0
        assert (covered & small).sum() > 0.85 * (covered | small).sum()


def test_a_correction_turns_about_its_pivot():
    rng = np.random.default_rng(0)
    pivot, twist = rng.normal(0, 0.1, 3), rng.normal(0, 0.1, 6)
    np.testing.assert_allclose(twist_about(pivot, about(pivot, twist)), twist, atol=1e-12)
    only_turned = about(pivot, np.concatenate((np.zeros(3), twist[3:])))
    np.testing.assert_allclose(apply(only_turned, pivot[None])[0], pivot, atol=1e-12)


KNOWN = prior((T_TRUE @ AT_FIRST)[:3, 3], 0.003, 0.03)


def looked_at(tool):
    """An instrument that is registered where it is, with colours learnt there."""
    soft, view = soft_pair(*pair_of(AT_FIRST, JAW, 3, tool=tool)), seen(0.0, T_TRUE)
    size = CAMERA.image_height // SHRINK, CAMERA.image_width // SHRINK
    parts = view.parts(np.eye(4))
    within = (silhouette(CAMERA, parts, eye_x, size).astype(np.float32) for eye_x in (0.0, CAMERA.baseline))
    return looking(view, soft, learnt(soft, tuple(within), False))


@pytest.mark.slow
def test_a_fit_farther_away_than_what_was_known_allows_is_taken_only_where_it_is_better_by_far():
    view = looked_at(DRAWN)
    right = refined(view, KNOWN)
    aside = right.correction.twist + np.array((0, 0, 0.006, 0, 0, 0))
    sure = Correction(aside, np.diag(np.repeat((0.0004, 0.006), 3) ** 2), right.correction.pivot)

    def depth_m(better_by, before):
        beside = replace(right, correction=replace(right.correction, twist=aside), quality=right.quality - better_by)
        return float(elsewhere(view, beside, (-0.006, 0.006), before).correction.twist[2] - aside[2])

    assert depth_m(0.12, None) < -0.003
    assert depth_m(0.12, sure) > -0.002, "within five deviations of what was known"
    assert depth_m(0.5, sure) < -0.003


def test_depth_is_by_what_differs_between_the_eyes_and_not_by_how_thick_a_shaft_looks():
    def depth_m(shaft_radius):
        """How far an instrument of that radius is taken to be, which is thought to have 4.2 mm."""
        found = refined(looked_at(replace(DRAWN, shaft_radius=shaft_radius)), KNOWN)
        return apply(found.correction.matrix, apply(T_TRUE @ AT_FIRST, TIP))[0, 2]

    assert abs(depth_m(4.3) - depth_m(4.1)) < 3e-4, "by its width alone it would be four millimetres"


def test_edges_find_what_colour_cannot():
    """Over tissue as grey as the instrument."""
    soft = soft_pair(*(np.repeat(one[..., 1:2], 3, axis=2) for one in pair_of(AT_FIRST, JAW, 3)))
    view, pivot = seen(0.0), (REGISTERED @ AT_FIRST)[:3, 3]
    scores = lined(CAMERA, soft, view.parts(np.eye(4)), pivot)
    truth = twist_about(pivot, T_TRUE @ inverse(REGISTERED))
    drawn = np.repeat((0.006, 0.045), 3) * np.random.default_rng(0).standard_normal((300, 6))
    assert scores(truth[None])[0] > np.percentile(scores(drawn), 99)
    found, _ = acquired(soft, view, prior(pivot, 0.006, 0.045), np.random.default_rng(1), Begin.LINES)
    beside = found.correction.twist[:3] - truth[:3]
    assert np.linalg.norm(beside[:2]) < 1e-3
    assert abs(beside[2]) < 4 * np.sqrt(found.correction.covariance[2, 2])
