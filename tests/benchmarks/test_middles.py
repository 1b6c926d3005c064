"""Middles moved towards the truth, and images that are changed by chance alone."""

import numpy as np
import pytest

from benchmarks.middles import compressed, moved, nearer, noisy
from schemas.messages import Centrelines

TRUE_PX = np.column_stack((np.linspace(100.0, 300.0, 50), np.full(50, 80.0)))


def lines(point_px):
    count = len(point_px)
    return Centrelines(point_px, np.zeros(count, np.int64), np.full(count, 5.0), np.full(count, 0.1))


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0])
def test_a_share_of_what_middles_err_is_left(share):
    u = np.linspace(110.0, 290.0, 40)
    off = 0.3 * np.sin(u)
    found = nearer(lines(np.column_stack((u, 80.0 + off))), TRUE_PX, share).point_px
    np.testing.assert_allclose(found[:, 1], 80.0 + share * off, atol=1e-9)
    np.testing.assert_allclose(found[:, 0], u, atol=0.05)


@pytest.mark.parametrize(("at_deg", "left"), [((0.0, 20.0), 0.3), ((20.0, 90.0), 0.0), ((0.0, 90.0), 0.0)])
def test_middles_are_true_at_the_angles_to_the_rows_that_are_asked_for(at_deg, left):
    along = np.linspace(0.0, 200.0, 50)[:, None]
    direction = np.array([np.cos(np.radians(30)), np.sin(np.radians(30))])
    across = np.array([-direction[1], direction[0]])
    beside = 150.0 + along[5:-5] * direction + 0.3 * across
    found = nearer(lines(beside), 150.0 + along * direction, 0.0, at_deg).point_px
    np.testing.assert_allclose((found - 150.0) @ across, left, atol=1e-9)


def test_points_of_something_else_stay():
    far = np.array([[150.0, 90.0], [200.0, 82.0]])
    np.testing.assert_array_equal(nearer(lines(far), TRUE_PX, 0.0).point_px, far)


@pytest.fixture
def image():
    """A soft dark strip down a grey image, with some noise."""
    u = np.arange(64.0)
    row = 150.0 - 90.0 * np.exp(-0.5 * ((u - 30.0) / 2.5) ** 2)
    noise = np.random.default_rng(3).normal(0, 1.0, (48, 64, 3))
    return np.clip(np.rint(row[None, :, None] + noise), 0, 255).astype(np.uint8)


def middle_px(image):
    dark = np.clip(140.0 - image.astype(np.float64).mean(axis=(0, 2)), 0, None)
    return float(dark @ np.arange(len(dark)) / dark.sum())


def test_an_image_is_moved_by_as_much_as_is_said(image):
    there, by_px = moved(image)
    assert middle_px(there) - middle_px(image) == pytest.approx(by_px, abs=0.03)


@pytest.mark.parametrize("change", [noisy, compressed])
def test_chance_moves_nothing_and_changes_pixels_by_some_levels(image, change):
    again, by_px = change(image)
    assert by_px == 0.0
    assert middle_px(again) == pytest.approx(middle_px(image), abs=0.05)
    assert 0.0 < np.abs(again.astype(int) - image).mean() < 3.0
