"""The camera agent, from ticks to frames."""

import dataclasses

import numpy as np
import pytest

from agents.camera.agent import LAST, MOST_ALIKE, Camera, CameraConfig
from agents.camera.scene_source import calibration_of
from agents.camera.sources import BrokenOffError, SourceError
from schemas.messages import FrameNotice, ImageEncoding, RectifiedStereo, RobotMode, RobotState
from schemas.topics import CALIBRATION, FRAME_NOTICE, FRAMES, ROBOT_STATE
from shared.calibration.identity import calibration_id
from shared.images import decode_image
from shared.runtime.agent import CannotGoOnError, Received, Tick

CALIBRATION_64 = calibration_of(RectifiedStereo(64, 48, 80.0, 80.0, 31.5, 23.5, 5.5e-3, 1.0))
NOISE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
LATE = CameraConfig(latency_ms=40.0)


class Given:
    """A source that gives what it is told to: a number, nothing, or an error."""

    taken_ns: tuple[int, int] = 0, 0

    def __init__(self, *given):
        self.given, self.closed = list(given), False

    def read(self):
        one = self.given.pop(0) if self.given else None
        if isinstance(one, Exception):
            raise one
        if one is None:
            return None
        left, right = one if isinstance(one, tuple) else (one, one + 1)
        return NOISE + np.uint8(left), NOISE + np.uint8(right)

    def close(self):
        self.closed = True


def camera_of(*given, config=LATE):
    return Camera(Given(*given), CALIBRATION_64, config)


def stepped(camera, now_ns):
    """What a tick gives, by topic."""
    return {output.topic: output.message for output in camera.step(Tick(now_ns))}


def test_the_calibration_comes_first_and_once_then_frames_numbered_and_stamped_as_they_were_taken():
    source = Given(None, 1, 2)
    camera = Camera(source, CALIBRATION_64, LATE)
    source.taken_ns = 5_000_000, -7_000_000
    said = [stepped(camera, 10**9 * second) for second in (1, 2, 3, 4)]
    assert [set(each) for each in said] == [{CALIBRATION}, {FRAMES, FRAME_NOTICE}, {FRAMES, FRAME_NOTICE}, set()]
    stamps = [each[FRAMES].stamp for each in said[1:3]]
    assert [stamp.sequence for stamp in stamps] == [0, 1]
    assert [stamp.capture_left_ns for stamp in stamps] == [1_965_000_000, 2_965_000_000]
    assert [stamp.capture_right_ns for stamp in stamps] == [1_953_000_000, 2_953_000_000]
    assert {stamp.calibration_id for stamp in stamps} == {calibration_id(CALIBRATION_64)}
    assert [each[FRAME_NOTICE] for each in said[1:3]] == [FrameNotice(stamp) for stamp in stamps]


def test_images_arrive_as_they_were_or_as_jpeg_that_is_smaller_the_lower_its_quality():
    for encoding in (ImageEncoding.RAW, ImageEncoding.PNG):
        frame = stepped(camera_of(3, config=CameraConfig(encoding=encoding)), 1)[FRAMES]
        assert (decode_image(frame.left) == NOISE + np.uint8(3)).all()
        assert (decode_image(frame.right) == NOISE + np.uint8(4)).all()
    camera = camera_of(3, 3, config=CameraConfig(jpeg_quality=95))
    good = stepped(camera, 1)[FRAMES].left
    # set while it runs
    camera.configure(CameraConfig(jpeg_quality=30))
    assert len(stepped(camera, 2)[FRAMES].left.data) < 0.6 * len(good.data)


def test_a_source_that_fails_loses_that_frame_alone_and_one_that_has_broken_off_ends_the_camera():
    source = Given(1, SourceError("film torn"), 2, BrokenOffError("cable pulled"))
    camera = Camera(source, CALIBRATION_64, LATE)
    stepped(camera, 1)
    with pytest.raises(SourceError, match="film torn"):
        stepped(camera, 2)
    assert stepped(camera, 3)[FRAMES].stamp.sequence == 1
    with pytest.raises(CannotGoOnError, match=r"^cable pulled$"):
        stepped(camera, 4)
    camera.close()
    assert source.closed


def challenge(arm, challenge_ns):
    """A state of an arm with this challenge."""
    pose, joints = np.eye(4), np.zeros(6)
    state = RobotState(arm, 1, RobotMode.IDLE, pose, joints, 0.0, pose, "", challenge_ns=challenge_ns)
    return Received(ROBOT_STATE, f"suturegrasp/lab/robot_bridge/{arm}/state", 0, state)


@pytest.mark.parametrize("frozen", [(True, True), (True, False), (False, True)])
def test_a_picture_that_comes_again_and_again_to_an_eye_echoes_no_challenge_until_another_one_does(frozen):
    eyes = [[7] * (MOST_ALIKE + 1) if still else range(20, 21 + MOST_ALIKE) for still in frozen]
    camera, echoed = camera_of(*zip(*eyes, strict=True), (8, 9), config=CameraConfig()), list[bool]()
    for number in range(1, MOST_ALIKE + 3):
        list(camera.step(challenge("psm1", number)))
        echoed.append(bool(stepped(camera, number * 10**9)[FRAMES].stamp.echoes))
    assert echoed == [*[True] * (MOST_ALIKE - 1), False, False, True]


@pytest.mark.parametrize("buffers", [1, 2, LAST])
def test_a_grabber_that_goes_round_its_last_buffers_echoes_no_challenge_and_one_that_repeats_each_does(buffers):
    def echoed(*shown):
        camera, echoes = camera_of(*shown, config=CameraConfig()), list[bool]()
        for number in range(1, len(shown) + 1):
            list(camera.step(challenge("psm1", number)))
            echoes.append(bool(stepped(camera, number * 10**9)[FRAMES].stamp.echoes))
        return echoes

    first = buffers + MOST_ALIKE - 1
    assert echoed(*list(range(buffers)) * 2 * MOST_ALIKE)[: first + 2] == [*[True] * (first - 1), *[False] * 3]
    assert all(echoed(*(number // 3 for number in range(30))))


def test_a_frame_echoes_the_newest_challenge_that_was_heard_before_it_was_captured():
    camera = camera_of(1, 2, 3)
    tick_ns, echoes = 30_000_000, []
    for number in range(1, 4):
        for arm in ("psm2", "psm1"):
            list(camera.step(challenge(arm, 1000 * number)))
        frame = stepped(camera, 10**9 + number * tick_ns)[FRAMES]
        echoes.append([(echo.arm, echo.challenge_ns) for echo in frame.stamp.echoes])
    # it was captured 40 ms before it came: one tick and a third before
    assert echoes == [[], [], [("psm1", 1000), ("psm2", 1000)]]


def test_the_name_of_a_calibration_changes_with_any_of_its_numbers():
    K, T = CALIBRATION_64.K_left.copy(), CALIBRATION_64.T_right_left + 1e-12 * np.eye(4, k=3)
    K[0, 2] = np.nextafter(K[0, 2], np.inf)
    others = ({}, {"K_left": K}, {"T_right_left": T}, {"metres_per_unit": 1.0 + 1e-15}, {"image_width": 65})
    names = [calibration_id(dataclasses.replace(CALIBRATION_64, **other)) for other in others]
    assert len(set(names)) == len(others)
    assert names[0] == calibration_id(CALIBRATION_64)
