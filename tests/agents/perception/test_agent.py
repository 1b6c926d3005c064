"""The perception agent on frames and calibrations that do not go together, and on damaged ones."""

import dataclasses
import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.camera.scene_source import calibration_of
from agents.perception.agent import Perception, PerceptionConfig
from schemas.checks import MessageError
from schemas.codec import decode, encode
from schemas.generated import suturegrasp_pb2 as pb
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
from shared.scene.__main__ import make_scene
from shared.scene.render import render

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


@pytest.mark.parametrize("grey", [False, True], ids=["colour", "grey"])
@pytest.mark.parametrize("encoding", ImageEncoding)
def test_a_thread_is_observed_at_its_depth_and_the_frames_stamp_is_kept(encoding, grey):
    (found,) = fed(Perception(MATCHING), calibration(), frame(encoding, grey))
    assert (found.status, found.reason, found.segmenter) == (Status.OK, "", "threshold")
    assert found.stamp == frame().stamp
    assert np.median(found.points_camera[:, 2]) == pytest.approx(300 * 0.005 / DISPARITY, rel=0.02)
    assert (found.mask_left.width, found.mask_left.height) == (WIDTH, HEIGHT)


def test_without_a_calibration_nothing_is_said_and_with_it_the_next_frame_is_seen():
    agent = Perception()
    assert fed(agent, frame(), frame()) == []
    assert [o.status for o in fed(agent, calibration(), frame())] == [Status.OK]


def at(sequence, left_ms, right_ms):
    """A frame of which the eyes were captured then."""
    stamp = FrameStamp(sequence, round(left_ms * 1e6), round(right_ms * 1e6), "")
    return dataclasses.replace(frame(), stamp=stamp)


@pytest.mark.parametrize("apart_ms", [120.0, -120.0])
def test_a_frame_whose_eyes_were_captured_far_apart_is_a_failure(apart_ms):
    (found,) = fed(Perception(), calibration(), at(7, 500, 500 + apart_ms))
    assert unusable(found, "the eyes were captured 120 ms apart, and at most a frame period of 40 ms is accepted")
    (close,) = fed(Perception(), calibration(), at(7, 500, 539))
    assert close.status is Status.OK


@pytest.mark.parametrize(
    ("before_ms", "sequences", "apart_ms", "most_ms"),
    [
        (100, 1, 60, None),  # 10 Hz
        (100, 1, 101, 100),
        (100, 4, 30, 25),  # 40 Hz, of which every fourth was taken
        (100, -3, 60, 40),  # another run of the camera
        (100, 0, 39, None),
        (-100, 1, 60, 40),
        (3000, 1, 60, 40),  # a pause
    ],
)
def test_how_far_apart_the_eyes_may_be_is_the_period_since_the_frame_before(before_ms, sequences, apart_ms, most_ms):
    first, second = at(7, 5000, 5000), at(7 + sequences, 5000 + before_ms, 5000 + before_ms + apart_ms)
    _, found = fed(Perception(), calibration(), first, second)
    if most_ms is None:
        assert found.status is Status.OK
    else:
        assert unusable(found, f"a frame period of {most_ms} ms")


def shifted(sequence, right=0):
    """A frame whose thread has moved to the right."""
    left, other = (encode_image(np.roll(picture(shift), right, axis=1), ImageEncoding.PNG) for shift in (0, DISPARITY))
    return StereoFrame(FrameStamp(sequence, 100, 200, ""), left, other)


@functools.cache
def tissue():
    """A calibration, and an image pair whose right one lies two rows too low."""
    scene = make_scene("easy", "tissue", 12)
    pair = render(scene)
    return calibration_of(scene.camera), pair.left_bgr, np.roll(pair.right_bgr, 2, axis=0)


def over_tissue(sequence):
    left, right = (encode_image(image, ImageEncoding.PNG) for image in tissue()[1:])
    return StereoFrame(FrameStamp(sequence, 100, 200, ""), left, right)


def test_what_is_said_of_frames_follows_from_the_frames_alone():
    frames = [calibration(), *(shifted(k, right=4 * k) for k in range(4)), frame(), shifted(5), shifted(60, right=9)]
    first, again = (fed(Perception(), *frames) for _ in range(2))
    assert [encode(o) for o in first] == [encode(o) for o in again]
    assert {o.status for o in first} == {Status.OK}


def test_a_followed_thread_is_where_looking_everywhere_finds_it():
    (_, followed), (alone,) = (
        fed(Perception(MATCHING), calibration(), shifted(0), shifted(1, 6)),
        fed(Perception(MATCHING), calibration(), shifted(1, 6)),
    )
    assert len(alone.points_camera)
    np.testing.assert_array_equal(followed.points_camera, alone.points_camera)
    np.testing.assert_array_equal(followed.centrelines_left.point_px, alone.centrelines_left.point_px)


