"""Reliability regions about matches, and the program that keeps the curve inside, against a second solver."""

import dataclasses

import numpy as np
import osqp
import pytest
import scipy.sparse

from agents.reconstruction.minimum_variation import Regions, inequality_matrix, region_faces
from agents.reconstruction.refined.alignment import align
from agents.reconstruction.refined.constraints import SLACK_PRICE, held_to, regions_of
from agents.reconstruction.refined.normal_equations import gradient
from agents.reconstruction.refined.pieces import chain_of, pieces_of
from agents.reconstruction.refined.refinement import Start, refined
from shared.camera import project
from shared.disparities import disparities
from shared.splines import basis_matrix

AT = np.linspace(0.1, 0.9, 9)


@pytest.fixture(scope="module")
def fit(spline, sight_of, camera):
    return refined(Start(spline, sight_of(spline)), camera)


def regions_about(curve, push=(0.0, 0.0, 0.0)):
    n = len(AT)
    return Regions(curve.at(AT) + push, np.full((n, 2), 2.0), np.full(n, 0.5))


def outside(regions, curve, camera):
    """How far the curve is outside of each region, by projection, as a multiple of its bounds; negative inside."""
    points = curve.at(AT)
    off_px = np.abs(project(camera, points)[0] - project(camera, regions.centre_camera)[0]) / regions.bound_px
    off_depth = np.abs(points[:, 2] - regions.centre_camera[:, 2]) / regions.bound_depth
    return np.maximum(off_px.max(axis=1), off_depth) - 1


def test_regions_hold_the_curve_as_far_as_its_points_do_not_contradict(fit, camera):
    """What the images tell nothing of gives way to the regions: with little data the curve is wherever they say."""
    held = held_to(regions_about(fit.curve), AT, fit.curve, fit.total, camera)
    np.testing.assert_array_equal(held.curve.control_points, fit.curve.control_points)
    assert not held.slack.any()
    regions = regions_about(fit.curve, push=(0.0, 0.0, 1.0))
    assert outside(regions, fit.curve, camera).max() > 0.5
    held = held_to(regions, AT, fit.curve, fit.total * 1e-6, camera)
    assert outside(regions, held.curve, camera).max() < 1e-4
    assert held.slack.max() < 1e-4


def test_a_region_that_many_points_contradict_gives_way_and_its_slack_is_told(fit, camera):
    regions = regions_about(fit.curve)
    centre = regions.centre_camera.copy()
    centre[4] += [0.0, 0.0, 20.0]
    regions = dataclasses.replace(regions, centre_camera=centre)
    held = held_to(regions, AT, fit.curve, fit.total, camera)
    assert np.abs(held.curve.control_points - fit.curve.control_points).max() < 1.0
    assert held.slack.argmax() == 4
    assert held.slack[4] == pytest.approx(outside(regions, held.curve, camera)[4], rel=0.05)


def by_osqp(regions, curve, total, camera, dense):
    """The same program, written down anew in the unit of the control points."""
    H, n = dense(total.H), len(AT)
    faces = region_faces(regions, camera, np.zeros(3), 1.0)
    C = inequality_matrix(basis_matrix(curve.knots, 3, AT), faces).toarray()
    value = C @ curve.control_points.ravel() + faces.offset.ravel()
    give = np.block([[C, -np.repeat(np.eye(n), 6, axis=0)], [np.zeros((n, len(H))), np.eye(n)]])
    solver = osqp.OSQP()
    solver.setup(
        P=scipy.sparse.csc_matrix(scipy.sparse.block_diag((H, scipy.sparse.csc_matrix((n, n))))),
        q=np.concatenate((gradient(total.g), np.full(n, SLACK_PRICE))),
        A=scipy.sparse.csc_matrix(give),
        l=np.concatenate((np.full(6 * n, -np.inf), np.zeros(n))),
        u=np.concatenate((-value, np.full(n, np.inf))),
        eps_abs=1e-8,
        eps_rel=1e-8,
        max_iter=200_000,
        verbose=False,
    )
    return curve.control_points + solver.solve(raise_error=True).x[: len(H)].reshape(-1, 3)


@pytest.mark.parametrize("trust", [1e-6, 1e-4])
def test_the_program_has_the_solution_that_another_solver_finds(fit, camera, dense, trust):
    regions, total = regions_about(fit.curve, push=(0.3, -0.1, 1.0)), fit.total * trust
    held = held_to(regions, AT, fit.curve, total, camera)
    other = by_osqp(regions, fit.curve, total, camera, dense)
    s = basis_matrix(fit.curve.knots, 3, np.linspace(0, 1, 200))
    np.testing.assert_allclose(s @ held.curve.control_points, s @ other, atol=0.02)


def test_regions_stand_about_matches_and_hold_the_thread(camera, curve, see):
    left = see(curve, 0)
    chain = chain_of(left, pieces_of(left))
    aligned = align(chain, see(curve, 1), disparities(camera.image_width))
    assert aligned is not None
    regions, share = regions_of(chain, aligned, camera)
    assert (np.diff(share) > 0).all()
    points = curve(np.linspace(0, 1, 20001))
    px, centre_px = (project(camera, p)[0] for p in (points, regions.centre_camera))
    for i, centre in enumerate(centre_px):
        inside = (np.abs(px - centre) <= regions.bound_px[i]).all(axis=1)
        assert inside.any()
        assert np.abs(points[inside, 2] - regions.centre_camera[i, 2]).min() <= regions.bound_depth[i]
