"""A right eye that is out of line is put in line by what the pair itself shows, within bounds, and said to be."""

import functools

import cv2
import numpy as np
import pytest

from agents.perception.judging.whole import judge_whole
from schemas.messages import RectifiedStereo, RightEye, Severity
from shared.disparities import disparities
from shared.right_eye import IN_LINE, from_in_line, in_line, moved

WIDTH, HEIGHT = 960, 540
CAMERA = RectifiedStereo(WIDTH, HEIGHT, 1000.0, 1000.0, 450.0, 280.0, 5.5, 1e-3)


@functools.cache
def ground(seed):
    rng = np.random.default_rng(seed)
    parts = [cv2.GaussianBlur(rng.standard_normal((HEIGHT, 2 * WIDTH, 3)), (0, 0), s) for s in (12.0, 3.0)]
    image = 120 + 25 * parts[0] / parts[0].std() + 15 * parts[1] / parts[1].std()
    for _ in range(400):
        at, size = rng.integers(0, (2 * WIDTH, HEIGHT)), rng.integers(2, 9, 2)
        cv2.ellipse(image, at.tolist(), size.tolist(), float(rng.integers(180)), 0, 360, (225, 230, 240), -1)
    return image


def pair(eye=None, disparity_px=60.0, seed=1):
    """The ground 60 px apart, the right eye out of line by so much."""
    image = ground(seed)
    left = image[:, 200 : 200 + WIDTH]
    in_rows = np.array([[1.0, 0.0, -200.0 - disparity_px], [0.0, 1.0, 0.0]])
    shift = np.vstack((in_rows, (0, 0, 1)))
    by = np.vstack((from_in_line(eye, CAMERA), (0, 0, 1)))
    right = cv2.warpAffine(image, (by @ shift)[:2], (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    noise = np.random.default_rng(seed).normal(0, 1.5, (2, HEIGHT, WIDTH, 3))
    return tuple(np.clip(one + more, 0, 255).astype(np.uint8) for one, more in zip((left, right), noise, strict=True))


def plainly(whole):
    """What is still wrong with a pair."""
    return [j.code for j in (*whole.offset, *(whole.alignment or ()))]


def judged(images, before=None):
    return judge_whole(images, images, CAMERA, before)


EYE = RightEye(1.6, 0.3, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("eye", [EYE, RightEye(-2.0, -0.4, 1.004)])
def test_an_eye_out_of_line_is_put_in_line_and_said_to_be(eye):
    found = judged(pair(eye))
    assert found.right_eye is not None
    corners = np.array([(0, 0), (WIDTH - 1, 0), (0, HEIGHT - 1), (WIDTH - 1, HEIGHT - 1)], float)
    off = moved(corners, from_in_line(found.right_eye, CAMERA)) - moved(corners, from_in_line(eye, CAMERA))
    assert np.abs(off[:, 1]).max() < 0.35
    after = plainly(judged(found.images))
    assert after == []
    assert [(j.code, j.severity) for j in found.offset] == [("row_offset", Severity.WARNING)]
    assert found.alignment == ()


@pytest.mark.slow
@pytest.mark.parametrize("eye", [RightEye(0.6, 0.0, 1.0), RightEye(0.0, 0.05, 1.0)])
def test_an_eye_that_is_hardly_out_of_line_stays_as_it_is(eye):
    images = pair(eye)
    found = judged(images)
    assert found.right_eye is None and found.images[1] is images[1] and found.offset == ()


@pytest.mark.parametrize("eye", [RightEye(0.0, 0.9, 1.0), RightEye(9.0, 0.0, 1.0), RightEye(0.0, 0.0, 1.03)])
def test_beyond_its_bounds_nothing_is_mended_and_the_pair_is_at_fault(eye):
    found = judged(pair(eye))
    assert found.right_eye is None
    assert any(j.severity is Severity.FAULT and j.remedy for j in found.alignment or ())


@pytest.mark.slow
def test_what_was_put_in_line_stays_while_it_moves_no_corner_by_much():
    before = judged(pair(EYE)).right_eye
    near = RightEye(EYE.rows_px + 0.2, EYE.turned_deg + 0.02, 1.0)
    assert judged(pair(near, seed=2), before).right_eye == before
    assert judged(pair(RightEye(1.6, 0.5, 1.0), seed=2), before).right_eye != before


@pytest.mark.parametrize("disparity_px", [30.0, 330.0])
def test_a_pair_shows_at_which_disparities_thread_may_be_on_any_rig(disparity_px):
    shown = judged(pair(disparity_px=disparity_px)).disparities_px
    assert shown is not None
    least, most = shown
    assert least < 0.7 * disparity_px and 1.4 * disparity_px < most < 1.6 * disparity_px
    reach = disparities(WIDTH, np.array([least, most]))
    assert (reach.least_px, reach.most_px) == (least, most)
    # what no rig can have is no range
    for told in ((50.0, 20.0), (np.nan, 3.0), (700.0, 900.0)):
        assert disparities(WIDTH, np.array(told)) == disparities(WIDTH)


def test_pixels_in_line_lead_to_the_image_as_it_came():
    eye = RightEye(3.0, 0.5, 1.01)
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    at = moved(np.array([700.0, 400.0]), from_in_line(eye, CAMERA))
    cv2.circle(image, tuple(np.rint(at).astype(int).tolist()), 4, 255, -1)
    row, column = (np.flatnonzero(in_line(image, eye, CAMERA, linear=True).max(axis=axis) > 128) for axis in (1, 0))
    assert abs(column.mean() - 700) < 1 and abs(row.mean() - 400) < 1
    assert from_in_line(None, CAMERA) is IN_LINE
