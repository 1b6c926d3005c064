"""The perception agent on frames and calibrations that do not go together, and on damaged ones."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.perception.agent import Perception, PerceptionConfig
from schemas.codec import decode, encode
from schemas.messages import (
    FrameStamp,
    Image,
    ImageEncoding,
    Severity,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadObservations,
)
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, SURFACE, key
from shared.calibration.identity import calibration_id
from shared.images import encode_image
from shared.runtime.agent import Received, Tick, outputs_in

WIDTH, HEIGHT = 320, 240
DISPARITY = 24


def calibration(**changes):
    K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
    T = np.eye(4)
    T[0, 3] = -0.005
    whole = StereoCalibration(WIDTH, HEIGHT, K, K.copy(), np.zeros(0), np.zeros(0), T, 1.0)
    return dataclasses.replace(whole, **changes)


def picture(shift=0, grey=False):
    """A dark thread, two pixels thick, across a bright ground."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    line = 120 + 60 * np.sin((v - 20) / 60)
    dark = (np.abs(u + shift - line) < 1.5) & (v > 30) & (v < 210)
    image = np.where(dark, 40, 210).astype(np.uint8)
    return image if grey else np.stack([image] * 3, axis=2)


def frame(encoding=ImageEncoding.PNG, grey=False, calibration_id="", sequence=7):
    left, right = (encode_image(picture(shift, grey), encoding) for shift in (0, DISPARITY))
    return StereoFrame(FrameStamp(sequence, 100, 200, calibration_id), left, right)


def fed(agent, *messages):
    """What follows from messages, each over the wire."""
    found = []
    for number, message in enumerate(messages):
        topic = CALIBRATION if isinstance(message, StereoCalibration) else FRAMES
        arrived = decode(topic.message, encode(message))
        outputs = list(agent.step(Received(topic, key("lab", topic), number, arrived)))
        assert {output.topic for output in outputs} <= {OBSERVATIONS, SURFACE}
        # each must be fit to travel
        found += [
            decode(ThreadObservations, encode(output.message)) for output in outputs if output.topic is OBSERVATIONS
        ]
    return found


def unusable(observations, reason):
    assert observations.status is Status.FAILED
    assert reason in observations.reason
    assert "\n" not in observations.reason
    assert len(observations.points_camera) == 0
    (judgement,) = observations.judgements
    assert (judgement.code, judgement.severity, judgement.finding) == (
        "unusable_input",
        Severity.FAULT,
        observations.reason,
    )
    return True


MATCHING = PerceptionConfig(matching=True)


@pytest.mark.parametrize(
    ("encoding", "grey"), [*((encoding, False) for encoding in ImageEncoding), (ImageEncoding.JPEG, True)]
)
def test_a_thread_is_observed_at_its_depth_and_the_frames_stamp_is_kept(encoding, grey):
    (found,) = fed(Perception(MATCHING), calibration(), frame(encoding, grey))
    assert (found.status, found.reason, found.segmenter) == (Status.OK, "", "threshold")
    assert found.stamp == frame().stamp
    assert np.median(found.points_camera[:, 2]) == pytest.approx(300 * 0.005 / DISPARITY, rel=0.02)
    assert (found.mask_left.width, found.mask_left.height) == (WIDTH, HEIGHT)


def test_without_matching_there_are_centrelines_alone_and_the_segmenter_is_as_configured():
    (found,) = fed(Perception(PerceptionConfig("network")), calibration(), frame())
    assert (found.status, found.segmenter) == (Status.OK, "network")
    assert len(found.points_camera) == len(found.matched_px) == 0
    assert len(found.centrelines_left.point_px) > 50
    assert len(found.centrelines_right.point_px) > 50


def test_without_a_calibration_nothing_is_said_and_with_it_the_next_frame_is_seen():
    agent = Perception()
    assert list(agent.step(Tick(1))) == []
    assert fed(agent, frame(), frame()) == []
    assert [o.status for o in fed(agent, calibration(), frame())] == [Status.OK]


def at(sequence, left_ms, right_ms):
    """A frame of which the eyes were captured then."""
    stamp = FrameStamp(sequence, round(left_ms * 1e6), round(right_ms * 1e6), "")
    return dataclasses.replace(frame(), stamp=stamp)


@pytest.mark.parametrize(
    ("before_ms", "sequences", "apart_ms", "most_ms"),
    [
        (100, 1, 60, None),  # 10 Hz
        (100, 1, 101, 100),
        (100, 4, 30, 25),  # 40 Hz, of which every fourth was taken
        (100, -3, -60, 40),  # another run of the camera
        (100, 0, 39, None),
        (3000, 1, 60, 40),  # a pause
    ],
)
def test_how_far_apart_the_eyes_may_be_is_the_period_since_the_frame_before(before_ms, sequences, apart_ms, most_ms):
    first, second = at(7, 5000, 5000), at(7 + sequences, 5000 + before_ms, 5000 + before_ms + apart_ms)
    _, found = fed(Perception(), calibration(), first, second)
    if most_ms is None:
        assert found.status is Status.OK
    else:
        assert unusable(
            found,
            f"the eyes were captured {abs(apart_ms)} ms apart, and at most a frame period of {most_ms} ms is accepted",
        )


