"""Glints are filled; what only looks like one, beside crossings, in loops and at a tool's edge, is left alone."""

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from agents.perception.centrelines import thread_centrelines
from agents.perception.centrelines.glints import without_glints

WIDTH = 3


def drawn(curve, width, mask=None):
    mask = np.zeros((240, 320), np.uint8) if mask is None else mask
    cv2.polylines(mask, [np.rint(curve * 16).astype(np.int32)], False, 255, width, cv2.LINE_8, 4)
    return mask


def arc(centre, radius, begin_deg, end_deg):
    angle = np.radians(np.linspace(begin_deg, end_deg, 100))
    return np.column_stack((centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)))


def test_a_glint_beside_the_middle_does_not_move_it():
    middle = arc((160, 170), 80, -160, -20)
    strand = drawn(middle, 7)
    mask = np.where(drawn(arc((160, 170), 81.5, -110, -70), 2) > 0, np.uint8(0), strand)
    assert (mask < strand).any()
    filled, _ = without_glints(mask > 0)
    assert (filled == (strand > 0)).all()
    found = thread_centrelines(np.full((240, 320, 3), 90, np.uint8), mask)
    assert found.piece.max() == 0
    apart, _ = cKDTree(found.point_px).query(middle[10:-10])
    assert np.max(apart) < 1.0


@pytest.mark.parametrize("cut", [3, 12])
def test_a_crossing_cut_off_by_a_tool_is_no_fold(cut):
    mask = drawn(np.array([[20.0, 80], [300, 160]]), WIDTH, drawn(np.array([[20.0, 160], [300, 80]]), WIDTH))
    mask[:, : 160 - cut] = 0
    found = thread_centrelines(np.full((240, 320, 3), 90, np.uint8), mask)
    above, below = (set(found.piece[beyond]) for beyond in (found.point_px[:, 1] < 110, found.point_px[:, 1] > 130))
    assert above
    assert below
    assert not above & below
