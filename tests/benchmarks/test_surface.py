import numpy as np
import pytest

from agents.planner.standing import SeenTissue
from agents.planner.tissue import tissue_of
from benchmarks.jaws import PLACES, planned, simulated_arm, thread_of
from benchmarks.surface import STAMP, behind_points, row_of, within_hull
from schemas.messages import TissueSurface
from shared.scene.__main__ import ENDOSCOPE, make_scene
from shared.splines import evaluate


def surface(depth, valid=None, deviation=0.5):
    depth = np.asarray(depth, np.float64)
    valid = np.ones(depth.shape, bool) if valid is None else np.asarray(valid)
    u, v = 24.0 * np.arange(depth.shape[1]) + 11.5, 24.0 * np.arange(depth.shape[0]) + 11.5
    return TissueSurface(STAMP, ENDOSCOPE, u, v, np.where(valid, depth, 0), valid, np.where(valid, deviation, 0.0))


def test_errors_are_counted_where_cells_are_measured_and_the_truth_is_known():
    found = surface([[90.0, 91.0, 94.0, 90.0]], [[True, True, True, False]])
    row = row_of("g", "n", found, np.array([[90.2, 90.0, np.nan, 90.0]]), 1.0)
    assert (row.cells, row.valid) == (2, pytest.approx(2 / 3))
    assert (row.median_mm, row.worst_mm) == (pytest.approx(0.6), pytest.approx(1.0))
    assert row.within == (0.5, 1.0, 1.0)


def test_tissue_behind_a_point_is_that_of_the_nearest_cell():
    grid = surface([[90.0, 95.0]], [[True, False]])
    rays = np.array([[11.0 - 479.5, 11.5 - 269.5, 1000.0], [40.0 - 479.5, 11.5 - 269.5, 1000.0]]) * 0.088
    behind, deviation = behind_points(grid, rays)
    np.testing.assert_allclose(behind, [2.0, np.nan])
    np.testing.assert_allclose(deviation, [0.5, np.nan])


def test_pixels_within_an_outline_are_those_between_its_corners():
    u, v = np.meshgrid(np.arange(5.0), np.arange(4.0))
    inside = within_hull(np.array([[0.5, 0.5], [3.5, 0.5], [3.5, 2.5], [0.5, 2.5]]), u, v)
    np.testing.assert_array_equal(inside, (u >= 1) & (u <= 3) & (v >= 1) & (v <= 2))


@pytest.fixture(scope="module")
def scene():
    return make_scene("easy", "plain", 3)


def test_a_moved_thread_lies_on_the_same_viewing_rays(scene):
    here, there = thread_of(scene, 0.0), thread_of(scene, 3.0)
    off = there.control_points_camera - here.control_points_camera
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), 3.0)
    np.testing.assert_allclose(np.cross(off, here.control_points_camera), 0, atol=1e-9)
    at = np.linspace(0, 1, 9)
    points = [evaluate(t.knots, t.control_points_camera, t.degree, at) for t in (here, there)]
    assert np.linalg.norm(points[1] - points[0], axis=1) == pytest.approx(3.0, abs=0.05)


def test_of_one_surface_the_planner_tells_the_truth_and_of_deeper_thread_it_wants_none(scene):
    flat = tissue_of(surface(np.full((22, 40), scene.distance_mm), deviation=1e-6))
    seen = SeenTissue(flat, STAMP, "")
    told = [planned(thread_of(scene, moved_mm), PLACES[2], moved_mm, seen, seen) for moved_mm in (0.0, 8.0)]
    assert [one.without for one in told] == [True, True]
    assert [one.accepted for one in told] == [True, False]
    assert told[0].true_mm == pytest.approx(told[0].stated_mm)
    assert (told[1].stated_mm or 0.0) < -4.0
    assert simulated_arm().reachable(simulated_arm().T_camera_tool[None]).all()
