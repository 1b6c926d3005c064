"""Short pieces of the right image that the left one does not show keep no thread apart."""

import numpy as np
import pytest

from agents.reconstruction.refined.joined import joined
from agents.reconstruction.refined.spurs import LONGEST_WIDTHS, without_spurs
from schemas.messages import Centrelines
from shared.disparities import disparities

WIDTH, THICK, DISPARITY = 960, 4.0, 50.0
THREAD = (300, 60), (520, 400)
FLAT, BEYOND = ((530, 404), (600, 404)), ((608, 404), (640, 404))


def lines(*ways, shift=0.0):
    """Straight pieces with points a pixel apart."""
    parts = []
    for start, end in ways:
        t = np.linspace(0.0, 1.0, round(np.hypot(end[0] - start[0], end[1] - start[1])) + 1)[:, None]
        parts.append((1 - t) * start + t * np.array(end) - (shift, 0.0))
    point = np.concatenate(parts)
    piece = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return Centrelines(point, piece, np.full(len(point), THICK), np.full(len(point), 0.1))


def kept(way, others=(THREAD,)):
    """Whether a right piece stays, drawn where the left image would show it."""
    found = without_spurs(lines(*others), lines(*others, way, shift=DISPARITY), WIDTH, disparities(WIDTH))
    np.testing.assert_array_equal(found.point_px[found.piece == 0], lines(THREAD, shift=DISPARITY).point_px)
    return bool((found.piece == len(others)).any())


def test_a_short_piece_that_the_left_image_does_not_show_goes():
    assert not kept(((700, 200), (712, 220)))


@pytest.mark.parametrize("rows", [0, 3], ids=["rows in line", "rows apart"])
def test_a_short_piece_that_the_left_image_shows_stays(rows):
    left = lines(THREAD, ((700, 200), (712, 220)))
    right = lines(THREAD, ((700, 200 + rows), (712, 220 + rows)), shift=DISPARITY)
    assert (without_spurs(left, right, WIDTH, disparities(WIDTH)).piece == 1).any()


def test_a_longer_piece_stays():
    length = LONGEST_WIDTHS * THICK
    assert not kept(((700, 200), (700, 200 + length - 3)))
    assert kept(((700, 200), (700, 200 + length + 3)))


def test_what_lies_beyond_the_left_image_stays():
    assert kept(((WIDTH + 20, 200), (WIDTH + 20, 215)))
    assert kept(((WIDTH - 20, 200), (WIDTH - 20, 215)))
    assert not kept(((WIDTH - 60, 200), (WIDTH - 60, 215)))


def test_where_both_images_show_nothing_in_the_same_rows_all_pieces_stay():
    left, right = lines(((300, 60), (400, 100))), lines(((300, 200), (420, 300)), ((500, 400), (510, 410)))
    assert without_spurs(left, right, WIDTH, disparities(WIDTH)) is right


@pytest.mark.parametrize("eye", ["left", "right"])
def test_without_lines_there_is_nothing_to_take_away(eye):
    some, none = lines(THREAD), lines(THREAD)
    none = Centrelines(none.point_px[:0], none.piece[:0], none.width_px[:0], none.deviation_px[:0])
    found = without_spurs(*((none, some) if eye == "left" else (some, none)), WIDTH, disparities(WIDTH))
    assert len(found.piece) == (len(some.piece) if eye == "left" else 0)


def test_thread_beyond_a_gap_is_one_with_the_rest_though_a_glint_touches_it():
    left = lines(THREAD, (FLAT[0], BEYOND[1]))
    right = lines(THREAD, FLAT, BEYOND, ((606, 398), (602, 380)), shift=DISPARITY)
    assert len(np.unique(joined(right).piece)) == 4
    assert len(np.unique(joined(without_spurs(left, right, WIDTH, disparities(WIDTH))).piece)) == 2
