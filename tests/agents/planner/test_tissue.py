"""The height field along the viewing rays: by closed forms on planes, and what follows from unknown cells."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.planner.tissue import clearance, tissue_of

DEPTHS = arrays(np.float64, (22, 40), elements=st.floats(40, 120))
PLACES = arrays(np.float64, (30, 3), elements=st.floats(-1, 1)).map(lambda p: p * (0.015, 0.01, 0.01) + (0, 0, 0.07))


def replaced(surface, **changes):
    return dataclasses.replace(surface, **changes)


def known_tissue(surface) -> Any:
    """What the planner makes of a surface, or None."""
    return tissue_of(surface)


def slanted(u, v):
    """The plane z = 80 + 0.5 x − 0.25 y in millimetres, where each ray meets it."""
    return 80.0 / (1.0 - 0.5 * (u - 479.5) / 1000.0 + 0.25 * (v - 269.5) / 1000.0)


@settings(max_examples=15)
@given(PLACES)
def test_before_a_plane_the_clearance_is_the_way_along_the_ray(bench, places):
    off, deviation = clearance(known_tissue(bench.surface(slanted)), places)
    normal = np.array([-0.5, 0.25, 1.0])
    stretch = 0.08 / (places @ normal)
    np.testing.assert_allclose(off, (stretch - 1.0) * np.linalg.norm(places, axis=1), atol=1e-9)
    assert (deviation > 0.9e-4).all()
    assert (deviation < 1.3e-4).all()


@settings(max_examples=10)
@given(DEPTHS, PLACES, st.floats(0.1, 20))
def test_the_deeper_the_surface_the_greater_the_clearance(bench, depth, places, deeper):
    surface = bench.surface(60.0)
    here, _ = clearance(known_tissue(replaced(surface, depth=depth)), places)
    deeper, _ = clearance(known_tissue(replaced(surface, depth=depth + deeper)), places)
    assert (deeper > here).all()


def test_the_unit_makes_no_difference(bench):
    surface, places = bench.surface(slanted), np.array([[0.004, 0.002, 0.06]])
    metres = replaced(surface.camera, baseline=surface.camera.baseline * 1e-3, metres_per_unit=1.0)
    same = replaced(surface, camera=metres, depth=surface.depth * 1e-3, deviation=surface.deviation * 1e-3)
    np.testing.assert_allclose(clearance(known_tissue(surface), places), clearance(known_tissue(same), places))


def without_columns(*gone):
    """All is known but these columns of cells."""
    return lambda u, _: ~np.isin(np.round((u - 11.5) / 24), gone)


@pytest.mark.parametrize("gone", [(19,), (19, 20)])
def test_what_a_thread_hides_is_known_from_both_sides_of_it(bench, gone):
    places = np.array([[-0.001, 0.0, 0.06], [-0.001, 0.01, 0.06]])
    whole, _ = clearance(known_tissue(bench.surface(slanted)), places)
    off, deviation = clearance(known_tissue(bench.surface(slanted, known=without_columns(*gone))), places)
    np.testing.assert_allclose(off, whole, atol=1e-9)
    assert (deviation < 1.5e-4).all()


def test_what_is_unknown_over_a_wide_stretch_stays_unknown(bench):
    tissue = known_tissue(bench.surface(slanted, known=without_columns(*range(17, 22))))
    expected = ~np.isin(np.arange(40), range(17, 22))
    np.testing.assert_array_equal(np.isfinite(tissue.inverse_depth), np.tile(expected, (22, 1)))
    np.testing.assert_array_equal(np.isfinite(tissue.deviation), np.tile(expected, (22, 1)))


def test_between_cells_a_rough_surface_is_unsure_and_a_smooth_one_is_not(bench):
    rng, place = np.random.default_rng(1), np.array([[-0.0007, 0.0, 0.06]])
    rough = bench.surface(lambda u, _: 80.0 + rng.normal(0, 2.0, u.shape), known=without_columns(19))
    assert clearance(known_tissue(rough), place)[1] > 1e-3


def test_outside_of_the_grid_and_behind_the_camera_nothing_is_known(bench):
    outside = np.array([[0.2, 0, 0.06], [0, -0.1, 0.06], [0, 0, -0.06], [0, 0, 0.0], [-0.0285, 0, 0.06]])
    assert np.isnan(clearance(known_tissue(bench.surface(80.0)), outside)).all()


def test_without_a_unit_a_deviation_or_a_cell_there_is_no_tissue(bench):
    surface = bench.surface(80.0)
    camera = replaced(surface.camera, metres_per_unit=None)
    nothing = bench.surface(80.0, known=lambda u, _: np.zeros(u.shape, bool))
    for useless in (replaced(surface, camera=camera), replaced(surface, deviation=None), nothing):
        assert known_tissue(useless) is None
