"""The perception agent on frames and calibrations that do not go together, on damaged ones, and on what it judges."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.camera.scene_source import calibration_of
from agents.perception.agent import Perception
from agents.perception.judging.each_frame import ONE_STILL_FRAMES, STILL_FRAMES
from schemas.codec import encode
from schemas.messages import Image, ImageEncoding, Severity, Status, StereoCalibration
from schemas.topics import OBSERVATIONS, SURFACE
from shared.calibration.identity import calibration_id
from shared.images import decode_image, encode_image
from shared.rendering.render import ENDOSCOPE
from shared.runtime.agent import Tick, outputs_in
from tests.agents.perception.pictures import agent_with, fed, frame_of, noisy, rendered_pair, replies

WIDTH, HEIGHT, DISPARITY = 320, 240, 24
SIZE = 2**14


def calibration(**changes):
    K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
    T = np.eye(4)
    T[0, 3] = -0.005
    whole = StereoCalibration(WIDTH, HEIGHT, K, K.copy(), np.zeros(0), np.zeros(0), T, 1.0)
    return replace(whole, **changes)


def picture(shift=0):
    """A dark thread, two pixels thick, across a bright ground."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    line = 120 + 60 * np.sin((v - 20) / 60)
    dark = (np.abs(u + shift - line) < 1.5) & (v > 30) & (v < 210)
    return np.where(dark, 40, 210).astype(np.uint8)[..., None].repeat(3, axis=2)


def frame(sequence=7, encoding=ImageEncoding.PNG, **stamp):
    return frame_of((picture(), picture(DISPARITY)), sequence, encoding, **stamp)


def is_unusable(observed, reason):
    assert observed.status is Status.FAILED
    assert reason in observed.reason
    assert "\n" not in observed.reason
    assert len(observed.points_camera) == 0
    (judgement,) = observed.judgements
    told = judgement.code, judgement.severity, judgement.finding
    assert told == ("unusable_input", Severity.FAULT, observed.reason)
    return True


@pytest.mark.parametrize("encoding", ImageEncoding)
@pytest.mark.parametrize("colours", [1, 3])
def test_a_thread_is_observed_at_its_depth_and_the_frames_stamp_is_kept(encoding, colours):
    images = [picture(shift)[..., :colours].squeeze() for shift in (0, DISPARITY)]
    whole = frame_of(images, 7, encoding)
    (found,) = fed(agent_with(calibration(), matching=True), whole)
    assert (found.status, found.reason, found.segmenter) == (Status.OK, "", "threshold")
    assert found.stamp == whole.stamp
    assert np.median(found.points_camera[:, 2]) == pytest.approx(300 * 0.005 / DISPARITY, rel=0.02)
    assert (found.mask_left.width, found.mask_left.height) == (WIDTH, HEIGHT)


def test_without_matching_there_are_centrelines_alone_and_the_segmenter_is_as_configured():
    (found,) = fed(agent_with(calibration(), "network"), frame())
    assert (found.status, found.segmenter) == (Status.OK, "network")
    assert len(found.points_camera) == len(found.matched_px) == 0
    assert len(found.centrelines_left.point_px) > 50
    assert len(found.centrelines_right.point_px) > 50


def test_without_a_calibration_nothing_is_said_and_with_it_the_next_frame_is_seen():
    agent = Perception()
    assert list(agent.step(Tick(1))) == []
    assert fed(agent, frame(), frame()) == []
    assert [o.status for o in fed(agent, calibration(), frame())] == [Status.OK]


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
    first_ns, now_ns = 5_000_000_000, 5_000_000_000 + before_ms * 1_000_000
    first = frame(capture_left_ns=first_ns, capture_right_ns=first_ns)
    second = frame(7 + sequences, capture_left_ns=now_ns, capture_right_ns=now_ns + apart_ms * 1_000_000)
    _, found = fed(agent_with(calibration()), first, second)
    if most_ms is None:
        assert found.status is Status.OK
    else:
        said = f"captured {abs(apart_ms)} ms apart, and at most a frame period of {most_ms} ms"
        assert is_unusable(found, said)


