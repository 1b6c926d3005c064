"""A line that ends short in one eye goes on where the other eye, and its own image, show more of the thread."""

import cv2
import numpy as np
import pytest

from agents.perception.both_eyes.ends import ended_together
from agents.perception.centrelines.along import Pieces, evenly_spaced
from agents.perception.centrelines.centrelines import Lines
from schemas.messages import Centrelines

THREAD, GROUND = (60, 40, 90), (90, 120, 170)
DISPARITY, WIDTH = 30.0, 5
UP, LEVEL = (
    np.column_stack((np.full(150, 120.0), np.linspace(200, 51, 150))),
    np.column_stack((np.arange(121.0, 301), np.full(180, 50.0))),
)
THREAD_PX = np.concatenate((UP, LEVEL))
SHORT = 17


def image(points, until):
    """A thread along points over noisy ground; it ends where they reach a column."""
    seen = np.random.default_rng(1).normal(GROUND, 2, (240, 360, 3)).clip(0, 255).astype(np.uint8)
    cv2.polylines(
        seen, [np.rint(points[points[:, 0] <= until]).astype(np.int32)[:, None]], False, THREAD, WIDTH, cv2.LINE_AA
    )
    return seen


def line(points, loose=True):
    point, pieces = evenly_spaced(points, Pieces(np.zeros(len(points), np.int64)), 1.0)
    n = len(point)
    lines = Centrelines(point, pieces.number, np.full(n, 5.0), np.full(n, 0.1))
    return Lines(lines, np.array([True]), np.array([loose]))


def pair(until=300.0, loose=True, missing=SHORT):
    """Both images, with the thread up to a column of the left one; and lines, the left one short of its end."""
    right_px = THREAD_PX - (DISPARITY, 0.0)
    images = image(THREAD_PX, until), image(right_px, 300.0 - DISPARITY)
    return images, line(THREAD_PX[: len(THREAD_PX) - missing], loose), line(right_px)


def test_the_line_goes_on_to_where_the_other_eye_and_its_own_image_see_the_thread_end():
    images, left, right = pair()
    found = ended_together(images, left, right)
    assert left.centrelines.point_px[-1, 0] == pytest.approx(300 - SHORT)
    assert found[0].point_px[-1, 0] == pytest.approx(302, abs=1.5)
    assert found[1] is right.centrelines


def test_the_right_line_goes_on_as_the_left_one_does():
    images, _, _ = pair()
    exchanged = line(THREAD_PX), line(THREAD_PX[:-SHORT] - (DISPARITY, 0.0))
    found = ended_together(images, *exchanged)
    assert found[0] is exchanged[0].centrelines
    assert found[1].point_px[-1, 0] == pytest.approx(302 - DISPARITY, abs=1.5)


def test_a_line_that_begins_short_goes_on_before_its_first_point():
    images, left, right = pair()
    turned = left.centrelines.point_px[::-1]
    found = ended_together(images, line(turned), right)
    assert found[0].point_px[0, 0] == pytest.approx(302, abs=1.5)


@pytest.mark.parametrize(
    ("until", "loose", "missing"),
    [(300.0 - SHORT, True, SHORT), (300.0, False, SHORT), (300.0, True, 4)],
    ids=["its image shows no thread there", "it is cut there", "the other eye sees hardly more"],
)
def test_a_line_ends_as_it_did_where(until, loose, missing):
    images, left, right = pair(until, loose, missing)
    assert ended_together(images, left, right)[0].point_px[-1, 0] == left.centrelines.point_px[-1, 0]


def test_thread_that_one_eye_alone_would_go_on_along_is_left_to_the_segmenter():
    images, left, _ = pair()
    short = line(THREAD_PX[:-SHORT] - (DISPARITY, 0.0))
    found = ended_together(images, left, short)
    assert found == (left.centrelines, short.centrelines)


def test_a_line_that_the_other_eye_sees_go_elsewhere_stays():
    images, left, _ = pair()
    beside = THREAD_PX - (DISPARITY, 0.0)
    # from 20 px before the left line ends it runs some rows below
    beside[len(beside) - SHORT - 20 :, 1] += 8.0
    assert ended_together(images, left, line(beside))[0] is left.centrelines


def test_a_line_stays_whose_end_lies_far_from_what_both_eyes_see():
    images, left, _ = pair()
    beside = THREAD_PX - (DISPARITY, 0.0)
    # it comes back just before the left line ends
    beside[len(beside) - SHORT - 80 : len(beside) - SHORT - 6, 1] += 8.0
    assert ended_together(images, left, line(beside))[0] is left.centrelines


def test_lines_without_a_place_that_both_see_stay():
    images, left, _ = pair()
    elsewhere = line(np.column_stack((np.full(100, 200.0), np.arange(100, 200.0)))[:20])
    assert ended_together(images, left, elsewhere) == (left.centrelines, elsewhere.centrelines)
