"""Centrelines of strips whose middle is known exactly, and of images that show no thread at all."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.perception.centrelines import thread_centrelines

GREY = np.full((120, 160, 3), 128, np.uint8)


def tube(polyline, radius, shape=(120, 160)):
    """Anti-aliased coverage of everything within `radius` of a polyline; symmetric about it by construction."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    distance = distance_to(np.column_stack((u.ravel(), v.ravel())).astype(float), polyline).reshape(shape)
    return np.rint(255 * np.clip(radius + 0.5 - distance, 0, min(1, 2 * radius))).astype(np.uint8)


def distance_to(points, polyline):
    best = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(polyline):
        d = b - a
        t = np.clip((points - a) @ d / (d @ d), 0, 1)
        best = np.minimum(best, np.linalg.norm(points - a - t[:, None] * d, axis=1))
    return best


@pytest.mark.parametrize("radius", [0.8, 1.5, 3.0, 5.0])
@pytest.mark.parametrize("slope", [0.0, 0.13, 0.5, 1.0])
def test_a_straight_thread_is_found_as_exactly_as_coverage_by_area_tells(radius, slope):
    line = np.array([[20.3, 20.7], [130.2, 20.7 + 80 * slope]])
    found = thread_centrelines(GREY, tube(line, radius))
    inner = (found.point_px[:, 0] > 30) & (found.point_px[:, 0] < 120)
    assert np.unique(found.piece).tolist() == [0]
    # an edge that cuts a pixel in half moves the pixel's share of the centroid by an eighth of a pixel
    assert distance_to(found.point_px[inner], line).max() < 0.125 / (2 * radius) + 0.03
    assert np.median(found.width_px) == pytest.approx(2 * radius, abs=0.3)


def test_an_image_without_thread_has_no_centreline():
    assert len(thread_centrelines(GREY, np.zeros((120, 160), np.uint8)).point_px) == 0


@pytest.mark.parametrize("level", [96, 255])
def test_an_image_full_of_thread_raises_nothing(level):
    thread_centrelines(GREY, np.full((120, 160), level, np.uint8))


@settings(max_examples=60, deadline=None)
@given(arrays(np.uint8, st.tuples(st.integers(1, 24), st.integers(1, 24)), elements=st.sampled_from([0, 95, 96, 255])))
def test_no_mask_raises_and_every_point_lies_in_the_image(coverage):
    found = thread_centrelines(np.zeros((*coverage.shape, 3), np.uint8), coverage)
    limit = np.array(coverage.shape[::-1]) - 1
    assert (found.point_px >= 0).all()
    assert (found.point_px <= limit).all()
