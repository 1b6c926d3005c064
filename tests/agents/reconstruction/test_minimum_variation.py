"""The smoothest curve through all regions: against projection, quadrature, a second solver and linear programming."""

import numpy as np
import osqp
import pytest
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import BSpline
from scipy.optimize import linprog

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

KNOTS = clamped_uniform_knots(20)
TIGHT = (0.02, 0.01)


def regions_about(points, bound_px=2.0, bound_depth=0.5):
    n = len(points)
    return Regions(points, np.full((n, 2), float(bound_px)), np.full(n, float(bound_depth)))


def program(regions, camera, s):
    """The faces, and H, C and f of the quadratic program without slack."""
    centre = regions.centre_camera.mean(axis=0)
    size = np.linalg.norm(regions.centre_camera - centre, axis=1).max()
    faces = region_faces(regions, camera, centre, size)
    return faces, variation_matrix(KNOTS), inequality_matrix(basis_matrix(KNOTS, 3, s), faces), faces.offset.ravel()


def noisy(thread, count=40, sigma=0.3, seed=0):
    share = np.linspace(0, 1, count)
    return thread.at(share) + [0, 0, 1] * np.random.default_rng(seed).normal(0, sigma, (count, 1)), share


def contradicting(thread, count=40):
    """Two observations of nearly one place, at depths that no region reaches from the other one."""
    points, share = noisy(thread, count, 0.05)
    points[20] *= 1.08
    points[21] = points[19] + 0.02 * (points[21] - points[19])
    return points, share


def outside_of_region(camera, region, point):
    """Eq. 4 as it stands, by projection: how far outside, as a multiple of the bounds (negative inside)."""
    (o, bound_px, bound_depth), z = region, point[2]
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px]])
    return max((np.abs(K @ point / z - K @ o / o[2]) / bound_px).max(), abs(z - o[2]) / bound_depth) - 1


def variation(H, P):
    return P.ravel() @ H @ P.ravel()


@given(
    point=st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3)).map(np.array),
    centre_px=st.tuples(st.floats(0, 960), st.floats(0, 540)),
    z=st.floats(30, 300),
    bound_px=st.tuples(st.floats(0.5, 20), st.floats(0.5, 20)).map(np.array),
    bound_share=st.floats(0.001, 0.5),
)
def test_a_point_is_beyond_no_face_just_where_its_projection_and_depth_are_within_the_bounds(
    camera, point, centre_px, z, bound_px, bound_share
):
    o = z * np.array([(centre_px[0] - camera.cx_px) / camera.fx_px, (centre_px[1] - camera.cy_px) / camera.fy_px, 1])
    reach = np.array([*(bound_px * z / camera.fx_px), bound_share * z])
    b = o + point * reach * [1, 1, 0.6]
    if b[2] <= 0:
        return
    outside = outside_of_region(camera, (o, bound_px, bound_share * z), b)
    frame, size = np.array([1.0, -2.0, 80.0]), 25.0
    faces = region_faces(Regions(o[None], bound_px[None], np.array([bound_share * z])), camera, frame, size)
    beyond = (faces.normal[0] @ ((b - frame) / size) + faces.offset[0]).max()
    if abs(outside) > 1e-9:
        assert (beyond > 0) == (outside > 0)


def test_a_face_is_exceeded_by_one_where_the_region_would_have_to_be_twice_as_large(camera):
    o, z = np.array([[4.0, -3.0, 90.0]]), 90.0
    faces = region_faces(regions_about(o, 2.0, 0.7), camera, np.zeros(3), 1.0)
    for axis, reach in ((0, 2 * z / camera.fx_px), (1, 2 * z / camera.fy_px), (2, 0.7)):
        for sign, face in ((1, 2 * axis), (-1, 2 * axis + 1)):
            beyond = faces.normal[0] @ (o[0] + 2 * sign * reach * np.eye(3)[axis]) + faces.offset[0]
            # along the ray, image faces move with depth: only the face of this axis is exceeded by exactly one
            assert beyond[face] == pytest.approx(1.0, rel=1e-9)


def test_variation_is_the_integral_of_the_squared_third_derivative():
    P = np.random.default_rng(1).normal(size=(20, 3))
    third = BSpline(KNOTS, P, 3).derivative(3)
    integral, _ = quad(lambda s: float(np.sum(third(s) ** 2)), 0, 1, points=list(KNOTS[4:-4]), limit=200)
    assert variation(variation_matrix(KNOTS), P) * 17**5 == pytest.approx(integral, rel=1e-9)


def test_the_solution_is_that_of_a_second_solver(camera, thread):
    points, share = noisy(thread)
    faces, H, C, f = program(regions_about(points), camera, share)
    P, slack = solve(KNOTS, faces, share)
    other = osqp.OSQP()
    tolerances = {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 200_000, "polishing": True, "verbose": False}
    other.setup(H, np.zeros(60), C, np.full(len(f), -np.inf), -f, **tolerances)
    theirs = other.solve(raise_error=True).x.reshape(-1, 3)
    assert not slack.any()
    assert variation(H, P) == pytest.approx(variation(H, theirs), rel=1e-5)
    assert np.abs(evaluate(KNOTS, P - theirs, 3, np.linspace(0, 1, 200))).max() < 1e-4


