"""Where a thread crosses itself and which strand lies over, and what of the centrelines is some other thread."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from agents.reconstruction.refined.crossings import crossings_of, left_over, other_threads_px
from agents.reconstruction.refined.projection import Curve
from schemas.messages import Centrelines, Over, RectifiedStereo, ThreadCandidate, no_centrelines
from shared.camera import project
from shared.splines import basis_matrix, clamped_uniform_knots, evaluate

CAMERA = RectifiedStereo(640, 480, 800.0, 800.0, 319.5, 239.5, 5.0, 1e-3)
KNOTS = clamped_uniform_knots(30)
S = np.linspace(0.0, 1.0, 100)


def spline_through(points):
    basis = basis_matrix(KNOTS, 3, np.linspace(0, 1, len(points)))
    return np.linalg.lstsq(basis, points, rcond=None)[0]


def loop(rise_mm):
    """One turn that crosses its own start; every later point lies deeper by a share of `rise_mm`."""
    t = np.linspace(0, 1, 400)
    angle = 2 * np.pi * (1.25 * t - 0.125)
    x, y = 12 * np.sin(angle) + 30 * (t - 0.5), -8 * np.cos(angle)
    return spline_through(np.column_stack((x, y, 100 + rise_mm * t)))


def found(control_points, deviation=0.1):
    return crossings_of(CAMERA, Curve(KNOTS, control_points), S, np.tile(deviation**2 * np.eye(3), (len(S), 1, 1)))


def level(start, end, v):
    """Points along a row, a pixel apart."""
    return np.column_stack((np.arange(start, end + 1.0), np.full(end - start + 1, float(v))))


def lines_of(*pieces):
    n = sum(map(len, pieces))
    number = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    return Centrelines(np.concatenate(pieces), number, np.full(n, 4.0), np.full(n, 0.1))


@pytest.mark.parametrize(
    ("rise_mm", "deviation", "over"),
    [(6.0, 0.1, Over.FIRST), (-6.0, 0.1, Over.SECOND), (0.1, 0.1, Over.UNDETERMINED), (6.0, 5.0, Over.UNDETERMINED)],
)
def test_at_a_crossing_the_nearer_of_both_strands_is_told_where_the_posterior_tells(rise_mm, deviation, over):
    control_points = loop(rise_mm)
    (crossing,) = found(control_points, deviation)
    strands = evaluate(KNOTS, control_points, 3, np.array([crossing.s_first, crossing.s_second]))
    np.testing.assert_allclose(project(CAMERA, strands)[0], [crossing.point_px] * 2, atol=0.2)
    assert crossing.depth_apart == pytest.approx(strands[1, 2] - strands[0, 2], abs=0.02)
    assert crossing.over is over


def test_a_thread_that_only_bends_does_not_cross_itself():
    t = np.linspace(0, 1, 300)
    assert found(spline_through(np.column_stack((40 * t - 20, 5 * np.sin(9 * t), 100 + 3 * t)))) == ()


def test_a_strand_beside_the_thread_is_another_thread():
    curve = level(50, 590, 200)
    lines = lines_of(curve + 0.3, level(100, 400, 300), level(500, 510, 50))
    np.testing.assert_allclose(other_threads_px(lines, cKDTree(curve)), [[250.0, 300.0]])
    assert other_threads_px(no_centrelines(), cKDTree(curve)).shape == (0, 2)


def test_what_lies_on_no_thread_is_told_with_its_place():
    curve, listed = level(50, 349, 200), level(100, 249, 300)
    # the thread goes on for as long as a third of what is seen of it, and another one is listed
    lines = lines_of(level(50, 499, 200), listed)
    other = ThreadCandidate(0.5, listed[::8], listed[::8], 4.0, np.array([1, 2, 3]))
    share, at_px = left_over(lines, cKDTree(curve), (other,))
    assert share == pytest.approx(138 / 600, abs=0.01)
    np.testing.assert_allclose(at_px, [[430.0, 200.0]], atol=2)
    share, at_px = left_over(lines, cKDTree(curve), ())
    assert share == pytest.approx((138 + 150) / 600, abs=0.01)
    assert len(at_px) == 2
    assert left_over(no_centrelines(), cKDTree(curve), ())[0] is None