def test_the_second_frame_brings_a_surface_and_the_observations_say_which_frame_had_one():
    agent = agent_with(calibration(), "threshold")
    outputs = [outputs_in(replies(agent, frame(k))) for k in (3, 5, 6, 20, 21, 0)]
    both = [OBSERVATIONS, SURFACE]
    # another run of the camera counts from 0 again
    assert [[o.topic for o in step] for step in outputs] == [both[:1], both, both[:1], both[:1], both, both]
    assert [step[0].message.surface_sequence for step in outputs] == [None, 5, 5, 5, 21, 0]


def test_a_frame_of_another_calibration_is_unusable_until_its_own_has_come():
    old, new = calibration(), calibration(metres_per_unit=1e-3)
    of_old, of_new = (frame(calibration_id=calibration_id(one)) for one in (old, new))
    before, after, then = fed(agent_with(old), of_old, of_new, new, of_new)
    assert (before.status, then.status) == (Status.OK, Status.OK)
    assert is_unusable(after, f"taken with calibration {calibration_id(new)}, and the newest known is")
    assert then.camera.metres_per_unit == 1e-3


WHOLE = frame(encoding=ImageEncoding.JPEG)
EXCHANGED = np.eye(4)
EXCHANGED[0, 3] = 0.005


HUGE = Image(ImageEncoding.JPEG, SIZE, SIZE, 3, b"\xff\xd8..\xff\xd9")


def spoilt(eye, data):
    return replace(WHOLE, **{eye: Image(ImageEncoding.JPEG, WIDTH, HEIGHT, 3, data)})


