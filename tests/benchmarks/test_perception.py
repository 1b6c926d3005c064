"""The perception benchmark counts what is found, missed and false."""

import numpy as np
import pytest

from benchmarks.perception import shares
from schemas.messages import Centrelines

ONE = np.ones


def line(points):
    count = len(points)
    return Centrelines(points, np.zeros(count, np.int64), 4 * ONE(count), 0.1 * ONE(count))


def straight(first, last, row):
    u = np.arange(first, last)
    return np.column_stack((u, np.full(len(u), float(row))))


TRUTH = np.column_stack((np.linspace(0, 100, 1001), np.full(1001, 50.0)))


def test_places_count_by_pixels_found_within_two_pixels_and_visible():
    visible = TRUTH[:, 0] < 60
    found = shares(line(np.concatenate((straight(0, 40, 51), straight(70, 80, 50)))), TRUTH, visible)
    # the last place that is found lies at 39, within 2 px of 40 and of what lies up to 40.7
    assert found.true == pytest.approx(60, abs=1)
    assert found.found == pytest.approx(41, abs=1)
    assert (found.right, found.given) == (40, 50)
    np.testing.assert_allclose(found.apart_px, 1.0)
