"""The pictures of a calibration's report: corners and what is left of them, what lacks corners, and rows."""

import numpy as np
import pytest

from agents.cli.calibrate.pictures import (
    ARROW,
    CORNER,
    LACKING,
    LARGER,
    ROW,
    SEEN,
    WIDTH_PX,
    rectified_rows,
    where_seen,
    with_residuals,
)
from shared.calibration.estimation.board import Board, corners_of
from tests.rigs.boards import endoscope, rendered, standings

HEIGHT_PX = WIDTH_PX // 2
BLANK = np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)


def of_colour(picture, colour):
    """Where a picture has nearly a colour, (u, v)."""
    v, u = np.nonzero(np.abs(picture.astype(int) - colour).max(axis=2) < 60)
    return np.column_stack((u, v))


def test_what_is_left_at_a_corner_is_an_arrow_forty_times_as_long_in_images_of_any_size():
    at, off = np.array([[100.0, 80.0]]), np.array([[2.0, 1.0]])
    arrow = of_colour(with_residuals(BLANK, at, off), ARROW)
    along = (arrow - at[0]) @ off[0] / np.linalg.norm(off[0])
    assert along.max() == pytest.approx(LARGER * np.linalg.norm(off[0]), abs=2)
    assert along.min() > -3
    twice_as_wide = with_residuals(np.zeros((2 * HEIGHT_PX, 2 * WIDTH_PX, 3), np.uint8), at, 0 * off)
    assert twice_as_wide.shape[:2] == (HEIGHT_PX, WIDTH_PX)
    np.testing.assert_allclose(of_colour(twice_as_wide, CORNER).mean(axis=0), at[0] / 2, atol=2)


def test_parts_with_too_few_corners_are_framed_and_all_corners_marked():
    cells = np.full((3, 4), 9)
    cells[0, 3] = 0
    places = np.array([[100.0, 100.0], [300.0, 200.0]])
    picture = where_seen(BLANK, places, cells)
    framed = of_colour(picture, LACKING)
    assert framed[:, 0].min() >= 0.75 * WIDTH_PX - 2
    assert framed[:, 1].max() <= HEIGHT_PX / 3 + 2
    for place in places:
        assert np.linalg.norm(of_colour(picture, SEEN) - place, axis=1).min() < 2


def test_rectified_pairs_show_the_same_things_on_the_same_rows(monkeypatch):
    board, camera = Board(9, 7, 3.5), endoscope(640, 360)
    left, right = rendered(camera, board, standings(1, board, 3)[0], 3)
    assert len(of_colour(rectified_rows(left, right, camera), ROW)) > 10 * WIDTH_PX
    monkeypatch.setattr("agents.cli.calibrate.pictures.ROWS", 0)
    halves = np.split(rectified_rows(left, right, camera), 2, axis=1)
    of_left, of_right = (corners_of(np.ascontiguousarray(half), board) for half in halves)
    assert of_left is not None and of_right is not None
    assert np.median(np.abs(of_left.px[:, 1] - of_right.px[:, 1])) < 0.5
