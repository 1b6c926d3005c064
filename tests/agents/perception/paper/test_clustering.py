"""Order and clusters of drawn threads whose disparity is known."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.perception.paper.clustering import Clusters, cluster_and_order

SHAPE = (120, 200)


def stroke(*points_uv, thickness=1, mask=None):
    mask = np.zeros(SHAPE, np.uint8) if mask is None else mask
    cv2.polylines(mask, [np.array(points_uv, np.int32)], False, 255, thickness)
    return mask


def clusters_of(mask, disparity=None, inlier=None) -> Clusters:
    pixel = np.argwhere(mask > 0)
    disparity = np.full(len(pixel), 10.0) if disparity is None else disparity(pixel[:, 1], pixel[:, 0])
    inlier = np.ones(len(pixel), bool) if inlier is None else inlier(pixel[:, 1], pixel[:, 0])
    return cluster_and_order(pixel, disparity, inlier, SHAPE)


def steps(found):
    return np.linalg.norm(np.diff(found.centroid_px, axis=0), axis=1)


def test_an_s_curve_is_followed_and_not_cut_across():
    u = np.linspace(20, 180, 200)
    curve = np.column_stack((u, 60 + 45 * np.sin((u - 20) / 160 * 2 * np.pi)))
    found = clusters_of(stroke(*np.round(curve).astype(int).tolist(), thickness=3))
    assert steps(found).max() < 8
    nearest = np.linalg.norm(found.centroid_px[:, None] - curve[None], axis=2)
    assert nearest.min(axis=1)[1:-1].max() < 1.5
    assert (np.diff(nearest.argmin(axis=1)) >= -1).all()


def test_two_pieces_are_joined_over_their_nearest_ends():
    left, right = [(20, 40), (90, 40)], [(105, 42), (180, 80)]
    found = clusters_of(stroke(*right, thickness=3, mask=stroke(*left, thickness=3)))
    joint = int(np.argmax(steps(found)))
    assert np.flatnonzero(np.diff(found.segment)).tolist() == [joint]
    np.testing.assert_allclose(found.centroid_px[joint], (90, 40), atol=3)
    np.testing.assert_allclose(found.centroid_px[joint + 1], (105, 42), atol=3)
    assert found.centroid_px[0, 0] < 25
    # pieces that fold back are strung end to end
    folded = stroke((30, 70), (150, 70), thickness=3, mask=stroke((150, 50), (30, 50), thickness=3))
    found = clusters_of(stroke((30, 30), (150, 30), thickness=3, mask=folded))
    assert len(np.unique(found.segment)) == 3
    assert steps(found).max() < 25


def test_ends_reach_the_farthest_pixels_at_the_depth_of_their_neighbour():
    found = clusters_of(
        stroke((20, 60), (180, 60)),
        disparity=lambda u, _: 20.0 + 0.1 * u,
        inlier=lambda u, _: (u > 50) & (u < 150),
    )
    np.testing.assert_array_equal(found.centroid_px[[0, -1]], [(20, 60), (180, 60)])
    assert found.disparity_px[0] == found.disparity_px[1] == pytest.approx(25.1, abs=0.3)
    assert found.disparity_px[-1] == found.disparity_px[-2] == pytest.approx(34.9, abs=0.3)


def test_without_inliers_there_are_no_clusters_and_a_single_pixel_is_one_without_ends():
    found = clusters_of(stroke((20, 60), (180, 60)), inlier=lambda u, _: u < 0)
    assert len(found.centroid_px) == len(found.half_size_px) == len(found.disparity_px) == len(found.segment) == 0
    found = clusters_of(stroke((40, 30), (40, 30)))
    np.testing.assert_array_equal(found.centroid_px, [(40, 30)])
    np.testing.assert_array_equal(found.half_size_px, [(0.5, 0.5)])


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), share=st.floats(0.0005, 0.1))
def test_any_scatter_of_pixels_gives_whole_segments_that_begin_left(seed, share):
    rng = np.random.default_rng(seed)
    mask = (rng.random(SHAPE) < share).astype(np.uint8)
    mask[0, 0] = 1
    found = clusters_of(mask, disparity=lambda u, _: 1.0 + u % 50, inlier=lambda u, _: rng.random(len(u)) < 0.7)
    if len(found.segment) == 0:
        return
    assert np.isfinite(found.centroid_px).all()
    assert (found.half_size_px >= 0.5).all()
    assert ((found.disparity_px >= 1.0) & (found.disparity_px <= 50.0)).all()
    assert set(np.diff(found.segment).tolist()) <= {0, 1}
    assert tuple(found.centroid_px[0]) <= tuple(found.centroid_px[-1])


@pytest.mark.parametrize("ends", [[(20, 30), (180, 90)], [(50, 20), (50, 100)]], ids=["across", "upright"])
def test_a_straight_thread_is_ordered_from_its_smaller_u_or_v(ends):
    for way in (ends, ends[::-1]):
        found = clusters_of(stroke(*way, thickness=1))
        np.testing.assert_allclose(found.centroid_px[[0, -1]], ends, atol=2.0)
        assert (np.diff(found.centroid_px[1:-1].sum(axis=1)) > 0).all()
        assert (found.segment == 0).all()


def test_a_clusters_disparity_is_that_of_the_mean_depth_of_its_inliers():
    # two disparities in equal parts all along: mean depth is that of the harmonic mean
    found = clusters_of(stroke((20, 60), (180, 60), thickness=8), disparity=lambda _, v: np.where(v % 2, 10.0, 30.0))
    assert np.median(found.disparity_px) == pytest.approx(15.0, abs=1.5)
    # outliers count for the shape, but not for the depth
    found = clusters_of(
        stroke((20, 60), (180, 60), thickness=4),
        disparity=lambda _, v: np.where(v == 60, 12.0, 70.0),
        inlier=lambda _, v: v == 60,
    )
    np.testing.assert_allclose(found.disparity_px, 12.0)
    assert (found.half_size_px[1:-1, 1] > 1).all()
