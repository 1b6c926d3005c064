"""Pieces that are told by their pixels alone."""

import cv2
import numpy as np

from agents.perception.segmentation.connected import extents, of_pixels


def test_pieces_reach_as_far_as_opencv_says():
    mask = np.random.default_rng(5).random((40, 60)) < 0.3
    count, labelled, boxes, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    pixel = np.flatnonzero(mask)
    found = extents(labelled.ravel()[pixel], pixel, mask.shape[1], count)
    sides = boxes[1:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    np.testing.assert_allclose(found[1:], np.hypot(*sides.T))
    assert found[0] == 0


def test_a_mask_holds_the_pixels_that_it_is_told():
    mask = np.eye(7, 9, dtype=bool)
    np.testing.assert_array_equal(of_pixels(np.flatnonzero(mask), mask.shape), mask)
