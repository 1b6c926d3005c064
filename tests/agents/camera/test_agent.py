"""The camera agent, from ticks to frames."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.camera.agent import Camera, CameraConfig, SceneCamera
from agents.camera.scene_source import calibration_of
from agents.camera.sources import BrokenOffError, SourceError
from schemas.messages import (
    FrameNotice,
    ImageEncoding,
    RectifiedStereo,
    RobotMode,
    RobotState,
    SimulatorState,
    StereoCalibration,
)
from schemas.topics import CALIBRATION, FRAME_NOTICE, FRAMES, ROBOT_STATE, SIMULATOR_STATE
from shared.calibration.identity import calibration_id
from shared.images import decode_image
from shared.runtime.agent import CannotGoOnError, Received, Tick

CAMERA = RectifiedStereo(64, 48, 80.0, 80.0, 31.5, 23.5, 5.5e-3, 1.0)
CALIBRATION_64 = calibration_of(CAMERA)
NOISE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)


class Given:
    """A source that gives what it is told to: a number, nothing, or an error."""

    taken_ns: tuple[int, int] = 0, 0

    def __init__(self, *given):
        self.given, self.closed = list(given), False

    def read(self):
        one = self.given.pop(0) if self.given else None
        if isinstance(one, Exception):
            raise one
        return None if one is None else (NOISE + np.uint8(one), NOISE + np.uint8(one + 1))

    def close(self):
        self.closed = True


def steps(camera, *times_ns):
    """What each tick gives, but for the notices beside the frames."""
    said = ([(o.topic, o.message) for o in camera.step(Tick(t))] for t in times_ns)
    return [[one for one in each if one[0] is not FRAME_NOTICE] for each in said]


def challenge(arm, challenge_ns):
    """A state of an arm with this challenge."""
    pose, joints = np.eye(4), np.zeros(6)
    state = RobotState(arm, 1, RobotMode.IDLE, pose, joints, 0.0, pose, "", challenge_ns=challenge_ns)
    return Received(ROBOT_STATE, f"suturegrasp/lab/robot_bridge/{arm}/state", 0, state)


def test_the_calibration_comes_first_and_once_even_before_the_source_has_a_frame():
    camera = Camera(Given(None, 1, 2), CALIBRATION_64, CameraConfig())
    published = [[topic for topic, _ in outputs] for outputs in steps(camera, 1, 2, 3, 4)]
    assert published == [[CALIBRATION], [FRAMES], [FRAMES], []]


def test_frames_are_numbered_stamped_less_the_latency_and_name_their_calibration():
    camera = Camera(Given(1, None, 2), CALIBRATION_64, CameraConfig(latency_ms=40.0))
    stamps = [m.stamp for outputs in steps(camera, 10**9, 2 * 10**9, 3 * 10**9) for t, m in outputs if t is FRAMES]
    assert [stamp.sequence for stamp in stamps] == [0, 1]
    assert [stamp.capture_left_ns for stamp in stamps] == [960_000_000, 2_960_000_000]
    assert all(stamp.capture_right_ns == stamp.capture_left_ns for stamp in stamps)
    assert {stamp.calibration_id for stamp in stamps} == {calibration_id(CALIBRATION_64)}


def test_images_arrive_as_they_were_or_as_jpeg_that_is_smaller_the_lower_its_quality():
    def both_sent(encoding, quality=95):
        camera = Camera(Given(3), CALIBRATION_64, CameraConfig(encoding=encoding, jpeg_quality=quality))
        (_, (_, frame)), *_ = steps(camera, 1)
        return frame.left, frame.right

    for encoding in (ImageEncoding.RAW, ImageEncoding.PNG):
        left, right = both_sent(encoding)
        assert (decode_image(left) == NOISE + np.uint8(3)).all()
        assert (decode_image(right) == NOISE + np.uint8(4)).all()
    good, poor = (both_sent(ImageEncoding.JPEG, quality)[0] for quality in (95, 30))
    assert len(poor.data) < 0.6 * len(good.data)


def test_a_source_that_fails_loses_that_frame_alone_and_one_that_has_broken_off_ends_the_camera():
    source = Given(1, SourceError("film torn"), 2, BrokenOffError("cable pulled"))
    camera = Camera(source, CALIBRATION_64, CameraConfig())
    steps(camera, 1)
    with pytest.raises(SourceError, match="film torn"):
        steps(camera, 2)
    ((_, frame),) = steps(camera, 3)[0]
    assert frame.stamp.sequence == 1
    with pytest.raises(CannotGoOnError, match=r"^cable pulled$"):
        steps(camera, 4)
    camera.close()
    assert source.closed


def test_each_image_is_stamped_with_when_the_source_says_that_it_was_taken():
    source = Given(1)
    source.taken_ns = 5_000_000, -7_000_000
    ((_, _), (_, frame)), *_ = steps(Camera(source, CALIBRATION_64, CameraConfig(latency_ms=40.0)), 10**9)
    assert (frame.stamp.capture_left_ns, frame.stamp.capture_right_ns) == (965_000_000, 953_000_000)


def test_a_frame_echoes_the_newest_challenge_that_was_heard_before_it_was_captured():
    camera = Camera(Given(1, 2, 3), CALIBRATION_64, CameraConfig(latency_ms=40.0))
    tick_ns, echoes = 30_000_000, []
    for number in range(1, 4):
        for arm in ("psm2", "psm1"):
            list(camera.step(challenge(arm, 1000 * number)))
        frame = next(m for t, m in steps(camera, 10**9 + number * tick_ns)[0] if t is FRAMES)
        echoes.append([(echo.arm, echo.challenge_ns) for echo in frame.stamp.echoes])
    # it was captured 40 ms before it came: one tick and a third before
    assert echoes == [[], [], [("psm1", 1000), ("psm2", 1000)]]


def test_a_notice_with_the_same_stamp_follows_each_frame():
    camera: Any = Camera(Given(1), CALIBRATION_64, CameraConfig())
    said = {output.topic: output.message for output in camera.step(Tick(1))}
    assert said[FRAME_NOTICE] == FrameNotice(said[FRAMES].stamp)


def test_the_name_of_a_calibration_changes_with_any_of_its_numbers():
    K = CALIBRATION_64.K_left.copy()
    K[0, 2] = np.nextafter(K[0, 2], np.inf)
    others = (
        {"K_left": K},
        {"T_right_left": CALIBRATION_64.T_right_left + 1e-12 * np.eye(4, k=3)},
        {"metres_per_unit": np.nextafter(1.0, 2.0).item()},
        {"image_width": 65},
    )
    names = {calibration_id(dataclasses.replace(CALIBRATION_64, **other)) for other in ({}, *others)}
    assert len(names) == 1 + len(others)
    assert calibration_id(dataclasses.replace(CALIBRATION_64)) == calibration_id(CALIBRATION_64)


STATE = SimulatorState(
    at_ns=1,
    camera=CAMERA,
    background="plain",
    colour="violet",
    seed=2,
    distance_m=0.095,
    radius_m=1e-4,
    knots=np.repeat([0.0, 1.0], 4),
    control_points_camera=np.tile([0.0, 0.0, 0.09], (4, 1)),
    held=None,
)


def fed(camera, state):
    return list(camera.step(Received(SIMULATOR_STATE, "suturegrasp/lab/simulator/main/state", 0, state)))


def scene_camera(rendered):
    def render(state, number):
        rendered.append((state.at_ns, number))
        return NOISE, NOISE

    return SceneCamera(render, lambda state: calibration_of(state.camera), CameraConfig())


def test_the_scene_is_filmed_from_the_newest_state_once_there_is_one():
    rendered = []
    camera = scene_camera(rendered)
    assert steps(camera, 1) == [[]]
    for at_ns in (5, 6):
        assert fed(camera, dataclasses.replace(STATE, at_ns=at_ns)) == []
    published = [[topic for topic, _ in outputs] for outputs in steps(camera, 2, 3)]
    assert published == [[CALIBRATION, FRAMES], [FRAMES]]
    assert rendered == [(6, 0), (6, 1)]


def test_a_field_with_another_camera_is_calibrated_anew():
    camera = scene_camera([])
    fed(camera, STATE)
    (((_, first), (_, frame)),) = steps(camera, 1)
    fed(camera, dataclasses.replace(STATE, camera=dataclasses.replace(CAMERA, fx_px=90.0, fy_px=90.0)))
    (((_, second), (_, later)),) = steps(camera, 2)
    assert isinstance(second, StereoCalibration)
    assert second.K_left[0, 0] == 90.0
    assert [m.stamp.calibration_id for m in (frame, later)] == [calibration_id(first), calibration_id(second)]
    assert later.stamp.sequence == 1