def shifted(sequence, right=0):
    """A frame whose thread has moved to the right."""
    left, other = (encode_image(np.roll(picture(shift), right, axis=1), ImageEncoding.PNG) for shift in (0, DISPARITY))
    return StereoFrame(FrameStamp(sequence, 100, 200, ""), left, other)


@pytest.mark.slow
def test_what_is_said_of_frames_follows_from_the_frames_alone():
    frames = [calibration(), shifted(0), shifted(1, right=4), frame(), shifted(60, right=9)]
    first, again = (fed(Perception(), *frames) for _ in range(2))
    assert [encode(o) for o in first] == [encode(o) for o in again]
    assert {o.status for o in first} == {Status.OK}


def test_the_second_frame_brings_a_surface_and_the_observations_say_which_frame_had_one():
    agent = Perception(PerceptionConfig("threshold"))
    list(agent.step(Received(CALIBRATION, key("lab", CALIBRATION), 0, calibration())))
    frames = [Received(FRAMES, key("lab", FRAMES), k, frame(sequence=k)) for k in (3, 5, 6, 20, 21, 0)]
    outputs = [outputs_in(agent.step(arrived)) for arrived in frames]
    assert [[output.topic for output in step] for step in outputs] == [
        [OBSERVATIONS],
        [OBSERVATIONS, SURFACE],
        [OBSERVATIONS],
        [OBSERVATIONS],
        [OBSERVATIONS, SURFACE],
        # another run of the camera counts from 0 again
        [OBSERVATIONS, SURFACE],
    ]
    assert [step[0].message.surface_sequence for step in outputs] == [None, 5, 5, 5, 21, 0]


def test_a_frame_of_another_size_than_the_calibration_is_unusable_and_names_both():
    (found,) = fed(Perception(), calibration(image_width=640), frame())
    assert unusable(found, "the images are 320x240 and the calibration is for 640x240")


def test_a_frame_of_another_calibration_is_unusable_until_its_own_has_come():
    old, new = calibration(), calibration(metres_per_unit=1e-3)
    agent = Perception()
    before, after, then = fed(
        agent, old, frame(calibration_id=calibration_id(old)), frame(calibration_id=calibration_id(new)), new,
        frame(calibration_id=calibration_id(new)),
    )  # fmt: skip
    assert (before.status, then.status) == (Status.OK, Status.OK)
    assert unusable(after, f"taken with calibration {calibration_id(new)}, and the newest known is")
    assert then.camera.metres_per_unit == 1e-3


def spoilt_image(image, how):
    data = {
        "half": image.data[: len(image.data) // 2],
        "garbage": b"no image at all",
        "half as high": encode_image(picture()[: HEIGHT // 2], ImageEncoding.JPEG).data,
    }
    return dataclasses.replace(image, data=data[how])


@pytest.mark.parametrize(
    ("eye", "how", "reason"),
    [
        ("left", "half", "JPEG are not whole"),
        ("right", "garbage", "15 bytes of JPEG"),
        ("right", "half as high", "decodes to 320x120, not to"),
    ],
)
def test_a_spoilt_image_is_one_sentence_and_the_next_frame_is_seen(eye, how, reason):
    whole = frame(ImageEncoding.JPEG)
    spoilt = dataclasses.replace(whole, **{eye: spoilt_image(getattr(whole, eye), how)})
    first, second = fed(Perception(), calibration(), spoilt, frame())
    assert unusable(first, reason)
    assert second.status is Status.OK


def test_exchanged_cameras_are_said_with_every_frame_until_a_good_calibration_comes():
    T = np.eye(4)
    T[0, 3] = 0.005
    *exchanged, good = fed(Perception(), calibration(T_right_left=T), frame(), frame(), calibration(), frame())
    assert all(unusable(found, "exchange the cameras") for found in exchanged)
    assert good.status is Status.OK


def test_a_calibration_of_absurd_size_takes_no_memory():
    size = 2**14
    (found,) = fed(Perception(), calibration(image_width=size, image_height=size), frame())
    assert unusable(found, f"the calibration is for {size}x{size}")
    huge = Image(ImageEncoding.JPEG, size, size, 3, b"\xff\xd8..\xff\xd9")
    both = dataclasses.replace(frame(), left=huge, right=huge)
    (found,) = fed(Perception(), calibration(image_width=size, image_height=size), both)
    assert unusable(found, "the JPEG is damaged")


@settings(max_examples=12)
@given(
    distortion=st.lists(st.floats(-1e6, 1e6), min_size=5, max_size=5),
    focal=st.floats(1e-3, 1e6),
    centre=st.floats(-1e6, 1e6),
    angle=st.floats(-3.2, 3.2),
)
def test_any_calibration_that_passes_the_wire_ends_in_a_status(distortion, focal, centre, angle):
    K = np.array([[focal, 0, centre], [0, focal, centre], [0, 0, 1]])
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[0, 3] = -0.005
    wild = calibration(K_left=K, distortion_left=np.array(distortion), T_right_left=T)
    (found,) = fed(Perception(PerceptionConfig("threshold")), wild, frame())
    assert (found.status is Status.OK) == (found.reason == "")
