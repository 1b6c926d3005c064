"""A thread made by hand: an arc of a helix before a camera of 960x540, with images, masks and observations."""

import dataclasses
import os
import pathlib
import subprocess
import sys
import types
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.interpolate import make_lsq_spline

from schemas import topics
from schemas.codec import encode, encoding_name
from schemas.messages import (
    AgentConfiguration,
    AgentHealth,
    Alternative,
    Centrelines,
    ChallengeEcho,
    Checked,
    CommandAnswer,
    CommandHeader,
    CommandRecord,
    ExecutionEvent,
    ExecutionKind,
    FrameNotice,
    FrameStamp,
    GraspCheck,
    GraspGoal,
    GraspJudgement,
    GraspPlan,
    Heartbeat,
    HostClock,
    HostClocks,
    Image,
    ImageEncoding,
    InputHealth,
    Judgement,
    LogLevel,
    LogRecord,
    NeedleObservations,
    NeedlePose,
    NeedleView,
    Outcome,
    OutputHealth,
    Phase,
    Policy,
    RectifiedStereo,
    ReliabilityRegions,
    ReplayClock,
    RobotMode,
    RobotState,
    SettableParameter,
    Severity,
    SimulatorState,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadObservations,
    ThreadReconstruction,
    TissueSurface,
    ToolCandidate,
    ToolCorrection,
    ToolStatus,
    Verdict,
    Waypoint,
    no_centrelines,
)
from shared.images import encode_image

WIDTH, HEIGHT, FOCAL_PX, BASELINE = 960, 540, 1000.0, 5.5
CONTROL_POINTS, DEGREE, OBSERVED = 20, 3, 36
CAMERA = RectifiedStereo(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, 479.5, 269.5, BASELINE, 1e-3)
STAMP = FrameStamp(42, 1_760_000_000_000_000_000, 1_760_000_000_000_400_000, "bench")


def helix(t):
    """A curve from 80 to 110 mm before the camera, as a closed form in t from 0 to 1."""
    angle = 1.6 * np.pi * t
    return np.column_stack((-30 + 60 * t, 12 * np.sin(angle), 95 - 15 * np.cos(angle)))


def pixels(points, eye=0.0):
    """Pinhole projection, written out again so that it can serve as an oracle."""
    x, y, z = points.T
    return np.column_stack((FOCAL_PX * (x - eye) / z + 479.5, FOCAL_PX * y / z + 269.5))


def photograph(thread_px, rng):
    """Mottled tissue with a dark thread on it, and the thread's true mask."""
    mottle = cv2.GaussianBlur(rng.normal(0, 60, (HEIGHT, WIDTH)), (0, 0), 12)
    image = np.clip(np.array([95, 95, 170]) + mottle[:, :, None] * 4, 0, 255).astype(np.uint8)
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    at = np.rint(thread_px * 16).astype(np.int32)
    cv2.polylines(mask, [at], False, 255, 5, cv2.LINE_AA, 4)
    cv2.polylines(image, [at], False, (70, 40, 30), 5, cv2.LINE_AA, 4)
    return image, mask


def mask_message(mask):
    data = cv2.imencode(".png", mask)[1].tobytes()
    return Image(ImageEncoding.PNG, mask.shape[1], mask.shape[0], 1, data)


def fitted(t, points):
    inner = np.linspace(0, 1, CONTROL_POINTS - DEGREE + 1)
    knots = np.concatenate((np.zeros(DEGREE), inner, np.ones(DEGREE)))
    return knots, make_lsq_spline(t, points, knots, DEGREE).c


def observed(curve, share, rng):
    """Points along the curve that are off in depth by some of their spread, and that spread."""
    observed_share = np.linspace(0, 1, OBSERVED)
    spread = 0.4 + 2.4 * np.exp(-(((observed_share - 0.62) / 0.1) ** 2))
    points = np.column_stack([np.interp(observed_share, share, axis) for axis in curve.T])
    points *= 1 + (rng.uniform(-0.7, 0.7, OBSERVED) * spread / points[:, 2])[:, None]
    return points, spread


def matches(curve, rng):
    """Pixels with disparities, a fifth of which are wrong, and which are right."""
    disparity = FOCAL_PX * BASELINE / curve[::3, 2]
    kept = rng.random(len(disparity)) > 0.2
    disparity = np.where(kept, disparity, disparity + rng.uniform(-15, 15, len(disparity)))
    return np.column_stack((pixels(curve[::3]), disparity)), kept


