"""A thread made by hand: an arc of a helix before a camera of 960x540, with images, masks and observations."""

import collections
import types
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader
from scipy.interpolate import make_lsq_spline

from schemas import messages, topics
from schemas.codec import encode, encoding_name
from schemas.messages import ImageEncoding, Phase, Severity, Status, ThreadObservations, ThreadReconstruction
from shared.images import encode_image

WIDTH, HEIGHT, FOCAL_PX, BASELINE = 960, 540, 1000.0, 5.5
CONTROL_POINTS, DEGREE, OBSERVED = 20, 3, 36
CAMERA = messages.RectifiedStereo(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, 479.5, 269.5, BASELINE, 1e-3)
STAMP = messages.FrameStamp(42, 1_760_000_000_000_000_000, 1_760_000_000_000_400_000, "bench")
NONE = np.zeros(0)


def helix(t):
    """A curve from 80 to 110 mm before the camera, as a closed form in t from 0 to 1."""
    angle = 1.6 * np.pi * t
    return np.column_stack((-30 + 60 * t, 12 * np.sin(angle), 95 - 15 * np.cos(angle)))


def pixels(points, eye=0.0):
    """Pinhole projection, written out again so that it can serve as an oracle."""
    x, y, z = points.T
    return np.column_stack((FOCAL_PX * (x - eye) / z + 479.5, FOCAL_PX * y / z + 269.5))


def photograph(thread_px):
    """Tissue with a dark thread on it, and the thread's true mask."""
    image, mask = np.full((HEIGHT, WIDTH, 3), (95, 95, 170), np.uint8), np.zeros((HEIGHT, WIDTH), np.uint8)
    at = np.rint(thread_px * 16).astype(np.int32)
    cv2.polylines(mask, [at], False, 255, 5, cv2.LINE_AA, 4)
    cv2.polylines(image, [at], False, (70, 40, 30), 5, cv2.LINE_AA, 4)
    return image, encode_image(mask, ImageEncoding.PNG)


def centrelines_of(thread_px, offset_px):
    """The middle of the thread in two pieces with a hole in between, each point that far to one side of it."""
    tangent = np.gradient(thread_px, axis=0)
    normal = np.column_stack((-tangent[:, 1], tangent[:, 0])) / np.linalg.norm(tangent, axis=1, keepdims=True)
    point = (thread_px + offset_px[:, None] * normal)[::4]
    seen = np.r_[0:280, 330:500]
    piece = (np.arange(500) >= 330).astype(np.int64)
    return messages.Centrelines(point[seen], piece[seen], np.full(len(seen), 5.0), np.full(len(seen), 0.1))


