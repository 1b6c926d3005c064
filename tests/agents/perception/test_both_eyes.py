"""Where both eyes show the same places of thread, and what their middles are told to err apart there."""

import numpy as np
import pytest

from agents.perception.both_eyes import apart
from agents.perception.both_eyes.apart import drawn_together
from agents.perception.both_eyes.same_places import between, same_places
from agents.perception.centrelines.along import Pieces, evenly_spaced
from agents.perception.following.pair import follow_pair
from agents.perception.instances import as_sent
from agents.perception.observe import observe
from agents.perception.segmentation.network import segment_network
from agents.perception.segmenter_names import GIVEN_MASKS, NETWORK
from schemas.messages import Centrelines, FrameStamp
from shared.disparities import disparities, disparities_of
from tests.agents.perception.pictures import rendered

WIDTH = 960
APART_PX = 0.6


def lines(*curves):
    """Centrelines along some curves, each of (n, 2) points, a pixel apart."""
    rough = Pieces(np.repeat(np.arange(len(curves)), [len(curve) for curve in curves]))
    point, pieces = evenly_spaced(np.concatenate(curves).astype(float), rough, 1.0)
    n = len(point)
    return Centrelines(point, pieces.number, np.full(n, 5.0), np.full(n, 0.1))


def moved(curve, disparity):
    return np.column_stack((curve[:, 0] - disparity, curve[:, 1]))


def wave(u, top=100.0, bottom=300.0):
    v = np.linspace(top, bottom, 400)
    return np.column_stack((u + 20.0 * np.sin(v / 40), v))


def slope(point):
    return 30.0 + 0.02 * (point[:, 1] - 100)


ZIGZAG = np.column_stack((np.linspace(300, 600, 4000), 200 + 60 * np.sin(np.linspace(0, 60, 4000))))
LEVEL = np.column_stack((np.linspace(300, 500, 200), np.full(200, 200.0)))


def places_of(left, right):
    places = same_places(left, right, disparities(WIDTH))
    assert places is not None
    return places


def found_at(left, right, places):
    """The left points of places, and the disparity and the difference of rows at each."""
    at = left.point_px[places.left_at]
    disparity, rows = (at - between(right.point_px, places.right_at)).T
    return at, disparity, np.abs(rows)


def test_a_thread_across_the_rows_is_the_same_all_along_whichever_end_it_begins_at():
    curve = wave(400)
    left = lines(curve)
    for right in (lines(moved(curve, slope(curve))), lines(moved(curve, slope(curve))[::-1])):
        places = places_of(left, right)
        assert 0.95 * len(left.piece) / 8 <= len(places.left_at) <= len(left.piece) / 8 + 2
        assert len(np.unique(places.left_at)) == len(places.left_at)
        assert len(places.stretches.first) == 1
        at, disparity, rows = found_at(left, right, places)
        assert np.abs(disparity - slope(at)).max() < 0.02
        assert rows.max() < 1e-9
        assert ((places.left_normal * places.right_normal).sum(axis=1) > 0.99).all()


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


def test_along_the_rows_the_disparity_goes_on_as_another_stretch_as_far_as_the_right_eye_sees():
    """A thread that comes up from below and turns into the rows."""
    up = np.column_stack((np.full(150, 300.0), np.linspace(350, 200, 150)))
    curve = np.concatenate((up, LEVEL[1:]))
    left, right = lines(curve), lines(moved(curve, 30.0))
    places = places_of(left, right)
    at, disparity, rows = found_at(left, right, places)
    level = at[:, 0] > 310
    assert level.sum() >= 0.9 * 190 / 8
    assert np.abs(disparity[level] - 30.0).max() < 1.0
    assert rows.max() < 0.1
    assert len(places.stretches.first) == 2
    assert set(places.stretches.number[at[:, 0] > 305]) == {1}
    assert set(places.stretches.number[at[:, 0] <= 305][:-1]) == {0}
    np.testing.assert_array_equal(places.certain, places.stretches.number == 0)
    hidden = lines(moved(curve[curve[:, 0] <= 400], 30.0))
    assert 380 < left.point_px[places_of(left, hidden).left_at, 0].max() <= 401


IMAGES = tuple(np.random.default_rng(7).integers(0, 256, (2, 360, 480, 3), dtype=np.uint8))


@pytest.fixture
def always_apart(monkeypatch):
    """In place of what is learned: both eyes err apart by so much along the row, wherever they are seen."""
    monkeypatch.setattr(apart, "apart_px", lambda shown, *_: APART_PX * shown.normal[0, :, 0].astype(float))


@pytest.mark.usefixtures("always_apart")
def test_nothing_is_moved_over_a_plain_ground_nor_where_another_strand_or_one_eye_alone_is_seen():
    one, other = wave(240.0), wave(300.0)
    two = lines(one, other)
    assert drawn_together(IMAGES, (two, lines(moved(one, 70.0), moved(other, 70.0))))[0] is two
    left, plain = lines(one), np.full_like(IMAGES[0], 200)
    assert drawn_together((IMAGES[0], plain), (left, lines(moved(one, 40.0))))[0] is left
    drawn, _ = drawn_together(IMAGES, (left, lines(moved(one[one[:, 1] > 200], 40.0))))
    move = np.abs(drawn.point_px - left.point_px).max(axis=1)
    assert move[left.point_px[:, 1] <= 200].max() == 0
    assert move[left.point_px[:, 1] > 220].max() > 0.05


def looked_at(segmenter):
    camera, pair = rendered("medium", 32)
    left, right = pair.left_bgr, pair.right_bgr
    stamp = FrameStamp(3, 10, 11, "made up")
    return observe(stamp, camera, left, right, segment_network(left), segment_network(right), segmenter, matching=False)


def followed(observed):
    camera, pair = rendered("medium", 32)
    found = follow_pair(FrameStamp(4, 12, 13, "made up"), camera, (pair.left_bgr, pair.right_bgr), as_sent(observed))
    assert found is not None
    return found.observed


def steep_disparity_px(observed):
    """Of the places that both eyes show, where the thread runs across the rows."""
    left, right = observed.centrelines_left, observed.centrelines_right
    places = same_places(left, right, disparities_of(observed))
    assert places is not None
    steep = np.abs(places.left_normal[:, 0]) > 0.8
    at, disparity, _ = found_at(left, right, places)
    return at[steep], disparity[steep]


def by_how_much(one, other):
    """What the first's disparity is more than the second's, at the same places, in general."""
    (at, disparity), (there, before) = steep_disparity_px(one), steep_disparity_px(other)
    away = np.linalg.norm(at[:, None] - there, axis=2)
    near = away.min(axis=1) < 4
    assert near.sum() > 15
    return np.median(disparity[near] - before[away.argmin(axis=1)][near])


@pytest.mark.slow
@pytest.mark.usefixtures("always_apart")
def test_a_frame_that_is_looked_at_and_one_that_is_followed_are_drawn_alike():
    masks_given, looked = looked_at(GIVEN_MASKS), looked_at(NETWORK)
    assert by_how_much(looked, masks_given) == pytest.approx(0.8 * APART_PX, abs=0.15)
    # nothing adds up from frame to frame, and nothing leaps
    once = followed(looked)
    assert by_how_much(once, looked) == pytest.approx(0, abs=0.05)
    assert by_how_much(followed(once), once) == pytest.approx(0, abs=0.02)
