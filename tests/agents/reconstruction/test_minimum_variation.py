import dataclasses

import numpy as np
import osqp
import piqp
import pytest
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import BSpline
from scipy.optimize import linprog, nnls

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
from shared.arc_length import length
from shared.splines import basis_matrix, clamped_uniform_knots, evaluate

KNOTS = clamped_uniform_knots(20)
TIGHT = (0.02, 0.01)


def regions_about(points, bound_px=2.0, bound_depth=0.5):
    n = len(points)
    return Regions(points, np.full((n, 2), float(bound_px)), np.full(n, float(bound_depth)))


def program(regions, camera, s):
    """H, C and f of the quadratic program without slack, and the way back to the camera frame."""
    centre = regions.centre_camera.mean(axis=0)
    size = np.linalg.norm(regions.centre_camera - centre, axis=1).max()
    faces = region_faces(regions, camera, centre, size)
    C = inequality_matrix(basis_matrix(KNOTS, 3, s), faces)
    return faces, variation_matrix(KNOTS), C, faces.offset.ravel(), centre, size


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
    assert P.ravel() @ variation_matrix(KNOTS) @ P.ravel() * 17**5 == pytest.approx(integral, rel=1e-9)


def test_variation_of_any_parabola_is_zero():
    s = np.linspace(0, 1, 200)
    parabola = np.column_stack((s, s**2, 1 - s))
    P = np.linalg.lstsq(basis_matrix(KNOTS, 3, s), parabola, rcond=None)[0]
    assert P.ravel() @ variation_matrix(KNOTS) @ P.ravel() == pytest.approx(0, abs=1e-12)


