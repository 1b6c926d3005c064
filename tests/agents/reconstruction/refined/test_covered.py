"""What lies before a thread or beside it: covers, its own strands where it crosses itself, and other threads."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from agents.reconstruction.refined.crossings import crossings_of, left_over, other_threads_px
from agents.reconstruction.refined.projection import Curve
from agents.reconstruction.refined.sightings import DOUBT, hidden_of, with_covered_ends
from schemas.messages import (
    Centrelines,
    Image,
    ImageEncoding,
    Occluder,
    Occluders,
    Over,
    RectifiedStereo,
    ThreadCandidate,
    no_centrelines,
)
from shared.camera import project
from shared.images import encode_image
from shared.splines import basis_matrix, clamped_uniform_knots, evaluate
from tests.agents.reconstruction.threads import lines_of

WIDTH, RADIUS, LENGTH = 5.0, 150.0, 120
ANGLE = np.arange(LENGTH) / RADIUS
BENT = lines_of(RADIUS * np.column_stack((np.sin(ANGLE), 1.0 - np.cos(ANGLE))), width=WIDTH, deviation=0.02)
ACROSS = np.column_stack((-np.sin(ANGLE), np.cos(ANGLE)))[: len(BENT.piece)]
"""A thread on an arc, for every pixel a point and the unit vector across."""


def narrowed(lines, across, missing, one_sided=1.0):
    """The same points, with so much less width at the first and last of them, from one side or from both."""
    moved = lines.point_px + 0.5 * one_sided * missing[:, None] * across
    return dataclasses.replace(lines, point_px=moved, width_px=lines.width_px - missing)


def at_both_ends(most, count, over):
    missing = np.zeros(count)
    missing[: over + 1] = np.linspace(most, 0.0, over + 1)
    return np.maximum(missing, missing[::-1])


@pytest.mark.parametrize(("most", "over"), [(1.5, 4), (4.0, 12)])
def test_points_beside_a_cover_err_by_half_of_what_it_hides_and_a_tip_is_where_it_seems(most, over):
    missing = at_both_ends(most, len(ACROSS), over)
    found = with_covered_ends(narrowed(BENT, ACROSS, missing))
    wrong, error = missing > (1 - 0.95) * WIDTH, 0.5 * missing
    assert (found.deviation_px[wrong] > 0.75 * error[wrong]).all()
    assert (found.deviation_px[wrong] < 1.05 * np.hypot(error[wrong], 0.02)).all()
    np.testing.assert_array_equal(found.deviation_px[~wrong], BENT.deviation_px[~wrong])
    # a tip narrows on both sides
    found = with_covered_ends(narrowed(BENT, ACROSS, missing, one_sided=0.0))
    assert (found.deviation_px <= 1.01 * np.hypot(0.02, 1.5 * DOUBT * error)).all()


@given(st.lists(st.integers(1, 9), min_size=0, max_size=4), st.integers(0, 2**31))
def test_deviations_never_shrink_whatever_the_lines(counts, seed):
    rng, n = np.random.default_rng(seed), sum(counts)
    piece = np.repeat(np.arange(len(counts)), counts)
    lines = Centrelines(rng.uniform(0, 100, (n, 2)), piece, rng.uniform(0.1, 9, n), rng.uniform(0.01, 1, n))
    found = with_covered_ends(lines)
    assert (found.deviation_px >= lines.deviation_px * (1 - 1e-12)).all()
    assert np.isfinite(found.deviation_px).all()
    np.testing.assert_array_equal(found.point_px, lines.point_px)


def encoded(regions):
    return encode_image(regions, ImageEncoding.PNG)


def test_what_is_unseen_upon_an_instrument_is_hidden_and_an_end_before_one_may_go_on():
    tool = np.zeros((54, 96), np.uint8)
    tool[:, 40:50], tool[:, 80:] = Occluder.TOOL.value, Occluder.UNKNOWN.value
    seen, nothing = encoded(tool), encoded(np.zeros_like(tool))
    line = np.column_stack((np.arange(100.0, 796.0, 4.0), np.full(174, 270.0)))
    unseen = (line[:, 0] > 300) & (line[:, 0] < 450)
    away = line[:, 0] < 740
    for points, left, right, ends in (
        (line, seen, nothing, [False, True]),
        (line[::-1], nothing, seen, [True, False]),
        (line[away], seen, nothing, [False, False]),
    ):
        hides = (points[:, 0] > 300) & (points[:, 0] < 450)
        found = hidden_of((points, points), hides, Occluders(left, right, 0), 960)
        assert found is not None
        assert found.ends.tolist() == ends
        np.testing.assert_array_equal(found.places, (points[:, 0] >= 400) & (points[:, 0] < 450))
    broken, colour = Image(ImageEncoding.PNG, 9, 9, 1, b"no image"), encoded(np.zeros((5, 9, 3), np.uint8))
    for nobody_knows in (None, Occluders(broken, broken, 0), Occluders(colour, colour, 0)):
        assert hidden_of((line, line), unseen, nobody_knows, 960) is None


CAMERA = RectifiedStereo(640, 480, 800.0, 800.0, 319.5, 239.5, 5.0, 1e-3)
KNOTS = clamped_uniform_knots(30)


def crossings(points, deviation=0.1):
    """Those of a thread through some points, and its control points."""
    basis = basis_matrix(KNOTS, 3, np.linspace(0, 1, len(points)))
    P = np.linalg.lstsq(basis, points, rcond=None)[0]
    s, covariance = np.linspace(0.0, 1.0, 100), np.tile(deviation**2 * np.eye(3), (100, 1, 1))
    return crossings_of(CAMERA, Curve(KNOTS, P), s, covariance), P


def test_at_a_crossing_the_nearer_of_both_strands_is_told_where_the_posterior_tells():
    """One turn that crosses its own start; every later point lies deeper by a share of what it rises by."""
    t = np.linspace(0, 1, 400)
    angle = 2 * np.pi * (1.25 * t - 0.125)
    for rise_mm, deviation, over in (
        (6.0, 0.1, Over.FIRST),
        (-6.0, 0.1, Over.SECOND),
        (0.1, 0.1, Over.UNDETERMINED),
        (6.0, 5.0, Over.UNDETERMINED),
    ):
        loop = np.column_stack((12 * np.sin(angle) + 30 * (t - 0.5), -8 * np.cos(angle), 100 + rise_mm * t))
        (crossing,), P = crossings(loop, deviation)
        strands = evaluate(KNOTS, P, 3, np.array([crossing.s_first, crossing.s_second]))
        np.testing.assert_allclose(project(CAMERA, strands)[0], [crossing.point_px] * 2, atol=0.2)
        assert crossing.depth_apart == pytest.approx(strands[1, 2] - strands[0, 2], abs=0.02)
        assert crossing.over is over
    assert crossings(np.column_stack((40 * t - 20, 5 * np.sin(9 * t), 100 + 3 * t)))[0] == ()


def level(start, end, v):
    """Points along a row, a pixel apart."""
    return np.column_stack((np.arange(start, end + 1.0), np.full(end - start + 1, float(v))))


def test_a_strand_beside_the_thread_is_another_thread_and_what_lies_on_none_is_told_with_its_place():
    curve, listed = cKDTree(level(50, 349, 200)), level(100, 249, 300)
    lines = lines_of(level(50, 349, 200) + 0.3, listed, level(500, 510, 50), width=4.0)
    np.testing.assert_allclose(other_threads_px(lines, curve), [[175.0, 300.0]])
    # the thread goes on for as long as a third of what is seen of it, and another one is listed
    lines = lines_of(level(50, 499, 200), listed, width=4.0)
    other = ThreadCandidate(0.5, listed[::8], listed[::8], 4.0, np.array([1, 2, 3]))
    for others, share, places in (((other,), 138, [[430.0, 200.0]]), ((), 138 + 150, [[430.0, 200.0], [175.0, 300.0]])):
        found, at_px = left_over(lines, curve, others)
        assert found == pytest.approx(share / 600, abs=0.01)
        np.testing.assert_allclose(at_px, places, atol=2)
    assert left_over(no_centrelines(), curve, ())[0] is None
    assert other_threads_px(no_centrelines(), curve).shape == (0, 2)
