"""The tissue as a height field along the viewing rays, and what of the jaws is nearest to it."""

import dataclasses
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.planner.config import PlannerConfig
from agents.planner.jaws import capture_pass, nearest_to_tissue, slide_pass
from agents.planner.tissue import clearance, tissue_of
from schemas.messages import Phase
from shared.rigid_transforms import exp_so3, transform
from tests.agents.planner import bench

CERTAIN = PlannerConfig(sigmas=0.0)
PLACES = arrays(np.float64, (30, 3), elements=st.floats(-1, 1)).map(lambda p: p * (0.015, 0.01, 0.01) + (0, 0, 0.07))


def slanted(u, v):
    """The plane z = 80 + 0.5 x − 0.25 y in millimetres, where each ray meets it."""
    return 80.0 / (1.0 - 0.5 * (u - 479.5) / 1000.0 + 0.25 * (v - 269.5) / 1000.0)


def tissue_without(*columns, depth_mm=slanted) -> Any:
    """All is known but these columns of cells."""
    return bench.tissue(depth_mm, known=lambda u, _: ~np.isin(np.round((u - 11.5) / 24), columns)).tissue


@settings(max_examples=15)
@given(PLACES)
def test_before_a_plane_the_clearance_is_the_way_along_the_ray_in_any_unit(places):
    surface = bench.surface(slanted)
    of_surface: Any = tissue_of(surface)
    off, deviation = clearance(of_surface, places)
    stretch = 0.08 / (places @ [-0.5, 0.25, 1.0])
    np.testing.assert_allclose(off, (stretch - 1.0) * np.linalg.norm(places, axis=1), atol=1e-9)
    assert ((deviation > 0.9e-4) & (deviation < 1.3e-4)).all()
    camera = dataclasses.replace(surface.camera, baseline=surface.camera.baseline * 1e-3, metres_per_unit=1.0)
    assert surface.deviation is not None
    in_metres = {"camera": camera, "depth": surface.depth * 1e-3, "deviation": surface.deviation * 1e-3}
    of_metres: Any = tissue_of(dataclasses.replace(surface, **in_metres))
    np.testing.assert_allclose(clearance(of_metres, places)[0], off)


def test_what_a_thread_hides_is_known_from_both_sides_of_it_and_less_surely_where_that_is_rough():
    places = np.array([[-0.001, 0.0, 0.06], [-0.001, 0.01, 0.06]])
    whole, _ = clearance(tissue_without(), places)
    for gone in ((19,), (19, 20)):
        off, deviation = clearance(tissue_without(*gone), places)
        np.testing.assert_allclose(off, whole, atol=1e-9)
        assert (deviation < 1.5e-4).all()
    rng = np.random.default_rng(1)
    rough = tissue_without(19, depth_mm=lambda u, _: 80.0 + rng.normal(0, 2.0, u.shape))
    assert (clearance(rough, places)[1] > 1e-3).all()


def test_what_is_unknown_over_a_wide_stretch_outside_or_behind_the_camera_stays_unknown():
    tissue = tissue_without(*range(17, 22))
    expected = np.tile(~np.isin(np.arange(40), range(17, 22)), (22, 1))
    np.testing.assert_array_equal(np.isfinite(tissue.inverse_depth), expected)
    np.testing.assert_array_equal(np.isfinite(tissue.deviation), expected)
    outside = np.array([[0.2, 0, 0.06], [0, -0.1, 0.06], [0, 0, -0.06], [0, 0, 0.0], [-0.0285, 0, 0.06]])
    assert np.isnan(clearance(tissue_without(), outside)).all()
    surface = bench.surface(80.0)
    unitless = dataclasses.replace(surface.camera, metres_per_unit=None)
    for changes in ({"camera": unitless}, {"deviation": None}):
        assert tissue_of(dataclasses.replace(surface, **changes)) is None
    assert tissue_without(*range(40)) is None


def test_the_way_in_counts_too():
    """A ridge that only the jaws on their way to the thread would touch: they come slantwise from below."""
    slant = exp_so3(np.array([-np.radians(60), 0, 0]))
    pose = transform(slant, np.array([0.0, 0.0, 0.06]) - 0.0082 * slant[:, 2])[None]
    ridge: Any = bench.tissue(lambda _, v: np.where(np.abs(v - 170) < 60, 45.0, 80.0)).tissue
    arrived, coming = (nearest_to_tissue(ridge, pose, of(CERTAIN), CERTAIN) for of in (slide_pass, capture_pass))
    assert coming.bound_m[0] < arrived.bound_m[0]
    assert capture_pass(CERTAIN).phase[coming.step[0]] is Phase.APPROACH