def test_without_matching_there_are_centrelines_alone():
    (found,) = fed(Perception(), calibration(), frame())
    assert found.status is Status.OK
    assert len(found.points_camera) == len(found.matched_px) == 0
    assert len(found.centrelines_left.point_px) > 50
    assert len(found.centrelines_right.point_px) > 50


def test_a_warning_is_carried_on_with_its_frame_until_the_pair_is_judged_again():
    found = fed(Perception(), tissue()[0], *(over_tissue(k) for k in (0, 1, 2, 3, 4, 70)))
    # by the last frame both pictures have stood still for long
    assert [[j.code for j in o.judgements] for o in found] == [["row_offset"]] * 5 + [["row_offset", "frozen"]]
    fresh, *carried, again = (o.judgements[0].finding for o in found)
    assert carried == [f"{fresh} (judged in frame 0)"] * 4
    assert again == fresh


def test_the_second_frame_brings_a_surface_and_the_observations_say_which_frame_had_one():
    agent = Perception(PerceptionConfig("threshold"))
    list(agent.step(Received(CALIBRATION, key("lab", CALIBRATION), 0, calibration())))
    frames = [Received(FRAMES, key("lab", FRAMES), k, frame(sequence=k)) for k in (3, 5, 6, 20, 21)]
    outputs = [outputs_in(agent.step(arrived)) for arrived in frames]
    assert [[output.topic for output in step] for step in outputs] == [
        [OBSERVATIONS],
        [OBSERVATIONS, SURFACE],
        [OBSERVATIONS],
        [OBSERVATIONS],
        [OBSERVATIONS, SURFACE],
    ]
    assert [step[0].message.surface_sequence for step in outputs] == [None, 5, 5, 5, 21]


def test_a_new_calibration_has_the_pair_judged_again():
    first = tissue()[0]
    found = fed(Perception(), first, over_tissue(0), dataclasses.replace(first, metres_per_unit=None), over_tissue(1))
    assert len({o.judgements[0].finding for o in found}) == 1
    assert "judged in frame" not in found[1].judgements[0].finding


def test_ticks_are_not_its_business():
    assert list(Perception().step(Tick(1))) == []


def test_the_segmenter_is_as_configured():
    (found,) = fed(Perception(PerceptionConfig("network")), calibration(), frame())
    assert found.segmenter == "network"


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


@pytest.mark.parametrize("eye", ["left", "right"])
@pytest.mark.parametrize(
    ("how", "reason"),
    [("half", "JPEG are not whole"), ("garbage", "15 bytes of JPEG"), ("half as high", "decodes to 320x120, not to")],
)
def test_a_spoilt_image_is_one_sentence_and_the_next_frame_is_seen(eye, how, reason):
    whole = frame(ImageEncoding.JPEG)
    spoilt = dataclasses.replace(whole, **{eye: spoilt_image(getattr(whole, eye), how)})
    first, second = fed(Perception(), calibration(), spoilt, frame())
    assert unusable(first, reason)
    assert second.status is Status.OK


def test_a_calibration_with_exchanged_cameras_is_said_with_every_frame():
    T = np.eye(4)
    T[0, 3] = 0.005
    for found in fed(Perception(), calibration(T_right_left=T), frame(), frame()):
        assert unusable(found, "exchange the cameras")


def test_a_good_calibration_after_an_unusable_one_is_taken():
    T = np.eye(4)
    T[0, 3] = 0.005
    assert [o.status for o in fed(Perception(), calibration(T_right_left=T), calibration(), frame())] == [Status.OK]


@pytest.mark.parametrize("size", [2**13, 2**14])
def test_a_calibration_of_absurd_size_takes_no_memory(size):
    (found,) = fed(Perception(), calibration(image_width=size, image_height=size), frame())
    assert unusable(found, f"the calibration is for {size}x{size}")
    both = dataclasses.replace(
        frame(),
        left=Image(ImageEncoding.JPEG, size, size, 3, b"\xff\xd8..\xff\xd9"),
        right=Image(ImageEncoding.JPEG, size, size, 3, b"\xff\xd8..\xff\xd9"),
    )
    (found,) = fed(Perception(), calibration(image_width=size, image_height=size), both)
    assert unusable(found, "the JPEG is damaged")


@pytest.mark.parametrize("field", ["K_left", "K_right", "T_right_left"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_calibration_that_is_not_finite_is_refused_on_the_wire(field, value):
    wire = pb.StereoCalibration.FromString(encode(calibration()))
    numbers = np.frombuffer(getattr(wire, field).data).copy()
    numbers[2] = value
    getattr(wire, field).data = numbers.tobytes()
    with pytest.raises(MessageError, match=f"StereoCalibration.{field} must be finite"):
        decode(StereoCalibration, wire.SerializeToString())


@settings(max_examples=25, deadline=None)
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