def least_slack(C, f, n):
    """The least sum of slack, and a curve that has it, by linear programming."""
    give = scipy.sparse.kron(scipy.sparse.eye(n), -np.ones((6, 1)))
    found = linprog(
        np.concatenate((np.zeros(60), np.ones(n))),
        A_ub=scipy.sparse.hstack((C, give)).toarray(),
        b_ub=-f,
        bounds=[(None, None)] * 60 + [(0, None)] * n,
        method="highs",
    )
    assert found.status == 0
    return float(found["fun"]), found["x"][:60].reshape(-1, 3)


def test_regions_that_contradict_give_way_where_they_contradict_and_by_nearly_the_least_sum(camera, thread):
    points, share = contradicting(thread)
    faces, H, C, f = program(regions_about(points), camera, share)
    P, slack = solve(KNOTS, faces, share)
    least, at_least = least_slack(C, f, len(share))
    assert least > 1
    assert set(np.flatnonzero(slack > 0.01)) <= set(range(17, 24))
    assert least - 1e-6 <= slack.sum() <= least + 0.5 * (variation(H, at_least) - variation(H, P)) / SLACK_PRICE
    sums = [solve(KNOTS, faces, share, price)[1].sum() for price in (1e1, 1e3, 1e6)]
    assert sums == sorted(sums, reverse=True)
    assert sums[-1] == pytest.approx(least, rel=1e-4)


def test_the_curve_is_outside_of_just_the_regions_that_report_slack(camera, thread):
    points, share = contradicting(thread)
    spline = minimum_variation_spline(regions_about(points), camera, share)
    curve = evaluate(spline.knots, spline.control_points_camera, 3, spline.s)
    bounds = np.full(2, 2.0), 0.5
    outside = np.array([outside_of_region(camera, (o, *bounds), b) for o, b in zip(points, curve, strict=True)])
    missed = spline.slack > 0
    assert missed.any()
    assert (outside[~missed] <= 1e-5).all()
    assert (outside[missed] > 0).all()


def test_exact_observations_with_tight_regions_give_the_curve_they_were_taken_from(camera, thread):
    points = thread.at(np.linspace(0, 1, 60))
    spline = minimum_variation_spline(regions_about(points, *TIGHT), camera, chord_parameters(points))
    share = np.linspace(0, 1, 400)
    s = np.interp(share, constant_speed_parameters(spline.knots, spline.control_points_camera, share), share)
    error = np.linalg.norm(evaluate(spline.knots, spline.control_points_camera, 3, s) - thread.at(share), axis=1)
    assert not spline.slack.any()
    assert error.max() < 0.05
    assert error.mean() < 0.015


def test_rounds_bring_a_badly_parametrised_curve_to_nearly_constant_speed(camera, thread, monkeypatch):
    points = thread.at(np.linspace(0, 1, 60))
    monkeypatch.setattr(minimum_variation, "LARGEST_GROWTH", 10.0)
    variations = []
    for rounds in (1, 5):
        monkeypatch.setattr(minimum_variation, "ROUNDS", rounds)
        uneven = chord_parameters(points) ** 1.6
        spline = minimum_variation_spline(regions_about(points, *TIGHT), camera, uneven)
        at = np.linspace(0, 1, 400)
        speed = np.linalg.norm(evaluate(spline.knots, spline.control_points_camera, 3, at, derivative=1), axis=1)
        variations.append(speed.std() / speed.mean())
    assert variations[0] > 0.3
    assert variations[1] < 0.02


@pytest.mark.parametrize("failure", ["longer", "more slack", "unsolved", None])
def test_a_round_that_diverges_or_is_not_solved_ends_them_and_the_round_before_counts(
    camera, thread, monkeypatch, failure
):
    points, share = noisy(thread)
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
    spline = minimum_variation_spline(regions_about(points), camera, share)
    rounds, counts = (3, 1) if failure else (5, 4)
    assert len(calls) == rounds
    assert np.array_equal(spline.s, calls[counts])
    size = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    assert np.allclose(spline.control_points_camera, points.mean(axis=0) + size * found[counts])


def test_what_has_no_solution_is_an_error_that_says_so(camera, thread, monkeypatch):
    with pytest.raises(UnsolvedError, match="one place"):
        minimum_variation_spline(regions_about(np.tile([1.0, 2.0, 90.0], (9, 1))), camera, np.linspace(0, 1, 9))
    points, share = noisy(thread)
    monkeypatch.setattr(minimum_variation, "MOST_ITERATIONS", 2)
    with pytest.raises(UnsolvedError, match=r"may contradict each other \(solver: max iter reached\)"):
        minimum_variation_spline(regions_about(points), camera, share)


def test_chord_parameters_are_the_share_of_the_way_and_even_at_one_place():
    points = np.array([[0, 0, 1], [3, 4, 1], [3, 4, 1], [3, 4, 6.0]])
    assert np.allclose(chord_parameters(points), [0, 0.5, 0.5, 1])
    assert np.allclose(chord_parameters(np.ones((5, 3))), [0, 0.25, 0.5, 0.75, 1])


def test_constant_speed_parameters_are_shares_of_the_length_where_there_is_one(thread):
    s = np.array([0, 0.31, 0.77, 1])
    fine = np.linspace(0, 1, 20_001)
    along = np.linalg.norm(np.diff(evaluate(KNOTS, thread.control_points, 3, fine), axis=0), axis=1).cumsum()
    shares = np.interp(s, fine[1:], along / along[-1], left=0.0)
    assert np.allclose(constant_speed_parameters(KNOTS, thread.control_points, s), shares, atol=1e-6)
    for P in (np.zeros((20, 3)), np.full((20, 3), np.nan)):
        assert np.array_equal(constant_speed_parameters(KNOTS, P, s), s)
