"""Centrelines end where the image shows the thread's tips, wherever the mask ended."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.perception.centrelines.tips import gone_on, to_tips
from schemas.messages import Centrelines

THREAD, GROUND = (60.0, 40.0, 90.0), (90.0, 120.0, 170.0)
TIPS = np.array([[40.3, 50.0], [200.7, 50.0]])


def scene(turn=0.0, width=5.0):
    """A straight thread between its tips over a noisy ground, turned about the middle of the image."""
    y, x = np.mgrid[:240, :240] + 0.0
    cos, sin = np.cos(turn), np.sin(turn)
    along, across = cos * (x - 120) + sin * (y - 120) + 120, -sin * (x - 120) + cos * (y - 120) + 50
    inside = np.minimum.reduce((along - TIPS[0, 0], TIPS[1, 0] - along, 0.5 * width - np.abs(across - 50)))
    alpha = np.clip(inside + 0.5, 0, 1)[..., None]
    image = alpha * THREAD + (1 - alpha) * GROUND + np.random.default_rng(1).normal(0, 2, (240, 240, 3))
    return cv2.GaussianBlur(image.clip(0, 255).astype(np.uint8), (0, 0), 0.7)


def placed(places, turn=0.0):
    """Points at places along the thread, turned with it."""
    x, y = np.asarray(places, float) - 120.0, np.zeros(len(places))
    cos, sin = np.cos(turn), np.sin(turn)
    return np.column_stack((120 + cos * x - sin * y, 120 + sin * x + cos * y))


def line(points, piece=None):
    n = len(points)
    piece = np.zeros(n, np.int64) if piece is None else piece
    return Centrelines(points, piece, np.full(n, 5.0), np.full(n, 0.1))


@settings(max_examples=20, deadline=None)
@given(st.floats(0, 2 * np.pi), st.floats(-2.5, 5.0), st.floats(-2.5, 5.0))
def test_a_line_that_ends_too_soon_or_too_late_ends_at_the_tips(turn, short_start, short_end):
    places = np.linspace(TIPS[0, 0] + short_start, TIPS[1, 0] - short_end, 150)
    found = to_tips(line(placed(places, turn)), scene(turn), np.array([True]), np.array([True]))
    np.testing.assert_allclose(found.point_px[[0, -1]], placed(TIPS[:, 0], turn), atol=0.5)
    step = np.linalg.norm(np.diff(found.point_px, axis=0), axis=1)
    assert 0 < step.min() <= step.max() < 2.5


@pytest.mark.parametrize("why", ["cut", "goes on", "no contrast"])
def test_a_line_stays_as_it_is_where_no_tip_is_seen(why):
    places = np.linspace(100, 150, 51) if why == "goes on" else np.linspace(TIPS[0, 0] + 2, TIPS[1, 0] - 2, 150)
    image = np.full((240, 240, 3), 90, np.uint8) if why == "no contrast" else scene()
    loose = np.array([why != "cut"])
    found = to_tips(line(placed(places)), image, loose, loose)
    np.testing.assert_array_equal(found.point_px, placed(places))


def test_pieces_stay_in_order_where_one_ends_and_the_next_begins():
    points = placed(np.concatenate((np.linspace(42, 100, 59), np.linspace(130, 198, 69)[::-1])))
    piece = np.repeat([0, 1], [59, 69])
    found = to_tips(line(points, piece), scene(), np.array([True, True]), np.array([False, False]))
    for number, tip in enumerate(TIPS[:, 0]):
        own = found.point_px[found.piece == number]
        np.testing.assert_allclose(own[0], placed([tip])[0], atol=0.4)
        np.testing.assert_array_equal(own[-1], points[piece == number][-1])


@pytest.mark.parametrize("turn", [0.0, 1.1])
def test_a_line_that_is_short_goes_on_to_the_tip_and_no_farther(turn):
    short = line(placed(np.linspace(TIPS[0, 0] + 15, TIPS[1, 0] - 17, 130), turn))
    found = gone_on(short, scene(turn), np.array([24.0]), np.array([24.0]))
    np.testing.assert_allclose(found.point_px[[0, -1]], placed(TIPS[:, 0], turn), atol=0.6)
    step = np.linalg.norm(np.diff(found.point_px, axis=0), axis=1)
    assert 0 < step.min() <= step.max() < 2.5
    assert len(found.piece) == len(found.width_px) == len(found.deviation_px) == len(found.point_px)


def test_only_the_end_that_may_go_on_does_and_as_far_as_it_may():
    points = placed(np.linspace(TIPS[0, 0] + 15, TIPS[1, 0] - 17, 130))
    found = gone_on(line(points), scene(), np.array([0.0]), np.array([6.0]))
    np.testing.assert_array_equal(found.point_px[0], points[0])
    assert found.point_px[-1, 0] == pytest.approx(points[-1, 0] + 6, abs=0.1)


def test_a_line_goes_on_to_the_border_of_the_image_and_no_farther():
    found = gone_on(line(placed(np.linspace(80, 180, 101))), scene()[:, :190], np.array([0.0]), np.array([24.0]))
    assert 186 < found.point_px[:, 0].max() <= 189


@pytest.mark.parametrize(
    "why", ["at the tip", "another colour", "dark on one side too", "little contrast", "another line"]
)
def test_a_line_does_not_go_on(why):
    points = placed(np.linspace(80, TIPS[1, 0] - (1 if why == "at the tip" else 30), 90))
    image, lines = scene(), line(points)
    if why == "another colour":
        image[:, int(points[-1, 0]) + 2 :] = (120, 120, 120)
    if why == "little contrast":
        image = np.rint(THREAD + 0.15 * (image - np.array(THREAD))).astype(np.uint8)
    if why == "dark on one side too":
        image[50:, int(points[-1, 0]) + 2 :] = THREAD
    if why == "another line":
        both = np.concatenate((points, points[-1] + np.column_stack((np.arange(9.0, 20), np.zeros(11)))))
        lines = line(both, np.repeat([0, 1], [len(points), 11]))
    may = np.zeros(lines.piece[-1] + 1)
    may[0] = 24.0
    found = gone_on(lines, image, 0 * may, may)
    np.testing.assert_array_equal(found.point_px, lines.point_px)
