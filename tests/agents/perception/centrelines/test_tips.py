"""Centrelines end where the image shows the thread's tips, wherever the mask ended."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.perception.centrelines.tips import to_tips
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


@settings(max_examples=12)
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
