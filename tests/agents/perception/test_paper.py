"""Method `paper`: matches of threads of known disparity, distances along pixels, and clusters in their order."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.perception.paper import matching
from agents.perception.paper.clustering import cluster_and_order
from agents.perception.paper.matching import is_inlier, match_pixels

WIDTH = 160
LARGEST = 20
"""Of the disparities at this width, at which the window's radius and the peak's half width are 1 px."""
SHAPE = 120, 200


def cost_by_the_book(pair, pixel, disparity):
    """The sum over the window, term by term."""
    (left, right, segmented_left, segmented_right), total = pair, 0.0
    for r in range(max(0, pixel[0] - 1), min(left.shape[0], pixel[0] + 2)):
        for c in range(max(0, pixel[1] - 1), min(left.shape[1], pixel[1] + 2)):
            if not segmented_left[r, c]:
                continue
            if c - disparity >= 0 and segmented_right[r, c - disparity]:
                total += float(((left[r, c].astype(float) - right[r, c - disparity]) ** 2).sum())
            else:
                total += matching.SQUARE_OFF_THREAD
    return total


def test_costs_are_those_of_a_loop_over_windows():
    rng = np.random.default_rng(3)
    pair = *rng.integers(0, 256, (2, 12, WIDTH, 3), dtype=np.uint8), *(rng.random((2, 12, WIDTH)) < 0.15)
    matches = match_pixels(*pair)
    assert len(matches.pixel) > 100
    for pixel, disparity, (best, second) in zip(
        matches.pixel[::9], matches.disparity_px[::9], matches.cost[::9], strict=True
    ):
        costs = {d: cost_by_the_book(pair, pixel, d) for d in range(1, min(LARGEST, int(pixel[1])) + 1)}
        of_segmented = {d: cost for d, cost in costs.items() if pair[3][pixel[0], pixel[1] - d]}
        assert best == pytest.approx(min(of_segmented.values()), rel=1e-6)
        assert of_segmented[int(disparity)] == pytest.approx(best, rel=1e-6)
        # where no window touches the right thread the cost is the greatest, never less than what the loop says
        assert second >= min(cost for d, cost in costs.items() if abs(d - disparity) > 1) * (1 - 1e-6)


@given(best=st.floats(1e-3, 1e7), ratio=st.floats(0.0, 50.0))
def test_the_metric_asks_for_a_second_peak_six_and_a_half_times_the_first(best, ratio):
    e1, e2, e3, e4 = 8.0, 5.0, 0.8, 0.9
    printed = 1.0 / (1.0 + np.exp(-e1 * ((best * ratio - best) / (e2 * best) - e3))) > e4
    limit = 1 + e2 * (e3 + np.log(e4 / (1 - e4)) / e1)
    if abs(ratio - limit) > 1e-6:
        assert is_inlier(np.array([[best, best * ratio]]))[0] == printed == (ratio > limit)
    # a perfect match is kept only if nothing else is perfect
    assert is_inlier(np.array([[0.0, 10.0], [0.0, 0.0]])).tolist() == [True, False]


def strokes(*lines, thickness=3):
    mask = np.zeros(SHAPE, np.uint8)
    for points_uv in lines:
        cv2.polylines(mask, [np.array(points_uv, np.int32)], False, 255, thickness)
    return mask


def clusters_of(mask, disparity=lambda pixel: np.full(len(pixel), 10.0), inlier=lambda pixel: pixel[:, 0] >= 0):
    pixel = np.argwhere(mask > 0)
    return cluster_and_order(pixel, disparity(pixel), inlier(pixel), SHAPE)


def steps(found):
    return np.linalg.norm(np.diff(found.centroid_px, axis=0), axis=1)


def test_two_pieces_are_joined_over_their_nearest_ends():
    found = clusters_of(strokes([(20, 40), (90, 40)], [(105, 42), (180, 80)]))
    joint = int(np.argmax(steps(found)))
    assert np.flatnonzero(np.diff(found.segment)).tolist() == [joint]
    np.testing.assert_allclose(found.centroid_px[joint : joint + 2], [(90, 40), (105, 42)], atol=3)
    assert found.centroid_px[0, 0] < 25
    # pieces that fold back are strung end to end
    found = clusters_of(strokes([(30, 30), (150, 30)], [(150, 50), (30, 50)], [(30, 70), (150, 70)]))
    assert len(np.unique(found.segment)) == 3
    assert steps(found).max() < 25


def test_ends_reach_the_farthest_pixels_at_the_depth_of_their_neighbour():
    straight = strokes([(20, 60), (180, 60)], thickness=1)
    found = clusters_of(straight, lambda at: 20.0 + 0.1 * at[:, 1], lambda at: np.abs(at[:, 1] - 100) < 50)
    np.testing.assert_array_equal(found.centroid_px[[0, -1]], [(20, 60), (180, 60)])
    assert found.disparity_px[0] == found.disparity_px[1] == pytest.approx(25.1, abs=0.3)
    assert found.disparity_px[-1] == found.disparity_px[-2] == pytest.approx(34.9, abs=0.3)
    nothing = clusters_of(straight, inlier=lambda at: at[:, 0] < 0)
    assert len(nothing.centroid_px) == len(nothing.half_size_px) == len(nothing.disparity_px) == 0
    point = clusters_of(strokes([(40, 30), (40, 30)], thickness=1))
    np.testing.assert_array_equal(point.centroid_px, [(40, 30)])
    np.testing.assert_array_equal(point.half_size_px, [(0.5, 0.5)])


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), share=st.floats(0.0005, 0.1))
def test_any_scatter_of_pixels_gives_whole_segments_that_begin_left(seed, share):
    rng = np.random.default_rng(seed)
    mask = (rng.random(SHAPE) < share).astype(np.uint8)
    mask[0, 0] = 1
    found = clusters_of(mask, lambda at: 1.0 + at[:, 1] % 50, lambda at: rng.random(len(at)) < 0.7)
    if len(found.segment) == 0:
        return
    assert np.isfinite(found.centroid_px).all()
    assert (found.half_size_px >= 0.5).all()
    assert ((found.disparity_px >= 1.0) & (found.disparity_px <= 50.0)).all()
    assert set(np.diff(found.segment).tolist()) <= {0, 1}
    assert tuple(found.centroid_px[0]) <= tuple(found.centroid_px[-1])


def test_a_clusters_disparity_is_that_of_the_mean_depth_of_its_inliers():
    # two disparities in equal parts all along: mean depth is that of the harmonic mean
    found = clusters_of(strokes([(20, 60), (180, 60)], thickness=8), lambda at: np.where(at[:, 0] % 2, 10.0, 30.0))
    assert np.median(found.disparity_px) == pytest.approx(15.0, abs=1.5)
    # outliers count for the shape, but not for the depth
    wide = strokes([(20, 60), (180, 60)], thickness=4)
    found = clusters_of(wide, lambda at: np.where(at[:, 0] == 60, 12.0, 70.0), lambda at: at[:, 0] == 60)
    np.testing.assert_allclose(found.disparity_px, 12.0)
    assert (found.half_size_px[1:-1, 1] > 1).all()
