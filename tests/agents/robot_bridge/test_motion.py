"""From a plan's waypoints to the joints of every tick: smooth, within all limits, or refused by name."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.robot_bridge.checks import joints_of, waypoint_refusal
from agents.robot_bridge.limits import MotionLimits, Setup
from agents.robot_bridge.motion import MAXIMUM_WAYPOINTS, Trajectory, plan_motion, segment_end
from agents.robot_bridge.path import Poses, smooth_path
from agents.robot_bridge.plans import Code, Refusal
from agents.robot_bridge.simulated import SIMULATED_START
from agents.robot_bridge.tissue import measured_at
from schemas.messages import Phase, Waypoint
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER, forward, joint_problem
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.rigid_transforms import exp_so3, log_so3, transform
from tests.agents.robot_bridge.drive import tissue

START = np.array(SIMULATED_START)
LIMITS = MotionLimits()
SETUP = Setup(LARGE_NEEDLE_DRIVER, SIMULATED_T_CAMERA_BASE, LIMITS, 0.01)
ROOMY = dataclasses.replace(SETUP, limits=MotionLimits(workspace_camera=np.array(((-1.0, -1, -1), (1, 1, 1)))))
"""As if the camera saw everything."""
HALF_TURN = np.diag((-1.0, -1.0, 1.0, 1.0))


def pose(x_mm: float, y_mm: float, z_mm: float, turn: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    return transform(exp_so3(np.array(turn, float)), np.array((x_mm, y_mm, z_mm)) / 1e3)


def waypoint(T: np.ndarray, jaw_rad: float = 0.5, phase: Phase = Phase.APPROACH) -> Waypoint:
    return Waypoint(T, jaw_rad, phase, None)


def at(*joints: float) -> np.ndarray:
    """The pose before the camera of a tool whose arm has these joints."""
    return SIMULATED_T_CAMERA_BASE @ forward(np.array(joints))


def limited(**changes) -> Setup:
    return dataclasses.replace(SETUP, limits=dataclasses.replace(LIMITS, **changes))


def grasp() -> tuple[Waypoint, ...]:
    """Approach, close, slide along a curve, grasp, retreat."""
    slide = [pose(-10 + i, 5 + 0.05 * i * i, 85, (0, 0, 0.5 + 0.03 * i)) for i in range(15)]
    return (
        waypoint(pose(-10, 5, 70, (0, 0, 0.5)), 1.0),
        waypoint(slide[0], 1.0),
        waypoint(slide[0], 0.3, Phase.CAPTURE),
        *(waypoint(T, 0.3, Phase.SLIDE) for T in slide[1:]),
        waypoint(slide[-1], -0.2, Phase.GRASP),
        waypoint(pose(4, 14.8, 70, (0, 0, 0.92)), -0.2, Phase.RETREAT),
    )


def motion(*waypoints: Waypoint, setup: Setup = SETUP, joints: np.ndarray = START) -> Trajectory:
    planned = plan_motion(waypoints, joints, 0.0, setup)
    assert isinstance(planned, Trajectory), planned
    return planned


def refusal(*waypoints: Waypoint, setup: Setup = SETUP, joints: np.ndarray = START, **how: Any) -> tuple[Code, str]:
    refused = plan_motion(waypoints, joints, 0.0, setup, **how)
    assert isinstance(refused, Refusal)
    return refused.code, refused.sentence


def camera_poses(trajectory: Trajectory) -> np.ndarray:
    """As the waypoints have them: jaws are the same after half a turn about their fingers."""
    poses = SIMULATED_T_CAMERA_BASE @ forward(trajectory.joints)
    return poses @ HALF_TURN if trajectory.turned else poses


@pytest.fixture(scope="module")
def grasped() -> Trajectory:
    return motion(*grasp())


# the way


def test_the_motion_begins_where_the_arm_is_passes_every_waypoint_and_rests_where_each_phase_ends(grasped) -> None:
    np.testing.assert_array_equal(grasped.joints[0], START)
    poses = camera_poses(grasped)
    for target in grasp():
        # a tick at full speed leads 0.5 mm and 0.015 rad on
        near = np.linalg.norm(poses[:, :3, 3] - target.T_camera_tool[:3, 3], axis=1) < 3e-4
        turned = np.linalg.norm(log_so3(target.T_camera_tool[:3, :3].T @ poses[:, :3, :3]), axis=1) < 0.02
        assert (near & turned & (np.abs(grasped.jaw_rad - target.jaw_rad) < 0.02)).any()
    last = {point.phase: point for point in grasp()}
    assert [stop.phase for stop in grasped.stops if stop.phase] == list(last)
    assert grasped.stops[-1].sample == len(grasped.joints) - 1
    steps = np.abs(np.diff(grasped.joints, axis=0)).max(axis=1)
    for sample, phase in ((stop.sample, stop.phase) for stop in grasped.stops):
        assert steps[max(sample - 1, 0) : sample + 1].max() < 0.05 * steps.max(), "it rests"
        if phase:
            np.testing.assert_allclose(poses[sample], last[phase].T_camera_tool, atol=1e-9)
            assert grasped.jaw_rad[sample] == pytest.approx(last[phase].jaw_rad)
    between = grasped.at(1.234)[0]
    np.testing.assert_allclose(between, 0.6 * grasped.joints[123] + 0.4 * grasped.joints[124], atol=1e-12)


def derivatives(rows: np.ndarray, period_s: float) -> list[float]:
    """The largest of the first three derivatives of rows, from rest to rest."""
    found, derivative = list[float](), rows
    rest = np.zeros((1, rows.shape[1]))
    for ends in ((), (rest,), (rest,)):
        derivative = np.diff(np.concatenate((*ends, derivative, *ends)), axis=0) / period_s
        found.append(float(np.linalg.norm(derivative, axis=1).max()))
    return found


@pytest.mark.parametrize("period_s", [0.01, 0.005])
def test_speeds_accelerations_and_jerks_keep_to_their_limits_and_contact_is_slower(period_s: float) -> None:
    trajectory = motion(*grasp(), setup=dataclasses.replace(SETUP, period_s=period_s))
    poses = camera_poses(trajectory)
    R = poses[:, :3, :3]
    turning = np.einsum("nij,nj->ni", R[:-1], log_so3(np.swapaxes(R[:-1], 1, 2) @ R[1:]))
    turned = np.concatenate((np.zeros((1, 3)), np.cumsum(turning, axis=0)))
    moved = derivatives(poses[:, :3, 3], period_s)
    turns, jaw = derivatives(turned, period_s), derivatives(trajectory.jaw_rad[:, None], period_s)
    for found, limits in (
        (moved, (LIMITS.speed, LIMITS.acceleration, LIMITS.jerk)),
        (turns, (LIMITS.angular_speed, LIMITS.angular_acceleration, LIMITS.angular_jerk)),
        (jaw, (LIMITS.jaw_speed, LIMITS.jaw_acceleration, LIMITS.jaw_jerk)),
    ):
        assert (np.array(found) <= np.array(limits) * (1 + 1e-6)).all()
    assert moved[0] > 0.8 * LIMITS.speed
    assert moved[2] > 0.3 * LIMITS.jerk
    joint_speeds = np.abs(np.diff(trajectory.joints, axis=0)) / period_s
    assert (joint_speeds <= 0.8 * LARGE_NEEDLE_DRIVER.max_speeds + 1e-6).all()
    approach, _, slide, *_ = [stop.sample for stop in trajectory.stops if stop.phase]
    contact = np.linalg.norm(np.diff(poses[approach : slide + 1, :3, 3], axis=0), axis=1).max() / period_s
    assert contact <= LIMITS.contact_share * LIMITS.speed * (1 + 1e-6)


def test_a_joint_that_would_be_too_fast_slows_the_leg_down(grasped) -> None:
    links = tuple(link._replace(max_speed=link.max_speed / 50) for link in LARGE_NEEDLE_DRIVER.links)
    slow = dataclasses.replace(SETUP, kinematics=dataclasses.replace(LARGE_NEEDLE_DRIVER, links=links))
    trajectory = motion(*grasp(), setup=slow)
    shares = np.abs(np.diff(trajectory.joints, axis=0)) / SETUP.period_s / slow.kinematics.max_speeds
    assert 0.7 < shares.max() <= 0.8 + 1e-6
    assert len(trajectory.joints) > 1.5 * len(grasped.joints)


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_a_slowed_motion_goes_the_same_way_and_takes_as_much_longer(share: float, grasped) -> None:
    roomy = dataclasses.replace(LIMITS, maximum_duration_s=600.0)
    slowed = motion(*grasp(), setup=dataclasses.replace(SETUP, limits=roomy.slowed(share)))
    assert slowed.duration_s == pytest.approx(grasped.duration_s / share, rel=0.02)
    samples = [int(i) for i in np.linspace(0, len(grasped.joints) - 1, 40)]
    between = np.array([slowed.at(i * SETUP.period_s / share)[0] for i in samples])
    assert np.abs(between - grasped.joints[samples]).max() < 0.03


def test_the_jaws_go_the_shorter_way_round_and_the_other_one_where_that_is_refused() -> None:
    near = pose(0, 0, -5) @ at(*START)
    for target, turned in ((near, False), (near @ HALF_TURN, True)):
        trajectory = motion(waypoint(target), waypoint(pose(3, 0, 0) @ target))
        assert trajectory.turned is turned
        assert np.ptp(trajectory.joints[:, 3]) < 0.3, "a wrist that had nothing to turn for stays as it is"
        np.testing.assert_allclose(camera_poses(trajectory)[-1], pose(3, 0, 0) @ target, atol=1e-9)
    # a roll near its end cannot go on the shorter way
    wound = START + np.array((0, 0, 0, 4.4, 0, 0))
    target = at(*(wound + np.array((0, 0, 0.01, 0.4, 0, 0))))
    planned = motion(waypoint(target), joints=wound)
    assert planned.turned
    assert (joint_problem(planned.joints) == 0).all()
    np.testing.assert_allclose(camera_poses(planned)[-1], target, atol=1e-9)


def test_a_plan_that_leads_nowhere_is_done_at_once() -> None:
    here = waypoint(at(*START), jaw_rad=0.0)
    trajectory = motion(here, here)
    assert (len(trajectory.joints), [stop.sample for stop in trajectory.stops]) == (1, [0, 0])
    np.testing.assert_array_equal(trajectory.at(1.0)[0], START)


points = st.tuples(*[st.floats(-0.05, 0.05)] * 3)
turns = st.tuples(*[st.floats(-3, 3)] * 3)


@given(st.lists(st.tuples(points, turns, st.floats(-0.6, 1.3)), min_size=2, max_size=6))
def test_a_path_stays_between_neighbouring_waypoints_and_ends_at_the_last(rows) -> None:
    T = np.stack([transform(exp_so3(np.array(turn)), np.array(place)) for place, turn, _ in rows])
    jaw = np.array([angle for *_, angle in rows])
    path = smooth_path(Poses(T, jaw), LIMITS, 1.0)
    if path is None:
        np.testing.assert_allclose(T, np.broadcast_to(T[:1], T.shape), atol=1e-8)
        return
    samples = path.sample(0.01)
    np.testing.assert_allclose(samples.T_base_tool[[0, -1]], T[[0, -1]], atol=1e-7)
    places = samples.T_base_tool[:, None, :3, 3]
    lower, upper = np.minimum(T[:-1], T[1:])[:, :3, 3], np.maximum(T[:-1], T[1:])[:, :3, 3]
    inside = np.all((places >= lower - 5e-4) & (places <= upper + 5e-4), axis=2)
    assert inside.any(axis=1).all()
    assert samples.jaw_rad.min() >= jaw.min() - 1e-9
    assert samples.jaw_rad.max() <= jaw.max() + 1e-9


# what is refused


@pytest.mark.parametrize(
    ("T", "jaw", "code", "words"),
    [
        (pose(0, 0, 150), 0.0, Code.WORKSPACE, "waypoint 1"),
        (pose(1e303, 0, 80), 0.0, Code.WORKSPACE, "waypoint 1"),
        (pose(0, 0, 80, (np.pi, 0, 0)), 0.0, Code.UNREACHABLE, "wrist"),
        (pose(0, 0, 80), 1.5, Code.JAW_LIMIT, "1.5 rad"),
        (pose(0, 0, 80), -0.8, Code.JAW_LIMIT, "jaw"),
    ],
)
def test_a_waypoint_that_cannot_be_is_refused_and_named(T: np.ndarray, jaw: float, code: Code, words: str) -> None:
    refused, sentence = refusal(waypoint(pose(0, 0, 70)), waypoint(T, jaw))
    assert (refused, words in sentence) == (code, True)


def test_poses_that_no_message_could_hold_are_refused_all_the_same() -> None:
    good, jaw = np.stack([pose(0, 0, 80)] * 3), np.zeros(3)
    broken, sheared, angle = good.copy(), good.copy(), jaw.copy()
    broken[2, 0, 3], sheared[1, 0, 0], angle[0] = np.nan, 1e200, np.inf
    refusals = [waypoint_refusal(T, a, SETUP) for T, a in ((good, jaw), (broken, jaw), (sheared, jaw), (good, angle))]
    assert [r and r.code for r in refusals] == [None, Code.NOT_FINITE, Code.NOT_A_POSE, Code.NOT_FINITE]
    assert refusals[1] is not None
    assert "waypoint 2" in refusals[1].sentence


def test_a_way_that_the_arm_cannot_go_between_good_waypoints_is_refused() -> None:
    narrow = limited(workspace_camera=np.array(((-0.05, -0.05, 0.05), (0.05, 0.05, 0.12))))
    code, sentence = refusal(waypoint(pose(0, 0, 80)), setup=narrow)
    assert (code, "on the way to the end of APPROACH" in sentence) == (Code.WORKSPACE, True)
    rolls = (START + np.array((0, 0, 0, roll, 0, 0)) for roll in (1, 3, 5, 7, 8.5))
    code, sentence = refusal(*(waypoint(at(*joints)) for joints in rolls))
    assert (code, "roll joint" in sentence) == (Code.UNREACHABLE, True)
    motion(waypoint(pose(0, 0, 80, (0, 0.9, 0))), waypoint(pose(0, 0, 80, (0, -0.9, 0))))
    # nor is a jaw that stands beyond its limit sent to an angle beyond it
    beyond = plan_motion((waypoint(pose(0, 0, 80)),), START, LARGE_NEEDLE_DRIVER.jaw_limit[0] - 0.1, SETUP)
    assert isinstance(beyond, Refusal)
    assert beyond.code is Code.JAW_LIMIT


@settings(max_examples=20)
@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(0.13, 0.19), st.floats(-1.2, 1.2), st.floats(-1, 1))
def test_a_way_on_which_the_wrist_would_have_to_flip_within_a_tick_is_refused(
    yaw: float, pitch: float, insertion: float, roll: float, wrist: float
) -> None:
    joints = np.array((yaw, pitch, insertion, roll, 0.3 * wrist, wrist))
    here = forward(joints)
    # the jaws half a turn about the fingers look the same, and need a wrist that stands otherwise
    for then, flips in ((here @ HALF_TURN, True), (here, False)):
        found = joints_of(Poses(np.stack((here, then)), np.zeros(2)), joints, "on the way", ROOMY)
        assert (isinstance(found, Refusal) and found.code is Code.WRIST_FLIP) is flips
        assert flips or isinstance(found, np.ndarray)


def test_neither_arm_nor_waypoint_may_be_near_a_singular_pose_or_the_remote_centre_but_who_is_may_leave() -> None:
    bent = np.array((0.1, 0.0, 0.13, 0.0, 1.385, 0.0))
    code, sentence = refusal(waypoint(at(*bent)), setup=ROOMY)
    assert (code, "on the way" in sentence, "dexterity" in sentence) == (Code.SINGULAR, True, True)
    motion(waypoint(at(*(bent * (1, 1, 1, 1, 0.9, 1)))), setup=ROOMY, joints=bent)
    retracted = START - np.array((0, 0, START[2] - 0.05, 0, 0, 0))
    assert refusal(waypoint(pose(0, 0, 80)), joints=retracted)[0] is Code.REMOTE_CENTRE
    assert refusal(waypoint(at(0, 0, 0.06, 0, 0, 0)), setup=ROOMY)[0] is Code.REMOTE_CENTRE


def test_too_many_waypoints_none_at_all_and_a_motion_without_end_are_refused() -> None:
    point = waypoint(pose(0, 0, 80))
    assert refusal(*(point,) * (MAXIMUM_WAYPOINTS + 1))[0] is Code.TOO_LONG
    assert refusal()[0] is Code.TOO_LONG
    code, sentence = refusal(*(waypoint(pose(x, 0, 80)) for x in (-30, 30) * 60))
    assert (code, "60 s" in sentence) == (Code.TOO_LONG, True)


@given(points, turns, st.floats(-3, 3))
def test_any_waypoint_gives_a_motion_within_all_limits_or_a_reason(place, turn, jaw: float) -> None:
    T = transform(exp_so3(np.array(turn)), np.array(place) + np.array((0, 0, 0.08)))
    planned = plan_motion((waypoint(T, jaw),), START, 0.0, SETUP)
    if isinstance(planned, Refusal):
        assert planned.sentence
        return
    assert (joint_problem(planned.joints) == 0).all()
    assert (np.abs(np.diff(planned.joints, axis=0)) <= LARGE_NEEDLE_DRIVER.max_speeds * SETUP.period_s).all()
    np.testing.assert_allclose(camera_poses(planned)[-1], T, atol=1e-9)


def test_a_motion_that_is_too_long_at_once_is_cut_before_contact_alone(grasped) -> None:
    cap_s = 0.75 * grasped.duration_s
    capped = limited(maximum_duration_s=cap_s)
    assert refusal(*grasp(), setup=capped)[0] is Code.TOO_LONG
    chained = plan_motion(grasp(), START, 0.0, capped, segments=3)
    assert isinstance(chained, Trajectory)
    first = segment_end(chained, cap_s)
    assert chained.stops[first].phase in (None, Phase.APPROACH)
    assert chained.stops[first].sample * SETUP.period_s <= cap_s
    assert segment_end(chained, cap_s, first + 1) == len(chained.stops) - 1
    short = limited(maximum_duration_s=0.2 * cap_s)
    assert refusal(*grasp(), setup=short, segments=8)[0] is Code.TOO_LONG, "contact itself is never cut"


def test_tissue_counts_as_measured_where_tips_are_seen_over_cells_or_right_beside_them() -> None:
    flat = tissue(1, 0.095)
    over = transform(np.eye(3), np.array((0.01, 0.0, 0.075)))
    assert measured_at(flat, over[None])
    for near, measured in ((3, True), (9, False)):
        valid = flat.valid.copy()
        # the tips are seen at column 39, row 24
        valid[24 - near // 2 : 25 + near // 2, 39 - near // 2 : 40 + near // 2] = False
        told = {"valid": valid, "depth": valid * flat.depth, "deviation": valid * flat.deviation}
        assert measured_at(dataclasses.replace(flat, **told), over[None]) == measured
    beside = transform(np.eye(3), np.array((0.2, 0.0, 0.075)))
    assert not measured_at(flat, np.stack((over, beside))), "every place counts, and one is out of view"


def test_a_finger_that_would_go_into_the_tissue_is_refused_and_one_before_it_is_not() -> None:
    flat = dataclasses.replace(tissue(1, 0.095), deviation=np.full((48, 64), 1e-4))
    setup = dataclasses.replace(SETUP, surface=flat)
    # fingers end 10.2 mm beyond the pin
    shallow, deep = (waypoint(pose(10, 5, z_mm), 0.0) for z_mm in (85, 97))
    motion(shallow, setup=setup)
    code, sentence = refusal(shallow, deep, setup=setup)
    assert (code, "behind the tissue" in sentence) == (Code.TISSUE, True)
    unknown = dataclasses.replace(flat, valid=~flat.valid, depth=0 * flat.depth, deviation=0 * flat.depth)
    motion(deep, setup=dataclasses.replace(SETUP, surface=unknown))
    # whoever is in it may leave
    motion(shallow, setup=setup, joints=motion(deep).joints[-1])
