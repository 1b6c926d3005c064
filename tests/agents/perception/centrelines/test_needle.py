"""A thread with a needle at its end: wide, shining, and folded back beside the thread."""

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from agents.perception.centrelines import thread_centrelines
from agents.perception.centrelines.glints import without_glints

THREAD, NEEDLE = 3, 9


def drawn(curve, width, mask=None):
    mask = np.zeros((240, 320), np.uint8) if mask is None else mask
    cv2.polylines(mask, [np.rint(curve * 16).astype(np.int32)], False, 255, width, cv2.LINE_8, 4)
    return mask


def arc(centre, radius, begin_deg, end_deg):
    angle = np.radians(np.linspace(begin_deg, end_deg, 100))
    return np.column_stack((centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)))


def needle_on_thread():
    """Mask, the needle's middle, and a glint along it."""
    thread, needle = np.array([[20.0, 200], [160, 120]]), arc((160, 170), 50, -90, 60)
    mask = drawn(needle, NEEDLE, drawn(thread, THREAD))
    glint = drawn(arc((160, 170), 50, -60, 10), 3) > 0
    return np.where(glint, np.uint8(0), mask), needle, glint


def test_a_glint_along_a_needle_is_filled():
    mask, _, glint = needle_on_thread()
    filled, _ = without_glints(mask > 0)
    assert filled[glint].all()


def test_the_way_through_a_needle_runs_down_its_middle():
    mask, needle, _ = needle_on_thread()
    image = np.where(mask[:, :, None] > 0, np.uint8(60), np.uint8(250)).repeat(3, axis=2)
    found = thread_centrelines(image, mask)
    assert found.piece.max() == 0
    apart, _ = cKDTree(found.point_px).query(needle[20:90])
    assert np.percentile(apart, 90) < 1.5
    assert found.width_px.max() > 2 * np.median(found.width_px[:60])


@pytest.mark.parametrize("apart", [8, 12, 20])
def test_the_loop_of_a_thread_that_crosses_itself_stays_open(apart):
    along = np.linspace(0, 1, 200)
    one = np.column_stack((40 + 240 * along, 120 + apart / 2 * np.sin(2 * np.pi * along)))
    other = np.column_stack((40 + 240 * along, 120 - apart / 2 * np.sin(2 * np.pi * along)))
    mask = drawn(other, THREAD, drawn(one, THREAD)) > 0
    middle = [120, 100]
    assert not mask[tuple(middle)]
    filled, _ = without_glints(mask)
    assert not filled[tuple(middle)]


def test_a_thread_folded_back_beside_its_needle_is_one_piece():
    thread, needle = np.array([[50.0, 20], [40, 150]]), np.array([[44.0, 148], [120, 60]])
    mask = drawn(needle, 9, drawn(thread, THREAD))
    image = np.where(mask[:, :, None] > 0, np.uint8(60), np.uint8(250)).repeat(3, axis=2)
    assert thread_centrelines(image, mask).piece.max() == 0
