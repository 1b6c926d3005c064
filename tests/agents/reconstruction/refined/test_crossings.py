import numpy as np
import pytest
from scipy.spatial import cKDTree

from agents.reconstruction.refined.crossings import crossings_of, left_over, other_threads_px
from agents.reconstruction.refined.projection import Curve
from schemas.messages import Centrelines, Over, RectifiedStereo, ThreadCandidate
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


def test_a_crossing_is_where_both_strands_are_seen_at_one_pixel():
    control_points = loop(6.0)
    (crossing,) = found(control_points)
    strands = evaluate(KNOTS, control_points, 3, np.array([crossing.s_first, crossing.s_second]))
    pixels, _ = project(CAMERA, strands)
    np.testing.assert_allclose(pixels, [crossing.point_px] * 2, atol=0.2)
    assert crossing.depth_apart == pytest.approx(strands[1, 2] - strands[0, 2], abs=0.02)


@pytest.mark.parametrize(
    ("rise_mm", "deviation", "over"),
    [(6.0, 0.1, Over.FIRST), (-6.0, 0.1, Over.SECOND), (0.1, 0.1, Over.UNDETERMINED), (6.0, 5.0, Over.UNDETERMINED)],
)
def test_the_nearer_strand_is_told_where_the_posterior_tells(rise_mm, deviation, over):
    (crossing,) = found(loop(rise_mm), deviation)
    assert crossing.over is over


def test_a_thread_that_only_bends_does_not_cross_itself():
    t = np.linspace(0, 1, 300)
    assert found(spline_through(np.column_stack((40 * t - 20, 5 * np.sin(9 * t), 100 + 3 * t)))) == ()


def test_a_strand_beside_the_thread_is_another_thread():
    curve = np.column_stack((np.linspace(50, 590, 800), np.full(800, 200.0)))
    other = np.column_stack((np.linspace(100, 400, 301), np.full(301, 300.0)))
    speck = np.column_stack((np.linspace(500, 510, 11), np.full(11, 50.0)))
    points = np.concatenate((curve[::2] + 0.3, other, speck))
    piece = np.repeat([0, 1, 2], [400, 301, 11])
    lines = Centrelines(points, piece, np.full(len(points), 4.0), np.full(len(points), 0.1))
    np.testing.assert_allclose(other_threads_px(lines, cKDTree(curve)), [[250.0, 300.0]])
    assert other_threads_px(Centrelines(points[:0], piece[:0], np.zeros(0), np.zeros(0)), cKDTree(curve)).shape == (
        0,
        2,
    )


def test_what_lies_on_no_thread_is_told_with_its_place():
    curve = np.column_stack((np.linspace(50, 349, 300), np.full(300, 200.0)))
    # the thread goes on for as long as a third of what is seen of it, and another one is listed
    seen = np.column_stack((np.linspace(50, 499, 450), np.full(450, 200.0)))
    listed = np.column_stack((np.linspace(100, 249, 150), np.full(150, 300.0)))
    points, piece = np.concatenate((seen, listed)), np.repeat([0, 1], [450, 150])
    lines = Centrelines(points, piece, np.full(600, 4.0), np.full(600, 0.1))
    other = ThreadCandidate(0.5, listed[::8], listed[::8], 4.0, np.array([1, 2, 3]))
    share, at_px = left_over(lines, cKDTree(curve), (other,))
    assert share == pytest.approx(138 / 600, abs=0.01)
    np.testing.assert_allclose(at_px, [[430.0, 200.0]], atol=2)
    share, at_px = left_over(lines, cKDTree(curve), ())
    assert share == pytest.approx((138 + 150) / 600, abs=0.01)
    assert len(at_px) == 2
    nothing = Centrelines(points[:0], piece[:0], np.zeros(0), np.zeros(0))
    assert left_over(nothing, cKDTree(curve), ())[0] is None