def observations_of(points, matched, kept, masks, rng):
    return ThreadObservations(
        stamp=STAMP,
        camera=CAMERA,
        status=Status.OK,
        reason="",
        segmenter="truth",
        points_camera=points,
        half_size_px=rng.uniform(4, 7, (OBSERVED, 2)),
        matched_px=matched,
        match_cost=np.ones((len(matched), 2)),
        inlier=kept,
        mask_left=mask_message(masks[0]),
        mask_right=mask_message(masks[1]),
        judgements=(
            Judgement("ROWS_OFFSET", Severity.WARNING, "Rows differ by 0.8 px (±0.1).", "Calibrate again."),
            Judgement("SMALL", Severity.NOTE, "The thread is 5 px wide.", ""),
            Judgement("SWAPPED", Severity.FAULT, "Left and right seem swapped.", "Exchange the two images."),
        ),
    )


def reconstruction_of(curve, share, points, spread):
    knots, control = fitted(share, curve)
    confidence_s = np.linspace(0, 1, 80)
    return ThreadReconstruction(
        stamp=STAMP,
        camera=CAMERA,
        status=Status.OK,
        reason="",
        method="paper",
        degree=DEGREE,
        knots=knots,
        control_points_camera=control,
        regions=ReliabilityRegions(
            s=np.linspace(0, 1, OBSERVED),
            centre_camera=points,
            bound_px=np.full((OBSERVED, 2), 6.0),
            bound_depth=spread,
            slack=np.where(np.arange(OBSERVED) == 9, 0.3, 0.0),
        ),
        confidence_s=confidence_s,
        confidence=np.clip(1 - 0.95 * np.exp(-(((confidence_s - 0.62) / 0.12) ** 2)), 0, 1),
        unseen=np.array([[0.56, 0.66]]),
    )


@pytest.fixture(scope="session")
def scene():
    """Images and messages of one good reconstruction, with the curve they were made from."""
    rng = np.random.default_rng(7)
    curve = helix(np.linspace(0, 1, 2000))
    left, mask_left = photograph(pixels(curve), rng)
    right, mask_right = photograph(pixels(curve, BASELINE), rng)
    lengths = np.concatenate(([0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))))
    share = lengths / lengths[-1]
    points, spread = observed(curve, share, rng)
    matched, kept = matches(curve, rng)
    return types.SimpleNamespace(
        curve=curve,
        left=left,
        right=right,
        length=lengths[-1],
        observations=observations_of(points, matched, kept, (mask_left, mask_right), rng),
        reconstruction=reconstruction_of(curve, share, points, spread),
    )


def centrelines_of(thread_px, offset_px):
    """The middle of the thread in two pieces with a hole in between, each point that far to one side of it."""
    tangent = np.gradient(thread_px, axis=0)
    normal = np.column_stack((-tangent[:, 1], tangent[:, 0])) / np.linalg.norm(tangent, axis=1, keepdims=True)
    point = (thread_px + offset_px[:, None] * normal)[::4]
    seen = np.r_[0:280, 330:500]
    piece = (np.arange(500) >= 330).astype(np.int64)
    return Centrelines(point[seen], piece[seen], np.full(len(seen), 5.0), np.full(len(seen), 0.1))


@pytest.fixture(scope="session")
def refined(scene):
    """The same scene as the method sees it that predicts how well each place is known.

    The left image's centreline lies 0.3 px beside the thread, the right one's 0.2 px, and 4 px at its end. Deviations
    are 0.1 mm in x and y, and 0.5 mm in depth, twice as much in the middle.
    """
    offset = np.full(2000, 0.2)
    offset[1800:] = 4.0
    lines = (
        centrelines_of(pixels(scene.curve), np.full(2000, 0.3)),
        centrelines_of(pixels(scene.curve, BASELINE), offset),
    )
    s = np.linspace(0, 1, 51)
    deviation = np.outer(1 + np.exp(-(((s - 0.5) / 0.1) ** 2)), [0.1, 0.1, 0.5])
    return types.SimpleNamespace(
        left=scene.left,
        right=scene.right,
        observations=dataclasses.replace(scene.observations, centrelines_left=lines[0], centrelines_right=lines[1]),
        reconstruction=dataclasses.replace(
            scene.reconstruction,
            method="refined",
            posterior_s=s,
            posterior_covariance=deviation[:, :, None] ** 2 * np.eye(3),
        ),
    )


@pytest.fixture(scope="session")
def failed(scene):
    """A reconstruction of the same frame that came to nothing, in a unit that nobody knows."""
    none = np.zeros(0)
    return dataclasses.replace(
        scene.reconstruction,
        status=Status.FAILED,
        reason="No two observations are connected — is the thread in focus?",
        camera=dataclasses.replace(scene.reconstruction.camera, metres_per_unit=None),
        knots=none,
        control_points_camera=np.zeros((0, 3)),
        regions=ReliabilityRegions(none, np.zeros((0, 3)), np.zeros((0, 2)), none, none),
        confidence_s=none,
        confidence=none,
        unseen=np.zeros((0, 2)),
    )


