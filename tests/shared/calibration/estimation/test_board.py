"""Boards in rendered images: their corners are where the camera projects them, of any board, whole or in part."""

import cv2
import numpy as np
import pytest

from shared.calibration import CalibrationError
from shared.calibration.estimation.board import Board, Corners, alike, corners_of
from shared.calibration.estimation.estimate import residuals_px, rms
from shared.calibration.estimation.views import NoView, View, shared_view, view_of
from shared.rigid_transforms import exp_so3, transform
from tests.rigs.boards import endoscope, rendered, standings

CAMERA = endoscope(640, 360)
CHESSBOARD = Board(9, 7, 3.5)
CHARUCO = Board(9, 7, 3.5, 2.6)
both_boards = pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO], ids=["chessboard", "charuco"])


@both_boards
def test_corners_are_where_the_camera_projects_them(board):
    seed = 3
    (T,) = standings(1, board, seed)
    view = view_of("one", *rendered(CAMERA, board, T, seed), board)
    assert isinstance(view, View)
    assert len(view.number) > 0.85 * len(board.points)
    for residual in residuals_px(CAMERA, view, board, T):
        # a chessboard may be numbered from its other end
        assert rms(residual) < 0.25 or board.marker is None
    if board.marker is None:
        turned = View("turned", view.number, view.left[::-1], view.right[::-1])
        assert min(rms(residuals_px(CAMERA, v, board, T)[0]) for v in (view, turned)) < 0.25


def test_a_charuco_board_is_found_in_part_and_a_chessboard_is_not():
    R = exp_so3(np.array([0.1, -0.2, 0.05]))
    T = transform(R, np.array([4.0, -33.0, 75.0]))
    assert isinstance(view_of("one", *rendered(CAMERA, CHESSBOARD, T, 0), CHESSBOARD), NoView)
    view = view_of("one", *rendered(CAMERA, CHARUCO, T, 0), CHARUCO)
    assert isinstance(view, View) and 8 <= len(view.number) < len(CHARUCO.points)
    assert rms(residuals_px(CAMERA, view, CHARUCO, T)[0]) < 0.2


def test_an_image_without_a_board_says_which():
    left, right = rendered(CAMERA, CHARUCO, standings(1, CHARUCO, 5)[0], 5)
    view = view_of("one", left, np.full_like(right, 90), CHARUCO)
    assert isinstance(view, NoView) and "not found in the right image" in view.reason


def test_the_right_corners_are_counted_from_the_same_end():
    px = np.random.default_rng(0).normal(size=(6, 2)).cumsum(axis=0)
    left, turned = Corners(np.arange(6), px), Corners(np.arange(6), px[::-1] + 5)
    np.testing.assert_array_equal(alike(left, turned).px, px + 5)
    np.testing.assert_array_equal(alike(left, Corners(np.arange(6), px + 5)).px, px + 5)
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
    # the last marker of a dictionary may be needed
    assert Board(10, 10, 3.0, 2.0, "DICT_4X4_50").marker == 2.0


def test_neighbours_are_one_square_apart():
    ends = CHESSBOARD.points[CHESSBOARD.neighbours]
    np.testing.assert_allclose(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), CHESSBOARD.square)
    assert len(ends) == 7 * 6 + 8 * 5


def test_colour_images_are_taken_too():
    T = standings(1, CHARUCO, 3)[0]
    left, _ = rendered(CAMERA, CHARUCO, T, 3)
    grey, colour = corners_of(left, CHARUCO), corners_of(cv2.cvtColor(left, cv2.COLOR_GRAY2BGR), CHARUCO)
    assert grey is not None and colour is not None
    np.testing.assert_allclose(grey.px, colour.px)
