"""Boards in rendered images: their corners are where the camera projects them, of any board, whole or in part."""

import cv2
import numpy as np
import pytest

from shared.calibration import CalibrationError
from shared.calibration.estimation.board import Board, Corners, alike, corners_of
from shared.calibration.estimation.coverage import NoView, View, shared_view, view_of
from shared.calibration.estimation.estimate import rms
from shared.calibration.estimation.projection import residuals_px
from shared.rigid_transforms import exp_so3, transform
from tests.rigs.boards import endoscope, rendered, standings

CAMERA = endoscope(640, 360)
CHESSBOARD = Board(9, 7, 3.5)
CHARUCO = Board(9, 7, 3.5, 2.6)


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO], ids=["chessboard", "charuco"])
def test_corners_are_where_the_camera_projects_them(board):
    (T,) = standings(1, board, 3)
    view = view_of("one", *rendered(CAMERA, board, T, 3), board)
    assert isinstance(view, View)
    assert len(view.number) > 0.85 * len(board.points)
    # a chessboard may be numbered from its other end
    turned = View("turned", view.number, view.left[::-1], view.right[::-1])
    ways = (view,) if board.marker else (view, turned)
    assert min(max(map(rms, residuals_px(CAMERA, one, board, T))) for one in ways) < 0.25


def test_a_charuco_board_is_found_in_part_and_a_chessboard_is_not_and_it_is_said_in_which_image():
    T = transform(exp_so3(np.array([0.1, -0.2, 0.05])), np.array([4.0, -33.0, 75.0]))
    assert isinstance(view_of("one", *rendered(CAMERA, CHESSBOARD, T, 0), CHESSBOARD), NoView)
    left, right = rendered(CAMERA, CHARUCO, T, 0)
    view = view_of("one", left, right, CHARUCO)
    assert isinstance(view, View) and 8 <= len(view.number) < len(CHARUCO.points)
    assert rms(residuals_px(CAMERA, view, CHARUCO, T)[0]) < 0.2
    nothing = view_of("one", left, np.full_like(right, 90), CHARUCO)
    assert isinstance(nothing, NoView) and "not found in the right image" in nothing.reason
    grey, colour = corners_of(left, CHARUCO), corners_of(cv2.cvtColor(left, cv2.COLOR_GRAY2BGR), CHARUCO)
    assert grey is not None and colour is not None
    np.testing.assert_allclose(grey.px, colour.px)


def test_the_right_corners_are_counted_from_the_same_end():
    px = np.random.default_rng(0).normal(size=(6, 2)).cumsum(axis=0)
    left = Corners(np.arange(6), px)
    for right in (px[::-1] + 5, px + 5):
        np.testing.assert_array_equal(alike(left, Corners(np.arange(6), right)).px, px + 5)
    many = Corners(np.arange(12), np.vstack((px, px + 20)))
    view = shared_view("one", many, Corners(many.number, many.px[::-1] + 5))
    assert isinstance(view, View)
    np.testing.assert_array_equal(view.right, view.left + 5)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ((2, 7, 3.0), "count squares, not corners"),
        ((9, 1000, 3.0), "count squares, not corners"),
        ((9, 7, 0.0), "a positive number"),
        ((9, 7, float("nan")), "a positive number"),
        ((9, 7, 3.0, 3.0), "smaller than the square"),
        ((9, 7, 3.0, 2.0, "DICT_NONE"), "no dictionary DICT_NONE"),
        ((14, 9, 3.0, 2.0, "DICT_4X4_50"), "has 63 markers, and DICT_4X4_50 only 50"),
    ],
)
def test_boards_that_cannot_be_are_refused(how, said):
    with pytest.raises(CalibrationError, match=said):
        Board(*how)


def test_neighbours_are_one_square_apart_and_the_last_marker_of_a_dictionary_may_be_needed():
    ends = CHESSBOARD.points[CHESSBOARD.neighbours]
    np.testing.assert_allclose(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), CHESSBOARD.square)
    assert len(ends) == 7 * 6 + 8 * 5
    assert Board(10, 10, 3.0, 2.0, "DICT_4X4_50").marker == 2.0
