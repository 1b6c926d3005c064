"""The smoothest curve through all regions: against projection, quadrature and a second solver."""

import numpy as np
import osqp
import pytest
import scipy.sparse
from scipy.integrate import quad
from scipy.interpolate import BSpline

from agents.reconstruction import minimum_variation
from agents.reconstruction.minimum_variation import (
    SLACK_PRICE,
    Regions,
    UnsolvedError,
    chord_parameters,
    constant_speed_parameters,
    inequality_matrix,
    minimum_variation_spline,
    region_faces,
    solve,
    variation_matrix,
)
from shared.splines import basis_matrix, clamped_uniform_knots, evaluate
from tests.agents.reconstruction.threads import CAMERA, spline_of, winding

KNOTS = clamped_uniform_knots(20)
THREAD = spline_of(winding, 17)
BOUND_PX, BOUND_DEPTH = 2.0, 0.5


def regions_about(points, bound_px=BOUND_PX, bound_depth=BOUND_DEPTH):
    n = len(points)
    return Regions(points, np.full((n, 2), bound_px), np.full(n, bound_depth))


def noisy(sigma=0.3):
    share = np.linspace(0, 1, 40)
    return THREAD.at(share) + [0, 0, 1] * np.random.default_rng(0).normal(0, sigma, (40, 1)), share


def contradicting():
    """Two observations of nearly one place, at depths that no region reaches from the other one."""
    points, share = noisy(0.05)
    points[20] *= 1.08
    points[21] = points[19] + 0.02 * (points[21] - points[19])
    return points, share


def outside_of_region(region, point):
    """Eq. 4 as it stands, by projection: how far outside, as a multiple of the bounds (negative inside)."""
    (o, bound_px, bound_depth), z = region, point[2]
    K = np.array([[CAMERA.fx_px, 0, CAMERA.cx_px], [0, CAMERA.fy_px, CAMERA.cy_px]])
    return max((np.abs(K @ point / z - K @ o / o[2]) / bound_px).max(), abs(z - o[2]) / bound_depth) - 1


def variation(P):
    return P.ravel() @ variation_matrix(KNOTS) @ P.ravel()


def test_variation_is_the_integral_of_the_squared_third_derivative():
    P = np.random.default_rng(1).normal(size=(20, 3))
    third = BSpline(KNOTS, P, 3).derivative(3)
    integral, _ = quad(lambda s: float(np.sum(third(s) ** 2)), 0, 1, points=list(KNOTS[4:-4]), limit=200)
    assert variation(P) * 17**5 == pytest.approx(integral, rel=1e-9)


def by_osqp(H, c, C, offset, price):
    """Of min ½ xᵀHx + cᵀx + price Σt so that C x + offset ≤ t, t ≥ 0, with one t for each six rows: x and t."""
    n, size = len(offset) // 6, len(c)
    solver = osqp.OSQP()
    solver.setup(
        P=scipy.sparse.csc_matrix(scipy.sparse.block_diag((H, scipy.sparse.csc_matrix((n, n))))),
        q=np.append(c, np.full(n, price)),
        A=scipy.sparse.csc_matrix(np.block([[C, -np.repeat(np.eye(n), 6, axis=0)], [np.zeros((n, size)), np.eye(n)]])),
        l=np.append(np.full(6 * n, -np.inf), np.zeros(n)),
        u=np.append(-offset, np.full(n, np.inf)),
        eps_abs=1e-9,
        eps_rel=1e-9,
        max_iter=200_000,
        polishing=True,
        verbose=False,
    )
    x = solver.solve(raise_error=True).x
    return x[:size], x[size:]


@pytest.mark.parametrize("observed", [noisy, contradicting])
def test_the_solution_is_that_of_a_second_solver(observed):
    points, share = observed()
    centre = points.mean(axis=0)
    faces = region_faces(regions_about(points), CAMERA, centre, np.linalg.norm(points - centre, axis=1).max())
    P, slack = solve(KNOTS, faces, share)
    C = inequality_matrix(basis_matrix(KNOTS, 3, share), faces).toarray()
    theirs, their_slack = by_osqp(variation_matrix(KNOTS), np.zeros(60), C, faces.offset.ravel(), SLACK_PRICE)
    assert slack == pytest.approx(their_slack, abs=1e-4)
    assert slack.any() == (observed is contradicting)
    assert variation(P) == pytest.approx(variation(theirs), rel=1e-4)
    assert np.abs(evaluate(KNOTS, P - theirs.reshape(-1, 3), 3, np.linspace(0, 1, 200))).max() < 1e-4


def test_the_curve_is_outside_of_just_the_regions_that_report_slack_where_they_contradict():
    points, share = contradicting()
    spline = minimum_variation_spline(regions_about(points), CAMERA, share)
    curve = evaluate(spline.knots, spline.control_points_camera, 3, spline.s)
    bounds = BOUND_PX, BOUND_DEPTH
    outside = np.array([outside_of_region((o, *bounds), b) for o, b in zip(points, curve, strict=True)])
    missed = spline.slack > 0
    assert missed.any()
    assert set(np.flatnonzero(spline.slack > 0.01)) <= set(range(17, 24))
    assert (outside[~missed] <= 1e-5).all()
    assert (outside[missed] > 0).all()


@pytest.mark.parametrize("failure", ["longer", "more slack", "unsolved", None])
def test_a_round_that_diverges_or_is_not_solved_ends_them_and_the_round_before_counts(monkeypatch, failure):
    points, share = noisy()
    calls, found = [], []

    def worse(knots, faces, s):
        calls.append(s)
        P, slack = solve(knots, faces, s)
        found.append(P)
        if len(calls) < 3 or failure is None:
            return P, slack
        if failure == "unsolved":
            raise UnsolvedError("no")
        return (P * 1.2, slack) if failure == "longer" else (P, slack + 0.1)

    monkeypatch.setattr(minimum_variation, "solve", worse)
    spline = minimum_variation_spline(regions_about(points), CAMERA, share)
    rounds, counts = (3, 1) if failure else (5, 4)
    assert len(calls) == rounds
    assert np.array_equal(spline.s, calls[counts])
    size = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    assert np.allclose(spline.control_points_camera, points.mean(axis=0) + size * found[counts])


def test_observations_at_one_place_have_no_solution():
    with pytest.raises(UnsolvedError, match="one place"):
        minimum_variation_spline(regions_about(np.tile([1.0, 2.0, 90.0], (9, 1))), CAMERA, np.linspace(0, 1, 9))


def test_parameters_are_the_share_of_the_way_and_even_or_as_they_were_at_one_place():
    points = np.array([[0, 0, 1], [3, 4, 1], [3, 4, 1], [3, 4, 6.0]])
    assert np.allclose(chord_parameters(points), [0, 0.5, 0.5, 1])
    assert np.allclose(chord_parameters(np.ones((5, 3))), [0, 0.25, 0.5, 0.75, 1])
    s, P = np.array([0, 0.31, 0.77, 1]), points.repeat(5, axis=0) + np.arange(20)[:, None] ** 2
    along = np.linalg.norm(np.diff(evaluate(KNOTS, P, 3, np.linspace(0, 1, 20_001)), axis=0), axis=1).cumsum()
    shares = np.interp(s, np.linspace(0, 1, 20_001)[1:], along / along[-1], left=0.0)
    assert np.allclose(constant_speed_parameters(KNOTS, P, s), shares, atol=1e-6)
    for same in (np.zeros((20, 3)), np.full((20, 3), np.nan)):
        assert np.array_equal(constant_speed_parameters(KNOTS, same, s), s)