@pytest.mark.parametrize(
    ("spoilt_frame", "changes", "reason"),
    [
        (spoilt("left", WHOLE.left.data[: len(WHOLE.left.data) // 2]), {}, "JPEG are not whole"),
        (spoilt("right", b"no image at all"), {}, "15 bytes of JPEG"),
        (
            spoilt("right", encode_image(picture()[: HEIGHT // 2], ImageEncoding.JPEG).data),
            {},
            "decodes to 320x120, not to",
        ),
        (WHOLE, {"image_width": 640}, "the images are 320x240 and the calibration is for 640x240"),
        (WHOLE, {"T_right_left": EXCHANGED}, "exchange the cameras"),
        # a size that nobody has takes no memory
        (WHOLE, {"image_width": SIZE, "image_height": SIZE}, f"the calibration is for {SIZE}x{SIZE}"),
        (replace(WHOLE, left=HUGE, right=HUGE), {"image_width": SIZE, "image_height": SIZE}, "the JPEG is damaged"),
    ],
)
def test_what_cannot_be_used_is_one_sentence_with_every_frame_until_it_is_mended(spoilt_frame, changes, reason):
    agent = agent_with(calibration(**changes))
    assert all(is_unusable(found, reason) for found in fed(agent, spoilt_frame, spoilt_frame))
    assert fed(agent, calibration(), frame())[0].status is Status.OK


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
    (found,) = fed(agent_with(wild, "threshold"), frame())
    assert (found.status is Status.OK) == (found.reason == "")


ENDOSCOPES = calibration_of(ENDOSCOPE)


def tissue(sequence, right_lower=0, seeds=(), change=lambda image: image):
    left, right = rendered_pair()
    images = change(left), change(np.roll(right, right_lower, axis=0))
    return frame_of(noisy(images, *(seeds or (sequence, 1000 + sequence))), sequence)


def codes(observed):
    return {j.code: j.severity for j in observed.judgements}


@pytest.mark.slow
def test_a_new_calibration_has_the_pair_judged_again():
    agent = agent_with(ENDOSCOPES)
    for sequence, metres_per_unit in enumerate((1e-3, None)):
        (observed,) = fed(agent, replace(ENDOSCOPES, metres_per_unit=metres_per_unit), tissue(sequence, 2))
        assert codes(observed) == {"row_offset": Severity.WARNING}
        assert "judged in frame" not in observed.judgements[0].finding


def test_rows_too_far_apart_to_be_a_little_off_are_a_fault_and_stay():
    (found,) = fed(agent_with(ENDOSCOPES), tissue(0, 12))
    assert (found.status, found.rows_moved_up) == (Status.FAILED, 0)
    assert codes(found) == {"row_residual": Severity.FAULT}


def test_a_replay_from_the_midst_goes_on_with_the_rows_as_they_were():
    frames = [tissue(k, 3) for k in range(3)]
    whole = fed(agent_with(ENDOSCOPES), *frames)
    (later,) = fed(agent_with(ENDOSCOPES), whole[1], frames[2])
    assert encode(later) == encode(whole[2])


@pytest.mark.slow
def test_pictures_that_stand_still_are_said_to_while_they_do():
    still = 5, 1005
    frames = tissue(0), tissue(5), tissue(5 + STILL_FRAMES, seeds=still), tissue(6 + STILL_FRAMES)
    found = fed(agent_with(ENDOSCOPES), *frames)
    assert [codes(o) for o in found] == [{}, {}, {"frozen": Severity.WARNING}, {}]
    assert "since frame 5" in found[2].judgements[0].finding
    _, begun_again = fed(agent_with(ENDOSCOPES), tissue(100, seeds=still), tissue(2, seeds=still))
    assert begun_again.picture_left_since == 2


@pytest.mark.slow
def test_one_eye_that_stands_still_makes_frames_unusable_until_it_goes_on():
    last = 1 + ONE_STILL_FRAMES
    held = [tissue(k, seeds=(k, 1001)) for k in (1, 2, last)]
    found = fed(agent_with(ENDOSCOPES), *held, tissue(last + 1))
    assert [o.status for o in found] == [Status.OK, Status.OK, Status.FAILED, Status.OK]
    assert "the right eye has shown the very same picture since frame 1" in found[2].reason


@pytest.mark.slow
@pytest.mark.parametrize("rows", [-3, 2])
def test_rows_that_are_apart_are_put_in_line_and_said_to_be_until_the_camera_is_straight_again(rows):
    def ends(observed):
        return np.flatnonzero(decode_image(observed.mask_right).max(axis=1) > 96)[[0, -1]]

    (straight,) = fed(agent_with(ENDOSCOPES), tissue(0))
    straight_again = [tissue(k) for k in range(61, 160, 3)]
    apart = [tissue(k, rows) for k in (0, 1, 40)]
    *found, come_back = fed(agent_with(ENDOSCOPES), *apart, *straight_again)
    for observed in found[:3]:
        assert (observed.status, observed.rows_moved_up) == (Status.OK, rows)
        assert codes(observed) == {"row_offset": Severity.WARNING}
        assert abs(ends(observed) - ends(straight)).max() <= 1
    said = f"{abs(rows)}.0 px {'lower' if rows > 0 else 'higher'} than in the left"
    assert said in found[0].judgements[0].finding
    assert found[1].judgements[0].finding.endswith("(judged in frame 0)")
    for observed in (straight, come_back):
        assert (observed.rows_moved_up, codes(observed)) == (0, {})


@pytest.mark.slow
def test_exposure_is_told_of_the_frame_at_hand_and_blur_until_the_whole_is_looked_at_again():
    dark = tissue(1, change=lambda image: (image * 0.15).astype(np.uint8))
    found = fed(agent_with(ENDOSCOPES), tissue(0), dark, tissue(2))
    assert ["too_dark" in codes(o) for o in found] == [False, True, False]
    blurred = tissue(0, change=lambda image: cv2.GaussianBlur(image, (0, 0), 3.0))
    found = fed(agent_with(ENDOSCOPES), blurred, tissue(40))
    assert [codes(o).get("blurred") for o in found] == [Severity.WARNING, None]
