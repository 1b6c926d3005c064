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


def arc(centre, radius, start, stop):
    angle = np.linspace(start, stop, 200)
    return np.column_stack((centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)))


def test_a_bend_is_not_cut_and_its_points_lie_a_pixel_apart():
    bend = arc((80.3, 60.6), 25.0, 0.3, 4.5)
    found = thread_centrelines(GREY, tube(bend, 3.5))
    from_centre = np.linalg.norm(found.point_px - [80.3, 60.6], axis=1)
    inner = slice(5, -5)
    assert np.abs(from_centre[inner] - 25.0).max() < 0.12
    assert abs(np.median(from_centre[inner]) - 25.0) < 0.02
    steps = np.linalg.norm(np.diff(found.point_px, axis=0), axis=1)
    assert steps.min() > 0.5
    assert steps.max() < 1.5


def test_a_crossing_leaves_four_pieces_that_keep_clear_of_it():
    one, other = np.array([[20.2, 30.0], [140.3, 90.4]]), np.array([[25.1, 95.3], [135.6, 22.7]])
    found = thread_centrelines(GREY, np.maximum(tube(one, 2.5), tube(other, 2.5)))
    assert np.unique(found.piece).tolist() == [0, 1, 2, 3]
    nearest = np.minimum(distance_to(found.point_px, one), distance_to(found.point_px, other))
    inside = (found.point_px[:, 0] > 30) & (found.point_px[:, 0] < 125)
    assert nearest[inside].max() < 0.5
    # the pieces of one strand are not joined with those of the other
    for piece in range(4):
        mine = found.point_px[found.piece == piece]
        assert min(np.median(distance_to(mine, one)), np.median(distance_to(mine, other))) < 0.03
    # near the crossing a point is worth less
    gap = np.linalg.norm(found.point_px - [80.0, 60.0], axis=1)
    assert found.deviation_px[gap < 10].min() > 2 * np.median(found.deviation_px)


@pytest.mark.slow
def test_rings_are_one_piece_and_bumps_and_pinholes_make_no_others():
    for radius, inside in ((30, 29), (9, 7)):
        found = thread_centrelines(GREY, tube(arc((80, 60), radius, 0, 2 * np.pi), 2.0))
        assert np.unique(found.piece).tolist() == [0]
        assert np.linalg.norm(found.point_px - [80, 60], axis=1).min() > inside
    thread = tube(np.array([[20.0, 60.0], [140.0, 60.0]]), 4.0)
    thread[59:61, 70:73] = 0
    with_bump = np.maximum(thread, tube(np.array([[80.0, 60.0], [80.0, 65.5]]), 1.0))
    for coverage in (thread, with_bump):
        assert np.unique(thread_centrelines(GREY, coverage).piece).tolist() == [0]


def test_a_glint_that_leaves_two_rails_is_filled_and_a_gap_between_two_strands_is_not():
    thread = tube(np.array([[15.0, 60.0], [145.0, 60.0]]), 4.0)
    glint = np.where(tube(np.array([[70.0, 59.0], [95.0, 59.0]]), 1.2) > 0, 0, thread).astype(np.uint8)
    assert np.unique(thread_centrelines(GREY, glint).piece).tolist() == [0]
    one = np.array([[15.0, 25.0], [50.0, 58.5], [80.0, 56.0], [110.0, 58.5], [145.0, 25.0]])
    other = one * [1, -1] + [0, 120]
    found = thread_centrelines(GREY, np.maximum(tube(one, 2.5), tube(other, 2.5)))
    inside = (found.point_px[:, 0] > 76) & (found.point_px[:, 0] < 84)
    assert set(np.unique(found.point_px[inside, 1] > 60)) == {False, True}
    assert distance_to(found.point_px[inside & (found.point_px[:, 1] < 60)], one).max() < 0.5


def lit_from_one_side(coverage, line):
    """A violet thread on pink ground, one half of it twice as bright as the other."""
    v, u = np.mgrid[: coverage.shape[0], : coverage.shape[1]]
    along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    side = (u - line[0, 0]) * along[1] - (v - line[0, 1]) * along[0]
    thread = np.array([110.0, 40.0, 80.0]) * (0.7 + 0.5 / (1 + np.exp(side[..., None])))
    share = coverage[..., None] / 255
    return np.rint(share * thread + (1 - share) * [150.0, 150.0, 210.0]).astype(np.uint8)


@pytest.mark.parametrize("shift", [0, 1])
def test_the_edges_in_the_image_correct_a_binary_mask(shift):
    line = np.array([[20.3, 40.7], [140.2, 62.1]])
    coverage = tube(line, 3.0)
    mask = np.where(np.roll(coverage, shift, axis=0) >= 128, 255, 0).astype(np.uint8)
    found = thread_centrelines(lit_from_one_side(coverage, line), mask)
    inner = (found.point_px[:, 0] > 30) & (found.point_px[:, 0] < 130)
    assert np.median(distance_to(found.point_px[inner], line)) < 0.12
    assert np.median(found.width_px[inner]) == pytest.approx(6.0, abs=0.5)
    # where mask and image disagree, the point is worth less
    assert np.median(found.deviation_px) > (0.4 if shift else 0.1)


@settings(max_examples=40)
@given(arrays(np.uint8, st.tuples(st.integers(1, 24), st.integers(1, 24)), elements=st.sampled_from([0, 95, 96, 255])))
def test_no_mask_raises_and_every_point_lies_in_the_image(coverage):
    found = thread_centrelines(np.zeros((*coverage.shape, 3), np.uint8), coverage)
    assert (found.point_px >= 0).all()
    assert (found.point_px <= np.array(coverage.shape[::-1]) - 1).all()
    assert np.diff(found.piece).min(initial=0) >= 0
    assert coverage.any() or not len(found.piece)


@pytest.mark.parametrize(("radius", "slope"), [(0.8, 0.13), (1.5, 1.0), (3.0, 0.0), (5.0, 0.5)])
def test_a_straight_thread_is_found_to_its_ends_as_exactly_as_coverage_by_area_tells(radius, slope):
    line = np.array([[20.3, 20.7], [130.2, 20.7 + 80 * slope]])
    found = thread_centrelines(GREY, tube(line, radius))
    inner = (found.point_px[:, 0] > 30) & (found.point_px[:, 0] < 120)
    assert np.unique(found.piece).tolist() == [0]
    # an edge that cuts a pixel in half moves the pixel's share of the centroid by an eighth of a pixel
    assert distance_to(found.point_px[inner], line).max() < 0.125 / (2 * radius) + 0.03
    assert np.median(found.width_px) == pytest.approx(2 * radius, abs=0.3)
    length = np.linalg.norm(line[1] - line[0])
    ends = np.sort((found.point_px[[0, -1]] - line[0]) @ (line[1] - line[0]) / length)
    np.testing.assert_allclose(ends, (-radius, length + radius), atol=0.5)
