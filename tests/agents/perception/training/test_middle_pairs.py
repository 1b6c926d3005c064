"""Profiles of both eyes at the same places: what they err apart, in mirrors too, and how much of it is told."""

from dataclasses import replace

import numpy as np
import pytest

from agents.perception.centrelines.learned import own_weights
from agents.perception.training.middle_drawn import drawn_view
from agents.perception.training.middle_pairs import LEFT, RIGHT, explained, features, pair_profiles


@pytest.fixture(scope="module")
def left():
    view = drawn_view(np.random.default_rng(83))
    place = 0.1 * np.arange(len(view.width_px), dtype=np.float32)
    return replace(view, name="scene_left", along_mm=place)


def turned(view):
    """The same as the right eye's, followed from its other end."""
    return replace(
        view,
        name="scene_right",
        along_mm=view.along_mm[::-1],
        normal=-view.normal[::-1],
        width_px=view.width_px[::-1],
        colour=view.colour[::-1, ::-1],
        offset_px=-view.offset_px[::-1],
        known=view.known[::-1],
    )


def test_eyes_that_see_the_same_err_nothing_apart_whichever_way_their_points_run(left):
    (pair,) = pair_profiles([left, turned(left)], own_weights())
    # the network hardly minds which end it begins at, and what both eyes see is the same to a grey level
    assert np.median(np.abs(pair.apart_px)) < 0.03
    assert np.median(np.abs(pair.seen[LEFT] - pair.seen[RIGHT])) < 0.02


def test_a_middle_that_one_eye_misjudges_is_apart_by_as_much_towards_the_side_it_lies_on(left):
    right = turned(left)
    (pair,) = pair_profiles([left, right], own_weights())
    (aside,) = pair_profiles([left, replace(right, offset_px=right.offset_px + 0.1)], own_weights())
    # the right normal points the other way
    np.testing.assert_allclose(aside.apart_px - pair.apart_px, 0.1, atol=1e-5)


def test_a_mirror_turns_what_is_to_be_said_with_what_is_shown_and_twice_it_is_nothing(left):
    (pair,) = pair_profiles([left, turned(left)], own_weights())
    shown, apart = features(pair)
    other, mirrored = features(pair, mirrored=True)
    np.testing.assert_array_equal(mirrored, -apart)
    again = replace(
        pair, seen=pair.seen[:, :, ::-1], offset_px=-pair.offset_px, normal=-pair.normal, apart_px=-pair.apart_px
    )
    np.testing.assert_array_equal(features(again)[0], other)
    np.testing.assert_array_equal(features(again, mirrored=True)[0], shown)


def test_eyes_that_change_places_in_a_mirror_beside_the_scene_err_the_other_way(left):
    (pair,) = pair_profiles([left, turned(left)], own_weights())
    exchanged = replace(
        pair,
        seen=pair.seen[::-1],
        offset_px=pair.offset_px[::-1],
        log_deviation=pair.log_deviation[::-1],
        normal=pair.normal * np.array([-1, 1], np.float32),
        apart_px=-pair.apart_px,
    )
    for part, same in zip(features(pair, exchanged=True), features(exchanged), strict=True):
        np.testing.assert_array_equal(part, same)


def test_half_of_an_error_told_is_three_quarters_of_its_variance(left):
    (pair,) = pair_profiles([left, turned(left)], own_weights())
    pair = replace(pair, apart_px=np.full_like(pair.apart_px, 0.2))
    share, before, after = explained([pair], [0.5 * pair.apart_px])
    assert share == pytest.approx(0.75)
    assert after == pytest.approx(before / 2)


def test_what_is_told_where_the_thread_runs_along_the_row_counts_for_nothing(left):
    (pair,) = pair_profiles([left, turned(left)], own_weights())
    along = np.arange(len(pair.apart_px)) < len(pair.apart_px) // 2
    normal = np.where(along[:, None], [0, 1], [1, 0]).astype(np.float32)
    pair = replace(pair, normal=normal, apart_px=np.full_like(pair.apart_px, 0.2))
    told = np.where(along, 9.0, 0.2)
    # a window of points about the boundary holds both kinds
    inside = np.abs(np.arange(len(along)) - len(along) // 2) > 20
    assert explained([pair], [np.where(inside, told, 0.2)])[0] == pytest.approx(1)
