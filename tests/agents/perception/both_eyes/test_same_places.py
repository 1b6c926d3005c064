"""Places that both eyes' centrelines show alike: right where they are said, and none where they may be others."""

import numpy as np
import pytest

from agents.perception.both_eyes.same_places import between, same_places
from agents.perception.centrelines.along import Pieces, evenly_spaced
from schemas.messages import Centrelines
from shared.disparities import disparities

WIDTH = 960


def lines(*curves):
    """Centrelines along some curves, each of (n, 2) points, a pixel apart."""
    rough = Pieces(np.repeat(np.arange(len(curves)), [len(curve) for curve in curves]))
    point, pieces = evenly_spaced(np.concatenate(curves).astype(float), rough, 1.0)
    n = len(point)
    return Centrelines(point, pieces.number, np.full(n, 5.0), np.full(n, 0.1))


def moved(curve, disparity):
    return np.column_stack((curve[:, 0] - disparity, curve[:, 1]))


def wave(u, top=100.0, bottom=300.0, swing=20.0):
    v = np.linspace(top, bottom, 400)
    return np.column_stack((u + swing * np.sin(v / 40), v))


def u_turn(of_depth):
    """A thread that comes back along the same rows, one leg 120 rows longer than the other, in both eyes."""
    angle = np.linspace(np.pi, 0, 200)
    down = np.column_stack((np.full(300, 300.0), np.linspace(80, 380, 300)))
    turn = np.column_stack((340 + 40 * np.cos(angle), 380 + 40 * np.sin(angle)))
    up = np.column_stack((np.full(180, 380.0), np.linspace(380, 200, 180)))
    left = np.concatenate((down, turn[1:-1], up))
    return left, moved(left, of_depth(left))


def places_of(left, right):
    places = same_places(left, right, disparities(WIDTH))
    assert places is not None
    return places


def errors_px(left, right, places, disparity):
    """By how much each place's disparity differs from the true one, and its row from the left point's."""
    at_left, at_right = left.point_px[places.left_at], between(right.point_px, places.right_at)
    found = at_left - at_right
    return np.abs(found[:, 0] - disparity(at_left)), np.abs(found[:, 1])


def slope(point):
    return 30.0 + 0.02 * (point[:, 1] - 100)


def test_a_thread_across_the_rows_is_the_same_all_along():
    curve = wave(400)
    left, right = lines(curve), lines(moved(curve, slope(curve)))
    places = places_of(left, right)
    assert len(places.left_at) >= 0.95 * len(left.piece) / 8
    assert len(places.stretches.first) == 1
    off, rows = errors_px(left, right, places, slope)
    assert off.max() < 0.02
    assert rows.max() < 1e-9


def test_whichever_end_the_right_line_begins_at_normals_point_to_the_same_side():
    curve = wave(400)
    left, right = lines(curve), lines(moved(curve, 30.0))
    turned = lines(moved(curve, 30.0)[::-1])
    one, other = places_of(left, right), places_of(left, turned)
    assert ((other.left_normal * other.right_normal).sum(axis=1) > 0.99).all()
    both, first, second = np.intersect1d(one.left_at, other.left_at, return_indices=True)
    assert len(both) > 0.95 * len(one.left_at)
    np.testing.assert_allclose(one.right_normal[first], other.right_normal[second], atol=0.01)
    np.testing.assert_allclose(
        between(right.point_px, one.right_at[first]), between(turned.point_px, other.right_at[second]), atol=0.02
    )


def test_a_thread_that_comes_back_along_the_same_rows_is_known_from_where_one_leg_is_alone():
    left_px, right_px = u_turn(slope)
    left, right = lines(left_px), lines(right_px)
    places = places_of(left, right)
    off, _ = errors_px(left, right, places, slope)
    across = np.abs(places.left_normal[:, 0])
    assert off[across > 0.3].max() < 0.1
    assert off.max() < 0.6
    rows = left.point_px[places.left_at]
    alone, shared = (rows[:, 0] < 340) & (rows[:, 1] < 195), (rows[:, 0] < 340) & (rows[:, 1] > 205)
    assert alone.sum() > 10
    # the disparity goes on from there, and tells the legs apart
    assert shared.sum() > 12


def test_nothing_is_said_of_two_strands_in_the_same_rows_of_which_either_may_be_meant():
    first, second = wave(400), wave(430)
    left, right = lines(first, second), lines(moved(first, 60.0), moved(second, 60.0))
    assert same_places(left, right, disparities(WIDTH)) is None


def test_nothing_is_said_of_a_strand_that_the_right_eye_does_not_see_beside_one_that_it_does():
    first, second = wave(400), wave(430)
    assert same_places(lines(first, second), lines(moved(first, 60.0)), disparities(WIDTH)) is None
    # with the left one missing too there is nothing else that it can be
    assert same_places(lines(first), lines(moved(first, 60.0)), disparities(WIDTH)) is not None


@pytest.mark.parametrize("disparity", [-20.0, 0.25 * WIDTH])
def test_what_lies_at_no_disparity_that_can_be_is_not_the_same(disparity):
    curve = wave(400)
    assert same_places(lines(curve), lines(moved(curve, disparity)), disparities(WIDTH)) is None


