"""Any centrelines and any masks end as a status, without an exception, a warning or a number that is none."""

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from agents.perception.observe import observe as observe_pair
from agents.reconstruction.refined.method import reconstruct_refined
from agents.reconstruction.refined.tracking import track_refined
from schemas.checks import MessageError
from schemas.codec import encode
from schemas.messages import Centrelines, FrameStamp, RectifiedStereo, Status
from tests.agents.reconstruction.threads import observed_lines

WIDTH, HEIGHT = 320, 240
CAMERA = RectifiedStereo(WIDTH, HEIGHT, 330.0, 335.0, 159.5, 119.5, 5.5, 1e-3)
EXTREME = (1e-300, 1e-25, 1e25, 1e300)


def checked(observations, last=None):
    """What is made of a frame alone, and with a last thread in mind."""
    for thread in (reconstruct_refined(observations), *([track_refined(observations, last)] if last else [])):
        assert (thread.stamp, thread.method) == (observations.stamp, "refined")
        encode(thread)
        if thread.status is Status.FAILED:
            assert len(thread.reason) > 10
            assert thread.reason.isprintable()
            continue
        covariance = thread.posterior_covariance
        least = -1e-9 * abs(covariance).max()
        assert min(len(thread.confidence), len(covariance)) >= 100
        np.testing.assert_allclose(covariance, covariance.transpose(0, 2, 1), atol=-least)
        assert np.linalg.eigvalsh(covariance).min() >= least
        assert (thread.unseen[:, 0] <= thread.unseen[:, 1]).all()


def last_thread(camera):
    """The lines of a thread that was in view a frame before, and what the same camera has made of them."""
    t = np.linspace(0, 1, 200)
    left = np.column_stack((90 + 160 * t, 120 + 70 * np.sin(5 * t)))
    lines = tuple(
        Centrelines(left - (disparity, 0.0), np.zeros(200, np.int64), np.full(200, 3.0), np.full(200, 0.1))
        for disparity in (0.0, 20.0)
    )
    before = FrameStamp(6, 100 - 33_333_333, 200 - 33_333_333, "calibration")
    return lines, track_refined(observed_lines(lines[0], lines[1], camera, stamp=before), None)


def wandering(rng, count):
    return np.cumsum(rng.normal(0, rng.choice((0.0, 0.1, 1.0, 3.0)), (count, 2)), axis=0) + rng.uniform(40, 240, 2)


def straight(rng, count):
    ends = rng.uniform(0, 240, (2, 2))
    ends[1, rng.integers(0, 2)] = ends[0, rng.integers(0, 2)]
    return np.linspace(ends[0], ends[1], count)


def circling(rng, count):
    t = np.linspace(0, rng.choice((2.0, 6.3, 20.0)), count)
    return rng.uniform(2, 90) * np.column_stack((np.cos(t), np.sin(t))) + [160, 120]


def anywhere(rng, count):
    return rng.uniform(-1, 1, (count, 2)) * 10.0 ** rng.choice((1, 2, 3, 20, 300)) + 100


PIECES = (wandering, straight, circling, anywhere)


@st.composite
def centrelines(draw):
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    kinds = draw(st.lists(st.sampled_from(PIECES), min_size=1, max_size=6))
    pieces = [kind(rng, int(draw(st.sampled_from((1, 2, 3, 12, 40, 200))))) for kind in kinds]
    points, number = np.concatenate(pieces), np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    width, deviation = draw(st.sampled_from((0.5, 3.0, 30.0))), draw(st.sampled_from((0.03, 0.1, 3.0)))
    if draw(st.integers(0, 9)) == 0:
        width, deviation = draw(st.sampled_from(EXTREME)), draw(st.sampled_from(EXTREME))
    return Centrelines(points, number, np.full(len(points), width), np.full(len(points), deviation))


@pytest.mark.slow
@given(data=st.data())
@settings(max_examples=20)
def test_any_centrelines_end_as_a_status(data):
    left = data.draw(centrelines())
    if data.draw(st.integers(0, 3)):
        disparity = data.draw(st.sampled_from((20.0, 5.0, 60.0, 0.0, -10.0, 1e-9)))
        rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
        noise = rng.normal(0, data.draw(st.sampled_from((0.0, 0.1, 1.0))), left.point_px.shape)
        shift = np.array([disparity, data.draw(st.sampled_from((0.0, 0.0, 0.4, 6.0)))])
        right = dataclasses.replace(left, point_px=left.point_px - shift + noise)
    else:
        right = data.draw(centrelines())
    scale = data.draw(st.sampled_from((1.0, 1.0, 1.0, 1e-3, 1e9, *EXTREME)))
    unit = data.draw(st.sampled_from((None, None, 1e-3, 1.0, 1e-300)))
    camera = dataclasses.replace(CAMERA, baseline=CAMERA.baseline * scale, metres_per_unit=unit)
    lines, last = last_thread(camera)
    # a track goes on only where an image shows its thread, so often one of them does
    known = data.draw(st.sampled_from((None, None, 0, 1)))
    left, right = (lines[eye] if eye == known else new for eye, new in enumerate((left, right)))
    checked(observed_lines(left, right, camera), last)


