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


ZIGZAG = np.column_stack((np.linspace(300, 600, 4000), 200 + 60 * np.sin(np.linspace(0, 60, 4000))))


LEVEL = np.column_stack((np.linspace(300, 500, 200), np.full(200, 200.0)))


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


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ([wave(400), wave(430)], [moved(wave(400), 60.0), moved(wave(430), 60.0)]),
        ([wave(400), wave(430)], [moved(wave(400), 60.0)]),
        ([wave(400)], [moved(wave(400), -20.0)]),
        ([wave(400)], [moved(wave(400), 0.25 * WIDTH)]),
        ([LEVEL], [moved(LEVEL, 30.0)]),
        ([ZIGZAG], [moved(ZIGZAG, 30.0)]),
        ([wave(400, 100, 120)], [moved(wave(400, 100, 120), 30.0)]),
    ],
    ids=[
        "two strands in the same rows",
        "a strand beside the one that both eyes see",
        "behind infinity",
        "too near",
        "along the rows alone",
        "a zigzag that may be any other part of itself",
        "too short",
    ],
)
def test_nothing_is_said_where_it_may_be_others(left, right):
    assert same_places(lines(*left), lines(*right), disparities(WIDTH)) is None


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


def test_along_the_rows_nothing_is_said_of_what_the_right_eye_does_not_see():
    left, right = along_the_rows(right_end=400)
    at = left.point_px[places_of(left, right).left_at]
    assert 380 < at[:, 0].max() <= 401


def test_a_thread_across_the_rows_is_the_same_all_along_whichever_end_it_begins_at():
    curve = wave(400)
    left = lines(curve)
    for right in (lines(moved(curve, slope(curve))), lines(moved(curve, slope(curve))[::-1])):
        places = places_of(left, right)
        assert 0.95 * len(left.piece) / 8 <= len(places.left_at) <= len(left.piece) / 8 + 2
        assert len(np.unique(places.left_at)) == len(places.left_at)
        assert len(places.stretches.first) == 1
        off, rows = errors_px(left, right, places, slope)
        assert off.max() < 0.02
        assert rows.max() < 1e-9
        assert ((places.left_normal * places.right_normal).sum(axis=1) > 0.99).all()


def test_along_the_rows_the_disparity_goes_on_from_where_the_thread_crosses_them_as_another_stretch():
    left, right = along_the_rows()
    places = places_of(left, right)
    off, rows = errors_px(left, right, places, lambda at: np.full(len(at), 30.0))
    at_u = left.point_px[places.left_at, 0]
    assert (at_u > 310).sum() >= 0.9 * 190 / 8
    assert off[at_u > 310].max() < 1.0
    assert rows.max() < 0.1
    assert len(places.stretches.first) == 2
    assert set(places.stretches.number[at_u > 305]) == {1}
    assert set(places.stretches.number[at_u <= 305][:-1]) == {0}
    np.testing.assert_array_equal(places.certain, places.stretches.number == 0)