def observations_of(curve, masks):
    """Points on the curve, pixels with disparities, a fifth of which are wrong, and centrelines.

    The left image's centreline lies 0.3 px beside the thread, the right one's 0.2 px, and 4 px at its end.
    """
    matched = curve[::3]
    kept = np.arange(len(matched)) % 5 > 0
    disparity = np.where(kept, FOCAL_PX * BASELINE / matched[:, 2], 40.0)
    return ThreadObservations(
        stamp=STAMP,
        camera=CAMERA,
        status=Status.OK,
        reason="",
        segmenter="truth",
        points_camera=curve[:: len(curve) // OBSERVED][:OBSERVED],
        half_size_px=np.full((OBSERVED, 2), 5.0),
        matched_px=np.column_stack((pixels(matched), disparity)),
        match_cost=np.ones((len(matched), 2)),
        inlier=kept,
        mask_left=masks[0],
        mask_right=masks[1],
        judgements=(
            messages.Judgement("ROWS_OFFSET", Severity.WARNING, "Rows differ by 0.8 px (±0.1).", "Calibrate again."),
            messages.Judgement("SMALL", Severity.NOTE, "The thread is 5 px wide.", ""),
            messages.Judgement("SWAPPED", Severity.FAULT, "Left and right seem swapped.", "Exchange the two images."),
        ),
        centrelines_left=centrelines_of(pixels(curve), np.full(2000, 0.3)),
        centrelines_right=centrelines_of(pixels(curve, BASELINE), np.where(np.arange(2000) < 1800, 0.2, 4.0)),
    )


def reconstruction_of(curve, share, points):
    """The curve with what a method says of it: in its middle it is known half as well as 0.1 mm, 0.5 mm in depth."""
    inner = np.linspace(0, 1, CONTROL_POINTS - DEGREE + 1)
    knots = np.concatenate((np.zeros(DEGREE), inner, np.ones(DEGREE)))
    confidence_s, posterior_s = np.linspace(0, 1, 80), np.linspace(0, 1, 51)
    deviation = np.outer(1 + np.exp(-(((posterior_s - 0.5) / 0.1) ** 2)), [0.1, 0.1, 0.5])
    return ThreadReconstruction(
        stamp=STAMP,
        camera=CAMERA,
        status=Status.OK,
        reason="",
        method="refined",
        degree=DEGREE,
        knots=knots,
        control_points_camera=make_lsq_spline(share, curve, knots, DEGREE).c,
        regions=messages.ReliabilityRegions(
            s=np.linspace(0, 1, OBSERVED),
            centre_camera=points,
            bound_px=np.full((OBSERVED, 2), 6.0),
            bound_depth=np.linspace(0.4, 2.0, OBSERVED),
            slack=np.where(np.arange(OBSERVED) == 9, 0.3, 0.0),
        ),
        confidence_s=confidence_s,
        confidence=confidence_at(confidence_s),
        unseen=np.array([[0.56, 0.66]]),
        posterior_s=posterior_s,
        posterior_covariance=deviation[:, :, None] ** 2 * np.eye(3),
    )


def confidence_at(s):
    """How sure the scene's thread is along its length."""
    return np.clip(1 - 0.95 * np.exp(-(((s - 0.62) / 0.12) ** 2)), 0, 1)


@pytest.fixture(scope="session")
def scene():
    """Images and messages of one good reconstruction, with the curve they were made from and its shares of length."""
    curve = helix(np.linspace(0, 1, 2000))
    left, mask_left = photograph(pixels(curve))
    right, mask_right = photograph(pixels(curve, BASELINE))
    lengths = np.concatenate(([0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))))
    share = lengths / lengths[-1]
    observations = observations_of(curve, (mask_left, mask_right))
    return types.SimpleNamespace(
        curve=curve,
        share=share,
        left=left,
        right=right,
        length=lengths[-1],
        observations=observations,
        reconstruction=reconstruction_of(curve, share, observations.points_camera),
    )


def said_nothing(reconstruction):
    """The same without what a method says of how well it knows each place."""
    return replace(reconstruction, posterior_s=NONE, posterior_covariance=np.zeros((0, 3, 3)))


@pytest.fixture(scope="session")
def failed(scene):
    """A reconstruction of the same frame that came to nothing, in a unit that nobody knows."""
    return replace(
        said_nothing(scene.reconstruction),
        status=Status.FAILED,
        reason="No two observations are connected — is the thread in focus?",
        camera=replace(CAMERA, metres_per_unit=None),
        knots=NONE,
        control_points_camera=np.zeros((0, 3)),
        regions=messages.ReliabilityRegions(NONE, np.zeros((0, 3)), np.zeros((0, 2)), NONE, NONE),
        confidence_s=NONE,
        confidence=NONE,
        unseen=np.zeros((0, 2)),
    )


@pytest.fixture(scope="session")
def nothing_seen(scene):
    """Observations of a frame in which nothing but the middle of a thread was found."""
    return replace(
        scene.observations,
        status=Status.FAILED,
        reason="No pixel was segmented as thread.",
        points_camera=np.zeros((0, 3)),
        half_size_px=np.zeros((0, 2)),
        matched_px=np.zeros((0, 3)),
        match_cost=np.zeros((0, 2)),
        inlier=np.zeros(0, bool),
    )


def in_metres(message) -> Any:
    """The same message, as a calibration in metres would have it."""
    camera = replace(message.camera, baseline=message.camera.baseline * 1e-3, metres_per_unit=1.0)
    if isinstance(message, ThreadObservations):
        return replace(message, camera=camera, points_camera=message.points_camera * 1e-3)
    regions = message.regions
    return replace(
        message,
        camera=camera,
        control_points_camera=message.control_points_camera * 1e-3,
        regions=replace(regions, centre_camera=regions.centre_camera * 1e-3, bound_depth=regions.bound_depth * 1e-3),
        posterior_covariance=message.posterior_covariance * 1e-6,
    )