ABSURD = (5e-324, 1e-300, 1e-30, 1e-9, 1e9, 1e18, 2.0**63, 1e30, 1e300, 1.7e308)
OF_TRACK = ("control_points_camera", "covariance", "smoothing", "span_weight", "row_offset_px", "length", "material_s")
OF_CAMERA = ("fx_px", "fy_px", "cx_px", "cy_px", "baseline")


def spoilt(message, name, number, rng):
    """The message with a field, one of its numbers or a share of them replaced; None where no such message is valid."""
    value = getattr(message, name)
    if isinstance(value, np.ndarray):
        value = value.copy()
        value[rng.random(value.shape) < rng.choice((0.01, 0.1, 1.0))] = number
        value.flat[rng.integers(value.size)] = number
    else:
        value = number
    try:
        return dataclasses.replace(message, **{name: value})
    except MessageError:
        return None


@pytest.mark.slow
@given(
    of_track=st.sampled_from(OF_TRACK),
    of_camera=st.sampled_from((None, *OF_CAMERA)),
    number=st.sampled_from(ABSURD),
    negative=st.booleans(),
    seed=st.integers(0, 1000),
)
@settings(max_examples=10)
def test_absurd_but_valid_tracks_and_cameras_end_as_a_status(of_track, of_camera, number, negative, seed):
    rng, number = np.random.default_rng(seed), -number if negative else number
    lines, last = last_thread(CAMERA)
    camera = CAMERA if of_camera is None else spoilt(CAMERA, of_camera, number, rng)
    track = spoilt(last.track, of_track, number, rng)
    assume(camera is not None and track is not None)
    assert camera is not None
    last = dataclasses.replace(last, camera=camera, track=track)
    with np.errstate(all="ignore"):
        checked(observed_lines(lines[0], lines[1], camera), last)


def scribble(mask, rng):
    points = np.cumsum(rng.normal(0, rng.choice((3, 15, 60)), (rng.integers(2, 40), 2)), axis=0) + np.array([160, 120])
    cv2.polylines(mask, [np.rint(points).astype(np.int32)], bool(rng.integers(2)), 255, int(rng.integers(1, 6)))


def loops(mask, rng):
    for _ in range(rng.integers(1, 5)):
        centre, axes = (rng.integers(1, high, 2).tolist() for high in (240, 100))
        cv2.ellipse(mask, centre, axes, float(rng.integers(180)), 0, float(rng.choice((180, 300, 360))), 255, 2)
    cv2.circle(mask, rng.integers(0, 240, 2).tolist(), int(rng.integers(2, 25)), 0, -1)


DRAWINGS = (scribble, loops)


@pytest.mark.slow
@given(drawing=st.sampled_from(DRAWINGS), seed=st.integers(0, 10**6), blur=st.sampled_from((0.0, 0.0, 1.0, 3.0)))
@settings(max_examples=20)
def test_any_masks_end_as_a_status(drawing, seed, blur):
    rng = np.random.default_rng(seed)
    left = np.zeros((HEIGHT, WIDTH), np.uint8)
    drawing(left, rng)
    left = cv2.GaussianBlur(left, (0, 0), blur) if blur else left
    right = np.roll(left, -int(rng.choice((0, 1, 8, 20, 79))), axis=1)
    if rng.random() < 0.3:
        right = np.zeros_like(left)
        DRAWINGS[rng.integers(len(DRAWINGS))](right, rng)
    elif rng.random() < 0.5:
        u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        right = cv2.remap(right, (u + 6 * np.sin(v / 40)).astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
    seen, other = ((200 - 0.6 * mask[..., None] + np.zeros(3)).astype(np.uint8) for mask in (left, right))
    judged = None if rng.random() < 0.1 else ()
    checked(observe_pair(FrameStamp(1, 1, 1, ""), CAMERA, seen, other, left, right, "mask", judged, matching=False))