@pytest.fixture(scope="session")
def nothing_seen(scene):
    """Observations of a frame in which no thread was found."""
    return dataclasses.replace(
        scene.observations,
        status=Status.FAILED,
        reason="No pixel was segmented as thread.",
        points_camera=np.zeros((0, 3)),
        half_size_px=np.zeros((0, 2)),
        matched_px=np.zeros((0, 3)),
        match_cost=np.zeros((0, 2)),
        inlier=np.zeros(0, bool),
        mask_left=mask_message(np.zeros((HEIGHT, WIDTH), np.uint8)),
        mask_right=mask_message(np.zeros((HEIGHT, WIDTH), np.uint8)),
        judgements=(),
    )


def in_metres(message) -> Any:
    """The same message, as a calibration in metres would have it."""
    camera = dataclasses.replace(message.camera, baseline=message.camera.baseline * 1e-3, metres_per_unit=1.0)
    if isinstance(message, ThreadObservations):
        return dataclasses.replace(message, camera=camera, points_camera=message.points_camera * 1e-3)
    regions = message.regions
    return dataclasses.replace(
        message,
        camera=camera,
        control_points_camera=message.control_points_camera * 1e-3,
        regions=dataclasses.replace(
            regions, centre_camera=regions.centre_camera * 1e-3, bound_depth=regions.bound_depth * 1e-3
        ),
        posterior_covariance=message.posterior_covariance * 1e-6,
    )


@pytest.fixture(scope="session")
def refined_in_metres(refined):
    return in_metres(refined.reconstruction)