def test_inequalities_are_the_faces_at_the_points_of_the_curve(camera, thread):
    points, share = noisy(thread)
    faces, _, C, f, _, _ = program(regions_about(points), camera, share)
    P = np.random.default_rng(2).normal(size=(20, 3))
    at_points = np.einsum("jfk,jk->jf", faces.normal, evaluate(KNOTS, P, 3, share)) + faces.offset
    assert np.allclose((C @ P.ravel() + f).reshape(-1, 6), at_points, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_solution_is_that_of_a_second_solver(camera, thread, seed):
    points, share = noisy(thread, seed=seed)
    faces, H, C, f, _, _ = program(regions_about(points), camera, share)
    P, slack = solve(KNOTS, faces, share)
    other = osqp.OSQP()
    tolerances = {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 200_000, "polishing": True, "verbose": False}
    other.setup(H, np.zeros(60), C, np.full(len(f), -np.inf), -f, **tolerances)
    theirs = other.solve(raise_error=True).x.reshape(-1, 3)
    assert not slack.any()
    assert variation(H, P) == pytest.approx(variation(H, theirs), rel=1e-5)
    s = np.linspace(0, 1, 200)
    assert np.abs(evaluate(KNOTS, P - theirs, 3, s)).max() < 1e-4


def variation(H, P):
    return P.ravel() @ H @ P.ravel()


@pytest.mark.parametrize("make", [noisy, contradicting])
def test_the_solution_has_multipliers_that_meet_the_optimality_conditions(camera, thread, make):
    points, share = make(thread)
    faces, H, C, f, _, _ = program(regions_about(points), camera, share)
    P, slack = solve(KNOTS, faces, share)
    room = np.repeat(slack, 6) - (C @ P.ravel() + f)
    assert room.min() > -1e-6
    touched, whole = np.flatnonzero(room < 1e-3), np.flatnonzero(slack == 0)
    # H P + Cᵀ λ = 0 and Σ λ of a region + μ = ρ, with λ ≥ 0 on touched faces and μ ≥ 0 where there is no slack alone
    stationary = np.hstack((C.toarray()[touched].T, np.zeros((60, len(whole)))))
    region_of = (touched // 6 == np.arange(len(share))[:, None]).astype(float)
    priced = np.hstack((region_of, (whole == np.arange(len(share))[:, None]).astype(float))) / SLACK_PRICE
    right = np.concatenate((-H @ P.ravel(), np.ones(len(share))))
    multipliers, residual = nnls(np.vstack((stationary, priced)), right)
    assert len(touched) > 3
    assert residual < 2e-3 * np.linalg.norm(H @ P.ravel())
    assert multipliers[: len(touched)] @ room[touched] < 1e-4 * variation(H, P)


def test_no_other_curve_through_the_regions_is_smoother(camera, thread):
    points, share = noisy(thread)
    faces, H, C, f, _, _ = program(regions_about(points), camera, share)
    P, _ = solve(KNOTS, faces, share)
    within, _ = solve(KNOTS, program(regions_about(points, 1.0, 0.45), camera, share)[0], share)
    rng = np.random.default_rng(3)
    tried = 0
    for w in np.linspace(0.01, 1, 200):
        candidate = P + w * (within - P + rng.normal(0, 1e-3, P.shape))
        if (C @ candidate.ravel() + f).max() <= 0:
            tried += 1
            assert variation(H, candidate) > variation(H, P)
    assert tried > 100


def least_slack(C, f, n):
    """The least sum of slack, by linear programming."""
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
    faces, H, C, f, _, _ = program(regions_about(points), camera, share)
    P, slack = solve(KNOTS, faces, share)
    least, at_least = least_slack(C, f, len(share))
    assert least > 1
    assert set(np.flatnonzero(slack > 0.01)) <= set(range(17, 24))
    assert slack.sum() >= least - 1e-6
    assert slack.sum() <= least + 0.5 * (variation(H, at_least) - variation(H, P)) / SLACK_PRICE


def test_a_higher_price_brings_the_slack_to_the_least_sum(camera, thread):
    points, share = contradicting(thread)
    faces, _, C, f, _, _ = program(regions_about(points), camera, share)
    least, _ = least_slack(C, f, len(share))
    sums = [solve(KNOTS, faces, share, price)[1].sum() for price in (1e1, 1e3, 1e6)]
    assert sums == sorted(sums, reverse=True)
    assert sums[-1] == pytest.approx(least, rel=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_no_slack_is_used_where_the_regions_allow_a_curve(camera, thread, seed):
    points, share = noisy(thread, count=30, sigma=0.2, seed=seed)
    faces, _, C, f, _, _ = program(regions_about(points, bound_depth=0.3), camera, share)
    least, _ = least_slack(C, f, len(share))
    assert least == pytest.approx(0, abs=1e-9)
    assert not solve(KNOTS, faces, share)[1].any()


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


@pytest.mark.parametrize("factor", [1e-3, 7.3, 1e6])
def test_the_curve_scales_with_the_unit(camera, thread, factor):
    points, share = noisy(thread)
    curve = minimum_variation_spline(regions_about(points), camera, share).control_points_camera
    other = dataclasses.replace(camera, baseline=camera.baseline * factor)
    scaled = minimum_variation_spline(regions_about(factor * points, bound_depth=0.5 * factor), other, share)
    assert np.allclose(scaled.control_points_camera, factor * curve, rtol=0, atol=1e-4 * factor)


def test_the_curve_moves_with_the_principal_point(camera, thread):
    """A shift of the image is a shear of space, (x, y, z) to (x + a z, y + b z, z): regions and curve go along."""
    points, share = noisy(thread)
    shear = np.array([[1, 0, 0.08], [0, 1, -0.05], [0, 0, 1]])
    other = dataclasses.replace(
        camera, cx_px=camera.cx_px - 0.08 * camera.fx_px, cy_px=camera.cy_px + 0.05 * camera.fy_px
    )
    sheared = region_faces(regions_about(points @ shear.T), other, np.zeros(3), 1.0)
    faces = region_faces(regions_about(points), camera, np.zeros(3), 1.0)
    b = thread.at(share) + 0.1
    assert np.allclose(
        np.einsum("jfk,jk->jf", sheared.normal, b @ shear.T) + sheared.offset,
        np.einsum("jfk,jk->jf", faces.normal, b) + faces.offset,
        atol=1e-9,
    )


def test_the_curve_is_the_same_walked_backwards(camera, thread):
    points, share = noisy(thread)
    there = minimum_variation_spline(regions_about(points), camera, share)
    back = minimum_variation_spline(regions_about(points[::-1]), camera, 1 - share[::-1])
    assert np.allclose(there.control_points_camera, back.control_points_camera[::-1], atol=1e-3)


def test_exact_observations_with_tight_regions_give_the_curve_they_were_taken_from(camera, thread):
    points = thread.at(np.linspace(0, 1, 60))
    spline = minimum_variation_spline(regions_about(points, *TIGHT), camera, chord_parameters(points))
    share = np.linspace(0, 1, 400)
    s = np.interp(share, constant_speed_parameters(spline.knots, spline.control_points_camera, share), share)
    error = np.linalg.norm(evaluate(spline.knots, spline.control_points_camera, 3, s) - thread.at(share), axis=1)
    assert not spline.slack.any()
    assert error.max() < 0.05
    assert error.mean() < 0.015


def speed_variation(spline):
    speed = np.linalg.norm(
        evaluate(spline.knots, spline.control_points_camera, 3, np.linspace(0, 1, 400), derivative=1), axis=1
    )
    return speed.std() / speed.mean()


def test_rounds_bring_a_badly_parametrised_curve_to_nearly_constant_speed(camera, thread, monkeypatch):
    points = thread.at(np.linspace(0, 1, 60))
    uneven = chord_parameters(points) ** 1.6
    variations = []
    for rounds in (1, 2, 5):
        monkeypatch.setattr(minimum_variation, "ROUNDS", rounds)
        monkeypatch.setattr(minimum_variation, "LARGEST_GROWTH", 10.0)
        variations.append(speed_variation(minimum_variation_spline(regions_about(points, *TIGHT), camera, uneven)))
    assert variations[0] > 0.3
    assert variations[2] < 0.5 * variations[0]
    assert variations[2] < 0.02


def test_four_rounds_of_re_parametrisation_follow_the_first_solve(camera, thread, monkeypatch):
    points, share = noisy(thread)
    solved = []

    def counted(knots, faces, s):
        solved.append(s)
        return solve(knots, faces, s)

    monkeypatch.setattr(minimum_variation, "solve", counted)
    spline = minimum_variation_spline(regions_about(points), camera, share)
    assert len(solved) == 5
    assert np.array_equal(spline.s, solved[-1])


def test_a_round_that_makes_the_curve_much_longer_ends_them_and_the_round_before_counts(camera, thread, monkeypatch):
    points, share = noisy(thread)
    first = minimum_variation_spline_of_rounds(1, points, share, camera, monkeypatch)
    calls = []

    def swelling(knots, faces, s):
        P, slack = solve(knots, faces, s)
        calls.append(s)
        return P * 1.2 ** (len(calls) - 1), slack

    monkeypatch.setattr(minimum_variation, "ROUNDS", 5)
    monkeypatch.setattr(minimum_variation, "solve", swelling)
    spline = minimum_variation_spline(regions_about(points), camera, share)
    assert len(calls) == 2
    assert np.array_equal(spline.control_points_camera, first.control_points_camera)
    assert np.array_equal(spline.s, share)


def minimum_variation_spline_of_rounds(rounds, points, share, camera, monkeypatch):
    monkeypatch.setattr(minimum_variation, "ROUNDS", rounds)
    return minimum_variation_spline(regions_about(points), camera, share)


@pytest.mark.parametrize("failure", ["more slack", "unsolved"])
def test_a_round_that_needs_more_slack_or_is_not_solved_ends_them(camera, thread, monkeypatch, failure):
    points, share = noisy(thread)
    calls = []

    def worse(knots, faces, s):
        P, slack = solve(knots, faces, s)
        calls.append(s)
        if failure == "unsolved" and len(calls) == 3:
            raise UnsolvedError("no")
        return P, slack + (0.1 if len(calls) == 3 else 0)

    monkeypatch.setattr(minimum_variation, "solve", worse)
    spline = minimum_variation_spline(regions_about(points), camera, share)
    assert len(calls) == 3
    assert np.array_equal(spline.s, calls[1])


def test_a_solver_that_does_not_converge_is_an_error_that_says_so(camera, thread, monkeypatch):
    points, share = noisy(thread)
    monkeypatch.setattr(minimum_variation, "MOST_ITERATIONS", 2)
    with pytest.raises(UnsolvedError, match=r"may contradict each other \(solver: max iter reached\)"):
        minimum_variation_spline(regions_about(points), camera, share)


def test_observations_at_one_place_are_refused(camera):
    with pytest.raises(UnsolvedError, match="one place"):
        minimum_variation_spline(regions_about(np.tile([1.0, 2.0, 90.0], (9, 1))), camera, np.linspace(0, 1, 9))


def test_the_solver_needs_far_fewer_iterations_than_it_is_allowed(camera, thread, monkeypatch):
    iterations = []

    class Counting(piqp.SparseSolver):
        def solve(self):
            status = super().solve()
            iterations.append(self.result.info.iter)
            return status

    monkeypatch.setattr(piqp, "SparseSolver", Counting)
    for points, share in (noisy(thread), contradicting(thread), noisy(thread, count=200, sigma=2.0)):
        minimum_variation_spline(regions_about(points), camera, share)
    assert max(iterations) < minimum_variation.MOST_ITERATIONS / 2


def test_chord_parameters_are_the_share_of_the_way():
    points = np.array([[0, 0, 1], [3, 4, 1], [3, 4, 1], [3, 4, 6.0]])
    assert np.allclose(chord_parameters(points), [0, 0.5, 0.5, 1])


def test_chord_parameters_of_one_place_are_even():
    assert np.allclose(chord_parameters(np.ones((5, 3))), [0, 0.25, 0.5, 0.75, 1])


@given(seed=st.integers(0, 999), count=st.integers(1, 40))
@settings(max_examples=50)
def test_constant_speed_parameters_keep_order_and_ends(seed, count):
    rng = np.random.default_rng(seed)
    s = np.concatenate(([0], np.sort(rng.uniform(0, 1, count)), [1]))
    new = constant_speed_parameters(KNOTS, rng.normal(size=(20, 3)), s)
    assert new[0] == 0
    assert new[-1] == 1
    assert (np.diff(new) >= 0).all()


@pytest.mark.parametrize("P", [np.zeros((20, 3)), np.full((20, 3), np.nan)])
def test_a_curve_without_length_keeps_its_parameters(P):
    s = np.array([0, 0.2, 1.0])
    assert np.array_equal(constant_speed_parameters(KNOTS, P, s), s)


def test_constant_speed_parameters_of_a_line_are_shares_of_its_length(thread):
    s = np.array([0, 0.31, 0.77, 1])
    until = [length(*cut(thread, end)) for end in s[1:]]
    assert np.allclose(constant_speed_parameters(KNOTS, thread.control_points, s)[1:], np.array(until) / until[-1])


def cut(thread, end):
    """The thread up to a parameter, as a spline of its own, by SciPy."""
    fine = np.linspace(0, end, 2001)
    knots = np.concatenate((np.zeros(3), np.linspace(0, end, 200), np.full(3, end)))
    curve = evaluate(thread.knots, thread.control_points, 3, fine)
    weights = BSpline.design_matrix(fine, knots, 3).toarray()
    return knots, np.linalg.lstsq(weights, curve, rcond=None)[0], 3
