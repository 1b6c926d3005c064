"""Centrelines of strips whose middle is known exactly, to their tips, and of images that show no thread at all."""

import itertools

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.perception.centrelines import thread_centrelines
from agents.perception.centrelines.glints import without_glints
from agents.perception.centrelines.tips import to_tips
from schemas.messages import Centrelines

SHAPE = 120, 160
GREY = np.full((*SHAPE, 3), 128, np.uint8)


def tube(polyline, radius):
    """Anti-aliased coverage of everything within `radius` of a polyline; symmetric about it by construction."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    distance = distance_to(np.column_stack((u.ravel(), v.ravel())).astype(float), polyline).reshape(SHAPE)
    return np.rint(255 * np.clip(radius + 0.5 - distance, 0, min(1, 2 * radius))).astype(np.uint8)


def distance_to(points, polyline):
    best = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(polyline):
        d = b - a
        t = np.clip((points - a) @ d / (d @ d), 0, 1)
        best = np.minimum(best, np.linalg.norm(points - a - t[:, None] * d, axis=1))
    return best


def line(*points):
    return np.array(points, float)


def arc(centre, radius, start, stop):
    angle = np.linspace(start, stop, 200)
    return np.column_stack((centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)))


@pytest.mark.parametrize(("radius", "slope"), [(0.8, 0.13), (1.5, 1.0), (3.0, 0.0), (5.0, 0.5)])
def test_a_straight_thread_is_found_to_its_ends_as_exactly_as_coverage_by_area_tells(radius, slope):
    middle = line((20.3, 20.7), (130.2, 20.7 + 80 * slope))
    found = thread_centrelines(GREY, tube(middle, radius))
    inner = (found.point_px[:, 0] > 30) & (found.point_px[:, 0] < 120)
    assert np.unique(found.piece).tolist() == [0]
    # an edge that cuts a pixel in half moves the pixel's share of the centroid by an eighth of a pixel
    assert distance_to(found.point_px[inner], middle).max() < 0.125 / (2 * radius) + 0.03
    assert np.median(found.width_px) == pytest.approx(2 * radius, abs=0.3)
    length = np.linalg.norm(middle[1] - middle[0])
    ends = np.sort((found.point_px[[0, -1]] - middle[0]) @ (middle[1] - middle[0]) / length)
    np.testing.assert_allclose(ends, (-radius, length + radius), atol=0.5)


def test_a_bend_is_not_cut_and_its_points_lie_a_pixel_apart():
    found = thread_centrelines(GREY, tube(arc((80.3, 60.6), 25.0, 0.3, 4.5), 3.5))
    from_centre = np.linalg.norm(found.point_px - [80.3, 60.6], axis=1)[5:-5]
    assert np.abs(from_centre - 25.0).max() < 0.12
    assert abs(np.median(from_centre) - 25.0) < 0.02
    steps = np.linalg.norm(np.diff(found.point_px, axis=0), axis=1)
    assert steps.min() > 0.5
    assert steps.max() < 1.5


def test_a_crossing_leaves_four_pieces_that_keep_clear_of_it():
    one, other = line((20.2, 30.0), (140.3, 90.4)), line((25.1, 95.3), (135.6, 22.7))
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


def test_a_glint_is_filled_and_moves_no_middle_and_a_gap_between_two_strands_is_left():
    bow = arc((80, 140), 80, -2.3, -0.8)
    strand = tube(bow, 3.5)
    mask = np.where(tube(arc((80, 140), 81.5, -1.8, -1.3), 1.0) > 127, 0, strand).astype(np.uint8)
    assert (mask < strand).any()
    assert (without_glints(mask > 0)[0] == (strand > 0)).all()
    found = thread_centrelines(GREY, mask)
    assert found.piece.max() == 0
    assert distance_to(bow[10:-10], found.point_px).max() < 1.0
    one = line((15.0, 25.0), (50.0, 58.5), (80.0, 56.0), (110.0, 58.5), (145.0, 25.0))
    found = thread_centrelines(GREY, np.maximum(tube(one, 2.5), tube(one * [1, -1] + [0, 120], 2.5)))
    inside = found.point_px[np.abs(found.point_px[:, 0] - 80) < 4]
    assert set(np.unique(inside[:, 1] > 60)) == {False, True}
    assert distance_to(inside[inside[:, 1] < 60], one).max() < 0.5


@pytest.mark.parametrize("shift", [0, 1])
def test_the_edges_in_the_image_correct_a_binary_mask(shift):
    """Of a violet thread on pink ground, one half of it twice as bright as the other."""
    middle = line((20.3, 40.7), (140.2, 62.1))
    coverage = tube(middle, 3.0)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    along = (middle[1] - middle[0]) / np.linalg.norm(middle[1] - middle[0])
    side = (u - middle[0, 0]) * along[1] - (v - middle[0, 1]) * along[0]
    thread = np.array([110.0, 40.0, 80.0]) * (0.7 + 0.5 / (1 + np.exp(side[..., None])))
    share = coverage[..., None] / 255
    image = np.rint(share * thread + (1 - share) * [150.0, 150.0, 210.0]).astype(np.uint8)
    found = thread_centrelines(image, np.where(np.roll(coverage, shift, axis=0) >= 128, 255, 0).astype(np.uint8))
    inner = (found.point_px[:, 0] > 30) & (found.point_px[:, 0] < 130)
    assert np.median(distance_to(found.point_px[inner], middle)) < 0.12
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


TIPS = 40.3, 200.7
"""Along a straight thread, where it begins and ends."""


def between_tips(turn=0.0):
    """The thread over a noisy ground, turned about the middle of the image."""
    y, x = np.mgrid[:240, :240] + 0.0
    cos, sin = np.cos(turn), np.sin(turn)
    along, across = cos * (x - 120) + sin * (y - 120) + 120, -sin * (x - 120) + cos * (y - 120)
    inside = np.minimum.reduce((along - TIPS[0], TIPS[1] - along, 2.5 - np.abs(across)))
    alpha = np.clip(inside + 0.5, 0, 1)[..., None]
    image = alpha * (60.0, 40.0, 90.0) + (1 - alpha) * (90.0, 120.0, 170.0)
    image = (image + np.random.default_rng(1).normal(0, 2, image.shape)).clip(0, 255).astype(np.uint8)
    return cv2.GaussianBlur(image, (0, 0), 0.7)


def placed(places, turn=0.0):
    """Points at places along the thread, turned with it."""
    return 120 + np.outer(np.asarray(places, float) - 120.0, (np.cos(turn), np.sin(turn)))


def with_tips(point, image, loose=True):
    n = len(point)
    found = Centrelines(point, np.zeros(n, np.int64), np.full(n, 5.0), np.full(n, 0.1))
    return to_tips(found, image, np.array([loose]), np.array([loose])).point_px


@settings(max_examples=12)
@given(st.floats(0, 2 * np.pi), st.floats(-2.5, 5.0), st.floats(-2.5, 5.0))
def test_a_line_that_ends_too_soon_or_too_late_ends_at_the_tips(turn, short_start, short_end):
    places = np.linspace(TIPS[0] + short_start, TIPS[1] - short_end, 150)
    found = with_tips(placed(places, turn), between_tips(turn))
    np.testing.assert_allclose(found[[0, -1]], placed(TIPS, turn), atol=0.5)
    step = np.linalg.norm(np.diff(found, axis=0), axis=1)
    assert 0 < step.min() <= step.max() < 2.5


def test_a_line_stays_as_it_is_where_it_is_cut_goes_on_or_shows_no_contrast():
    image, whole, part = between_tips(), placed(np.linspace(42.3, 198.7, 150)), placed(np.linspace(100, 150, 51))
    np.testing.assert_array_equal(with_tips(whole, image, loose=False), whole)
    np.testing.assert_array_equal(with_tips(part, image), part)
    np.testing.assert_array_equal(with_tips(whole, np.full_like(image, 90)), whole)