def pose(x, y, z):
    """A tool that looks along the optical axis, at a place in metres."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def imaged(scene, camera):
    """What is published of a camera and of its frame."""
    K = np.array([[FOCAL_PX, 0, 479.5], [0, FOCAL_PX, 269.5], [0, 0, 1]])
    T_right_left = np.eye(4)
    T_right_left[0, 3] = -camera.baseline
    return {
        topics.CALIBRATION: StereoCalibration(
            WIDTH, HEIGHT, K, K, np.zeros(0), np.zeros(0), T_right_left, camera.metres_per_unit
        ),
        topics.FRAMES: StereoFrame(
            STAMP,
            encode_image(scene.left, ImageEncoding.JPEG),
            encode_image(scene.right, ImageEncoding.PNG),
        ),
    }


def grasped(at_ns):
    """What is published of a grasp."""
    way = [(Phase.APPROACH, 0.05), (Phase.CAPTURE, 0.07), (Phase.SLIDE, 0.075), (Phase.GRASP, 0.075)]
    return {
        topics.PLAN: GraspPlan(
            plan_id="plan-1",
            arm="psm1",
            goal_id="goal-1",
            stamp=STAMP,
            status=Status.OK,
            reason="",
            policy=Policy.CAPTURE_SLIDE_GRASP,
            s_goal=0.4,
            s_capture=0.3,
            probability=0.8,
            slide_m=0.009,
            waypoints=tuple(Waypoint(pose(0, 0, z), 0.5, phase, None) for phase, z in way),
            alternatives=(Alternative(0.5, 0.2, "out of reach"),),
        ),
        topics.ROBOT_STATE: RobotState(
            arm="psm1",
            measured_ns=at_ns,
            mode=RobotMode.MOVING,
            T_base_tool=pose(0.01, 0.0, -0.12),
            joints=np.arange(6.0),
            jaw_rad=1.0,
            T_camera_base=pose(0.0, 0.02, 0.2),
            plan_id="plan-1",
        ),
        topics.EXECUTION: ExecutionEvent("plan-1", "psm1", at_ns, ExecutionKind.PHASE_REACHED, Phase.SLIDE, "", ""),
        topics.JUDGEMENT: GraspJudgement("plan-1", "psm1", at_ns, Verdict.HELD, 0.4, 0.009, 3e-4, "grasp held"),
        topics.CHECK: GraspCheck(
            plan_id="plan-1",
            arm="psm1",
            goal_id="goal-1",
            verdict=Checked.MISSED,
            before=STAMP,
            after=STAMP,
            tool_moved_m=0.005,
            thread_moved_m=0.0001,
            deviation_m=0.0003,
            held_probability=0.001,
            attempt=1,
            attempts=3,
            next_plan_id="plan-1-2",
            sentence="missed: the thread stayed",
        ),
        topics.FRAME_NOTICE: FrameNotice(dataclasses.replace(STAMP, echoes=(ChallengeEcho("psm1", at_ns),))),
        topics.HEARTBEAT: Heartbeat("psm1", "plan-1", at_ns, "arming-1"),
    }


def no_lines():
    return NeedleView(
        no_centrelines(),
        np.zeros(0),
        np.zeros((0, 3), np.uint8),
        encode_image(np.zeros((2, 2), np.uint8), ImageEncoding.PNG),
    )


def in_front(distance):
    T = np.eye(4)
    T[2, 3] = distance
    return T


@pytest.fixture(scope="session")
def session_messages(scene):
    """One message of every published topic, all of the frame that `scene` is of, with its calibration in metres."""
    observations: ThreadObservations = in_metres(scene.observations)
    reconstruction: ThreadReconstruction = in_metres(scene.reconstruction)
    camera, at_ns = observations.camera, STAMP.capture_left_ns + 5_000_000
    goal = GraspGoal(CommandHeader("goal-1", at_ns, "surgeon"), "psm1", Policy.CAPTURE_SLIDE_GRASP, 0.4, None, None)
    return imaged(scene, camera) | grasped(at_ns) | {
        topics.OBSERVATIONS: observations,
        topics.THREAD: reconstruction,
        topics.SIMULATOR_STATE: SimulatorState(
            at_ns, camera, "plain", "violet", 1, 0.1, 2e-4, reconstruction.knots,
            reconstruction.control_points_camera, None,
        ),
        topics.SURFACE: TissueSurface(
            STAMP, camera, np.arange(8.0), np.arange(4.0), np.full((4, 8), 0.1), np.ones((4, 8), bool)
        ),
        topics.TOOL: ToolCorrection(
            "psm1", STAMP, at_ns, ToolStatus.CONVERGED, "", np.eye(4), np.array((0, 0, 0.1)), np.array((0, 0, 0.11)),
            0.004, 0.02, 3e-4, 0.01, np.ones((3, 2)), np.full((4, 2), 20.0), np.full((5, 2), 10.0),
            (ToolCandidate(np.zeros(6), np.eye(6), np.zeros((16, 16, 16), np.uint8), 9, 0.9, 0.8, 0.5),), 0, 0, 5,
        ),
        topics.NEEDLE_SEEN: NeedleObservations(STAMP, camera, no_lines(), no_lines()),
        topics.NEEDLE: NeedlePose(
            STAMP, camera, Status.OK, "", in_front(0.1), 0.007, np.pi, 1e-8 * np.eye(8), np.array((True, False)),
            0.98, 2.5, 0.3,
        ),
        topics.REPLAY_CLOCK: ReplayClock(at_ns, 1.0),
        topics.COMMANDS: CommandRecord(
            "operator/goal", encoding_name(GraspGoal), encode(goal), at_ns,
            CommandAnswer("goal-1", Outcome.REFUSED, "OFF_THREAD", "the goal is not on the thread"),
        ),
        topics.HEALTH: AgentHealth(
            "perception", "main", "host", "0.0.1", "abc", at_ns, 3.0, 90, 12.0, 31.0,
            (InputHealth("camera/frames", 29.5, 10.0, 88, 7, 2, 1),),
            (OutputHealth("perception/observations", 28.0, 84),), "the segmenter is slow", 0.25, 64 << 20,
        ),
        topics.LOG: LogRecord(at_ns, "planner", "main", LogLevel.WARNING, "nothing in reach"),
        topics.CONFIGURATION: AgentConfiguration(
            "camera", "main", at_ns, '{"jpeg_quality": 80}',
            (SettableParameter("jpeg_quality", "a whole number from 1 to 100", True),), "abc",
        ),
        topics.CLOCKS: HostClocks(
            at_ns,
            (HostClock("camera", "main", "video", 3.5, 0.2), HostClock("robot_bridge", "psm1", "", None, None)),
        ),
    }  # fmt: skip


@pytest.fixture
def shown_by_rerun(tmp_path):
    """Have a viewer without a screen show a recording along a timeline: it complains of what it cannot show."""
    drivers = sorted(pathlib.Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json"))
    shot = pathlib.Path(__file__).parents[3] / "../shared/tools/rerun_shot.py"
    if not shot.exists() or not drivers:
        pytest.skip("needs shared/tools/rerun_shot.py and a software Vulkan driver (mesa-vulkan-drivers, libvulkan1)")

    def show(recording, timeline):
        picture = tmp_path / "shot.png"
        command = [sys.executable, shot, recording, picture, "--timeline", timeline, "--size", "800x450"]
        around = os.environ | {"VK_ICD_FILENAMES": str(drivers[0]), "XDG_RUNTIME_DIR": str(tmp_path)}
        seen = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120, env=around)
        assert seen.returncode == 0, seen.stdout + seen.stderr
        assert picture.stat().st_size > 10_000

    return show