def pose(x, y, z):
    """A tool that looks along the optical axis, at a place in metres."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def imaged(scene, camera):
    """What is published of a camera and of its frame."""
    K = np.array([[FOCAL_PX, 0, 479.5], [0, FOCAL_PX, 269.5], [0, 0, 1]])
    images = encode_image(scene.left, ImageEncoding.JPEG), encode_image(scene.right, ImageEncoding.PNG)
    T_right_left = pose(-camera.baseline, 0, 0)
    return {
        topics.CALIBRATION: messages.StereoCalibration(
            WIDTH, HEIGHT, K, K, NONE, NONE, T_right_left, camera.metres_per_unit
        ),
        topics.FRAMES: messages.StereoFrame(STAMP, *images),
    }


def grasped(at_ns):
    """What is published of a grasp."""
    way = [(Phase.APPROACH, 0.05), (Phase.CAPTURE, 0.07), (Phase.SLIDE, 0.075), (Phase.GRASP, 0.075)]
    return {
        topics.PLAN: messages.GraspPlan(
            plan_id="plan-1",
            arm="psm1",
            goal_id="goal-1",
            stamp=STAMP,
            status=Status.OK,
            reason="",
            policy=messages.Policy.CAPTURE_SLIDE_GRASP,
            s_goal=0.4,
            s_capture=0.3,
            probability=0.8,
            slide_m=0.009,
            waypoints=tuple(messages.Waypoint(pose(0, 0, z), 0.5, phase, None) for phase, z in way),
            alternatives=(messages.Alternative(0.5, 0.2, "out of reach"),),
        ),
        topics.ROBOT_STATE: messages.RobotState(
            arm="psm1",
            measured_ns=at_ns,
            mode=messages.RobotMode.MOVING,
            T_base_tool=pose(0.01, 0.0, -0.12),
            joints=np.arange(6.0),
            jaw_rad=1.0,
            T_camera_base=pose(0.0, 0.02, 0.2),
            plan_id="plan-1",
        ),
        topics.EXECUTION: messages.ExecutionEvent(
            "plan-1", "psm1", at_ns, messages.ExecutionKind.PHASE_REACHED, Phase.SLIDE, "", ""
        ),
        topics.JUDGEMENT: messages.GraspJudgement(
            "plan-1", "psm1", at_ns, messages.Verdict.HELD, 0.4, 0.009, 3e-4, "grasp held"
        ),
        topics.CHECK: messages.GraspCheck(
            plan_id="plan-1",
            arm="psm1",
            goal_id="goal-1",
            verdict=messages.Checked.MISSED,
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
        topics.TAIL: messages.Tail(
            plan_id="pull-1",
            arm="psm1",
            stamp=STAMP,
            status=messages.Status.OK,
            reason="",
            segment=2,
            tail_m=0.02,
            tail=messages.TailLength(0.025, 0.0005, at_least=False),
            free_end=messages.StrandEnd(np.array([0.0, 0.0, 0.08]), 1e-8 * np.eye(3), messages.EndSight.SEEN, 0.0),
            exit=messages.StrandEnd(np.array([0.02, 0.0, 0.08]), 1e-6 * np.eye(3), messages.EndSight.SEEN, 0.5),
            entry=None,
            ran_m=0.005,
            travelled_m=0.0052,
            phase=Phase.PULL,
            stop=messages.PullStop.TENSION,
            sentence="it is held in the tissue",
        ),
        topics.FRAME_NOTICE: messages.FrameNotice(replace(STAMP, echoes=(messages.ChallengeEcho("psm1", at_ns),))),
        topics.HEARTBEAT: messages.Heartbeat("psm1", "plan-1", at_ns, "arming-1"),
    }


@pytest.fixture(scope="session")
def session_messages(scene):
    """One message of every published topic, all of the frame that `scene` is of, with its calibration in metres."""
    observations, thread = in_metres(scene.observations), in_metres(scene.reconstruction)
    camera, at_ns = observations.camera, STAMP.capture_left_ns + 5_000_000
    header = messages.CommandHeader("goal-1", at_ns, "surgeon")
    goal = messages.GraspGoal(header, "psm1", messages.Policy.CAPTURE_SLIDE_GRASP, 0.4, None, None)
    black = encode_image(np.zeros((2, 2), np.uint8), ImageEncoding.PNG)
    view = messages.NeedleView(messages.no_centrelines(), NONE, np.zeros((0, 3), np.uint8), black)
    return imaged(scene, camera) | grasped(at_ns) | {
        topics.OBSERVATIONS: observations,
        topics.THREAD: thread,
        topics.SIMULATOR_STATE: messages.SimulatorState(
            at_ns, camera, "plain", "violet", 1, 0.1, 2e-4, thread.knots, thread.control_points_camera, None
        ),
        topics.SURFACE: messages.TissueSurface(
            STAMP, camera, np.arange(8.0), np.arange(4.0), np.full((4, 8), 0.1), np.ones((4, 8), bool)
        ),
        topics.TOOL: messages.ToolCorrection(
            "psm1", STAMP, at_ns, messages.ToolStatus.CONVERGED, "", np.eye(4), np.array((0, 0, 0.1)),
            np.array((0, 0, 0.11)), 0.004, 0.02, 3e-4, 0.01, np.ones((3, 2)), np.full((4, 2), 20.0),
            np.full((5, 2), 10.0), (messages.ToolCandidate(
                np.zeros(6), np.eye(6), np.zeros((16, 16, 16), np.uint8), 9, 0.9, 0.8, 0.5
            ),), 0, 0, 5,
        ),
        topics.NEEDLE_SEEN: messages.NeedleObservations(STAMP, camera, view, view),
        topics.NEEDLE: messages.NeedlePose(
            STAMP, camera, Status.OK, "", pose(0, 0, 0.1), 0.007, np.pi, 1e-8 * np.eye(8), np.array((True, False)),
            0.98, 2.5, 0.3,
        ),
        topics.REPLAY_CLOCK: messages.ReplayClock(at_ns, 1.0),
        topics.COMMANDS: messages.CommandRecord(
            "operator/goal", encoding_name(messages.GraspGoal), encode(goal), at_ns,
            messages.CommandAnswer("goal-1", messages.Outcome.REFUSED, "OFF_THREAD", "the goal is not on the thread"),
        ),
        topics.HEALTH: messages.AgentHealth(
            "perception", "main", "host", "0.0.1", "abc", at_ns, 3.0, 90, 12.0, 31.0,
            (messages.InputHealth("camera/frames", 29.5, 10.0, 88, 7, 2, 1),),
            (messages.OutputHealth("perception/observations", 28.0, 84),), "the segmenter is slow", 0.25, 64 << 20,
        ),
        topics.LOG: messages.LogRecord(at_ns, "planner", "main", messages.LogLevel.WARNING, "nothing in reach"),
        topics.CONFIGURATION: messages.AgentConfiguration(
            "camera", "main", at_ns, '{"jpeg_quality": 80}',
            (messages.SettableParameter("jpeg_quality", "a whole number from 1 to 100", True),), "abc",
        ),
        topics.CLOCKS: messages.HostClocks(
            at_ns,
            (
                messages.HostClock("camera", "main", "video", 3.5, 0.2),
                messages.HostClock("robot_bridge", "psm1", "", None, None),
            ),
        ),
    }  # fmt: skip


def rows_of(path):
    """What a file of Rerun holds: entity to rows of columns, in the order in which they were logged."""
    found = collections.defaultdict(list)
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        columns = {}
        for field in batch.schema:
            column = batch.column(field.name)
            timed = str(field.type).startswith("timestamp")
            columns[field.name] = column.cast("int64").to_pylist() if timed else column.to_pylist()
        found[str(chunk.entity_path)] += [
            {name: column[row] for name, column in columns.items()} for row in range(batch.num_rows)
        ]
    # a file holds rows in batches; their ids count the order
    return {entity: sorted(rows, key=lambda row: row["rerun.controls.RowId"]) for entity, rows in found.items()}


def values(rows, entity, component):
    """A component's values, row by row."""
    return [row[component] for row in rows[entity] if row.get(component) is not None]


def words(rows):
    """All that was said."""
    logged = [row for entity, rows in rows.items() if entity.startswith("/log/") for row in rows]
    return " | ".join(row["TextLog:text"][0] for row in logged)


def held(archetype, component) -> Any:
    """What an archetype holds, as a list."""
    return getattr(archetype, component).as_arrow_array().to_pylist()