def test_strands_that_cross_are_the_same_places_or_none():
    v = np.linspace(100, 400, 600)
    # the longer one is alone in the rows below, and is known upwards from there
    steep, slanted = (np.column_stack((u, v)) for u in (300 + 0 * v, 200 + (v - 100)))
    slanted = slanted[slanted[:, 1] < 260]
    left = lines(steep, slanted)
    right = lines(moved(steep, 30.0), moved(slanted, 34.0))
    places = places_of(left, right)
    found = left.point_px[places.left_at, 0] - between(right.point_px, places.right_at)[:, 0]
    true = np.where(left.piece[places.left_at] == 0, 30.0, 34.0)
    np.testing.assert_allclose(found, true, atol=0.1)


def along_the_rows(right_end=500):
    """A thread that comes up from below and turns into the rows; the right eye sees it as far as that."""
    up = np.column_stack((np.full(150, 300.0), np.linspace(350, 200, 150)))
    level = np.column_stack((np.linspace(301, 500, 200), np.full(200, 200.0)))
    curve = np.concatenate((up, level))
    return lines(curve), lines(moved(curve[curve[:, 0] <= right_end], 30.0))


def test_along_the_rows_the_disparity_goes_on_from_where_the_thread_crosses_them():
    left, right = along_the_rows()
    places = places_of(left, right)
    off, rows = errors_px(left, right, places, lambda at: np.full(len(at), 30.0))
    level = left.point_px[places.left_at, 0] > 310
    assert level.sum() >= 0.9 * 190 / 8
    assert off[level].max() < 1.0
    assert rows.max() < 0.1


def test_where_the_thread_turns_into_the_rows_another_stretch_begins():
    left, right = along_the_rows()
    stretches = places_of(left, right).stretches
    turned = left.point_px[places_of(left, right).left_at, 0] > 305
    assert len(stretches.first) == 2
    assert set(stretches.number[turned]) == {1}
    assert set(stretches.number[~turned][:-1]) == {0}
    np.testing.assert_array_equal(places_of(left, right).certain, stretches.number == 0)


def test_along_the_rows_nothing_is_said_of_what_the_right_eye_does_not_see():
    left, right = along_the_rows(right_end=400)
    at = left.point_px[places_of(left, right).left_at]
    assert 380 < at[:, 0].max() <= 401


def test_between_two_places_the_disparity_changes_evenly():
    bent = np.column_stack((np.linspace(0, 300, 900), np.full(900, 200.0)))
    down = np.linspace(1, 150, 150)
    ends = (np.column_stack((np.full(150, 0.0), 200 + down))[::-1], np.column_stack((np.full(150, 300.0), 200 + down)))
    curve = np.concatenate((ends[0], bent, ends[1]))
    curve[:, 0] += 400

    def disparity(at):
        return np.interp(at[:, 0], (400, 700), (30.0, 42.0))

    left, right = lines(curve), lines(moved(curve, disparity(curve)))
    places = places_of(left, right)
    level = left.point_px[places.left_at, 1] < 201
    assert level.sum() > 30
    off, _ = errors_px(left, right, places, disparity)
    assert off.max() < 1.0


def test_a_thread_along_the_rows_alone_has_no_places():
    level = np.column_stack((np.linspace(300, 500, 200), np.full(200, 200.0)))
    assert same_places(lines(level), lines(moved(level, 30.0)), disparities(WIDTH)) is None


def test_what_one_line_tells_counts_for_no_other():
    up = np.column_stack((np.full(150, 300.0), np.linspace(350, 200, 150)))
    level = np.column_stack((np.linspace(400, 600, 201), np.full(201, 100.0)))
    left, right = lines(up, level), lines(moved(up, 30.0), moved(level, 30.0))
    assert set(left.piece[places_of(left, right).left_at]) == {0}


def test_where_row_and_disparity_contradict_each_other_nothing_is_said():
    up = np.column_stack((np.full(150, 300.0), np.linspace(350, 200, 150)))
    slope_px = np.column_stack((np.linspace(301, 500, 200), 200 - 0.1 * np.arange(200)))
    below = slope_px + np.array((0.0, 2.5))
    left, right = lines(np.concatenate((up, slope_px))), lines(moved(np.concatenate((up, below)), 30.0))
    assert left.point_px[places_of(left, right).left_at, 0].max() < 330


def test_a_strand_some_pixels_beside_where_the_thread_is_to_be_is_not_the_same():
    left, right = along_the_rows(right_end=300)
    other = np.column_stack((np.linspace(301, 500, 200), np.full(200, 206.0)))
    right = lines(right.point_px, moved(other, 30.0))
    assert left.point_px[places_of(left, right).left_at, 0].max() < 310


def test_too_short_a_thread_and_none_at_all_say_nothing():
    short = wave(400, 100, 120)
    nothing = Centrelines(np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    assert same_places(lines(short), lines(moved(short, 30.0)), disparities(WIDTH)) is None
    assert same_places(nothing, lines(wave(400)), disparities(WIDTH)) is None
    assert same_places(lines(wave(400)), nothing, disparities(WIDTH)) is None


def test_no_left_point_has_two_places_and_most_have_none():
    left_px, right_px = u_turn(slope)
    left, right = lines(left_px), lines(right_px)
    places = places_of(left, right)
    assert len(np.unique(places.left_at)) == len(places.left_at) <= len(left.piece) / 8 + 2


def test_a_zigzag_as_fine_as_its_disparity_may_be_any_other_part_of_itself():
    zigzag = np.column_stack((np.linspace(300, 600, 4000), 200 + 60 * np.sin(np.linspace(0, 60, 4000))))
    assert same_places(lines(zigzag), lines(moved(zigzag, 30.0)), disparities(WIDTH)) is None
