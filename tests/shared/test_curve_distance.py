import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from shared.curve_distance import (
    curve_distance,
    discrete_frechet,
    distances_to_polyline,
    normal_errors,
    reprojection_px,
)

POINTS = arrays(np.float64, st.tuples(st.integers(1, 12), st.just(2)), elements=st.floats(-10, 10))


def line(count, offset=0.0):
    return np.column_stack((np.linspace(0, 100, count), np.full(count, offset), np.zeros(count)))


def frechet_by_recursion(a, b):
    """The definition of Eiter and Mannila, entry by entry."""
    table = np.empty((len(a), len(b)))
    for i, p in enumerate(a):
        for j, q in enumerate(b):
            steps = [table[x, y] for x, y in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if x >= 0 and y >= 0]
            table[i, j] = max(np.linalg.norm(p - q), min(steps, default=0.0))
    return table[-1, -1]


def test_parallel_lines_are_their_offset_apart_in_every_measure_and_a_curve_is_none_from_itself_walked_backwards():
    apart = curve_distance(line(501), line(501, offset=2.0))
    assert [apart.mean, apart.percentile_95, apart.maximum, apart.frechet] == pytest.approx([2.0] * 4)
    curve = np.random.default_rng(0).normal(size=(300, 3)).cumsum(axis=0)
    same = curve_distance(curve, curve[::-1])
    assert (same.mean, same.maximum, same.frechet) == (0.0, 0.0, 0.0)


def test_ends_are_compared_in_the_direction_that_fits():
    shifted = line(200)[::-1] + np.array([0.0, 3.0, 4.0])
    assert curve_distance(shifted, line(500)).ends == pytest.approx(5.0)


@given(arrays(np.float64, (7, 2), elements=st.floats(-10, 10)), st.floats(0.01, 0.99))
def test_a_place_on_a_piece_of_a_polyline_is_at_most_as_far_as_its_nearest_corner(points, share):
    polyline, place = line(8)[:, :2] + [0.0, 1.0], points
    exact = np.hypot(np.clip(np.maximum(-place[:, 0], place[:, 0] - 100.0), 0, None), place[:, 1] - 1.0)
    assert distances_to_polyline(place, polyline) == pytest.approx(exact)
    between = (1 - share) * polyline[3] + share * polyline[4]
    assert distances_to_polyline(between[None], polyline)[0] == pytest.approx(0.0, abs=1e-12)


def test_a_short_curve_is_far_from_the_missing_part_of_a_long_one():
    whole, half = line(1001), line(1001)[:501]
    apart = curve_distance(half, whole)
    assert apart.maximum == pytest.approx(50.0)
    assert apart.mean == pytest.approx(0.5 * (0.5 * 25.0), rel=0.01)


def test_the_wrong_order_shows_in_frechet_though_every_place_is_visited():
    curve = line(300)
    shuffled = np.concatenate((curve[100:200], curve[:100], curve[200:]))
    apart = curve_distance(shuffled, curve)
    assert apart.mean == pytest.approx(0.0, abs=1e-12)
    assert apart.frechet > 30.0


@settings(max_examples=20)
@given(POINTS, POINTS)
def test_frechet_agrees_with_its_definition_both_ways(a, b):
    found = discrete_frechet(a, b)
    assert found == pytest.approx(frechet_by_recursion(a, b))
    assert found == pytest.approx(discrete_frechet(b, a))


def test_reprojection_counts_both_ways_and_leaves_out_what_is_not_in_the_image():
    segmented = np.zeros((40, 60), bool)
    segmented[20, 10:50] = True
    curve = np.column_stack((np.linspace(-20, 29, 50), np.full(50, 22.0)))
    to_pixels, to_curve = reprojection_px(curve, segmented)
    assert len(to_pixels) == 30
    assert to_pixels.min() == pytest.approx(2.0)
    assert to_curve.max() == pytest.approx(np.hypot(20.0, 2.0))
    nothing = np.zeros((40, 60), bool)
    assert [len(distances) for distances in reprojection_px(np.full((5, 2), 10.0), nothing)] == [0, 0]


def test_ellipses_of_the_errors_own_covariance_hold_the_truth_in_95_of_100_places():
    random = np.random.default_rng(3)
    truth = line(20_001)
    covariance = np.diag([4.0, 0.3, 0.02])
    places = truth[random.integers(2000, 18_000, 4000)]
    points = places + random.multivariate_normal(np.zeros(3), covariance, len(places))
    tangents = np.tile([2.0, 0.0, 0.0], (len(points), 1))
    errors = normal_errors(points, tangents, np.tile(covariance, (len(points), 1, 1)), truth)
    assert errors.inside.mean() == pytest.approx(0.95, abs=0.015)
    # the expected log density of a normal variable in two dimensions is −1 − log 2π − ½ log det
    entropy = 1 + np.log(2 * np.pi) + 0.5 * np.log(0.3 * 0.02)
    assert -errors.log_likelihood.mean() == pytest.approx(entropy, abs=0.05)
    off = normal_errors(line(50, 1.0), tangents[:50], np.tile(np.eye(3) * 0.1**2, (50, 1, 1)), line(5001))
    assert not off.inside.any()
