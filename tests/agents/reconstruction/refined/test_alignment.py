"""Correspondence along the rows against the disparity that a known thread has."""

import numpy as np
import pytest

from agents.reconstruction.refined.alignment import align
from agents.reconstruction.refined.pieces import chain_of, pieces_of
from agents.reconstruction.refined.plausibility import contradiction
from shared.camera import project
from shared.disparities import disparities

DENSE = np.linspace(0, 1, 10001)


def aligned(left, right, camera):
    chain = chain_of(left, pieces_of(left))
    found = align(chain, right, disparities(camera.image_width))
    assert found is not None
    return chain, found


def largest_error(curve, camera, chain, found, which=slice(None)):
    """Of the disparities, in their own deviations, against those of the nearest places of the thread."""
    px = np.column_stack([np.interp(found.along_px, chain.along_px, chain.point_px[:, k]) for k in (0, 1)])
    left, right = project(camera, curve(DENSE))
    nearest = [int(np.linalg.norm(left - place, axis=1).argmin()) for place in px]
    off_px = found.disparity_px - (left - right)[nearest, 0]
    return np.abs(off_px / np.sqrt(found.variance_px2))[which].max()


def test_matches_have_the_disparity_of_the_thread(camera, curve, see):
    chain, found = aligned(see(curve, 0), see(curve, 1), camera)
    assert found.share > 0.95
    assert (np.diff(found.along_px) > 0).all()
    assert largest_error(curve, camera, chain, found) < 1.0


def test_right_pieces_may_come_in_any_number_order_and_direction(camera, curve, see, make_lines):
    right = see(curve, 1).point_px
    cuts = [piece[3:-3][:: 1 - 2 * (k % 2)] for k, piece in enumerate(np.array_split(right, 5))]
    chain, found = aligned(see(curve, 0), make_lines(*(cuts[k] for k in (3, 0, 4, 2, 1))), camera)
    assert found.share > 0.9
    assert largest_error(curve, camera, chain, found) < 1.0


def test_where_the_thread_runs_along_the_rows_nothing_certain_is_said(camera, threads, see):
    waving = threads["waving"]
    chain, found = aligned(see(waving, 0), see(waving, 1), camera)
    slope = np.interp(found.along_px, chain.along_px, np.abs(np.gradient(chain.point_px[:, 1])))
    assert (slope < 0.2).any()
    assert np.sqrt(found.variance_px2[slope < 0.2]).min() > 1.0
    assert np.sqrt(np.median(found.variance_px2[slope > 0.5])) < 0.7


def test_another_strand_beside_the_thread_is_not_taken(camera, curve, see, make_lines):
    right = see(curve, 1).point_px
    both = make_lines(right + np.array([14.0, 40.0]), right)
    chain, found = aligned(see(curve, 0), both, camera)
    taken = both.piece[found.right_index.astype(int)] == 1
    assert taken.mean() > 0.95
    assert largest_error(curve, camera, chain, found, taken) < 1.0


def test_exchanged_images_and_a_thread_in_other_rows_contradict(camera, threads, see, make_lines):
    left, right = (see(threads["winding"], eye) for eye in (0, 1))
    others = [(right, left, "exchanged")]
    others += [(left, make_lines(right.point_px * [1, 0.2] + [0, shift]), "check that") for shift in (300.0, -300.0)]
    for first, second, told in others:
        chain = chain_of(first, pieces_of(first))
        assert told in contradiction(align(chain, second, disparities(camera.image_width)), camera)


@pytest.mark.slow
def test_a_thread_that_winds_over_the_whole_image_is_aligned_in_bounded_memory(camera, make_lines):
    legs = [[(u, 20), (u, 520)][:: 1 - 2 * (k % 2)] for k, u in enumerate(range(60, 940, 24))]
    left = make_lines(np.array(legs, np.float64).reshape(-1, 2))
    chain, found = aligned(left, make_lines(left.point_px - [40.0, 0.0]), camera)
    # every leg looks like the next one, so disparities may be off by whole legs
    assert len(found.along_px) <= 1000
    assert found.share > 0.5
    assert chain.along_px[-1] > 15_000
