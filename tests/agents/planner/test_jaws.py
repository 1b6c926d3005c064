"""The outline of the jaws, and what of it is nearest to the tissue."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.planner.config import PlannerConfig
from agents.planner.jaws import capture_pass, grasp_pass, nearest_to_tissue, outline, slide_pass
from schemas.messages import Phase
from shared.rigid_transforms import exp_so3, transform

CONFIG = PlannerConfig()
CERTAIN = dataclasses.replace(CONFIG, sigmas=0.0)


@pytest.mark.parametrize("jaw_deg", [0.0, 20.0, 60.0])
def test_the_tips_are_where_the_fingers_end_and_as_wide_and_as_thick_as_told(jaw_deg):
    points, half = outline(np.radians(jaw_deg), CONFIG), np.radians(0.5 * jaw_deg)
    assert points[:, 2].max() == pytest.approx(0.0102 * np.cos(half))
    assert np.ptp(points[:, 0]) == pytest.approx(0.002)
    assert points[:, 1].max() == pytest.approx(0.0102 * np.sin(half) + 0.001 * np.cos(half))
    mirrored = points * (1.0, -1.0, 1.0)
    assert {tuple(p) for p in np.round(points, 9) + 0.0} == {tuple(p) for p in np.round(mirrored, 9) + 0.0}


@pytest.mark.parametrize(
    ("passed", "deepest_mm", "phase"),
    [
        (capture_pass(CONFIG), 10.2 * np.cos(np.radians(10)), Phase.CAPTURE),
        (slide_pass(CONFIG), 10.2 * np.cos(np.radians(10)), Phase.SLIDE),
        (grasp_pass(CONFIG), 10.2, Phase.GRASP),
    ],
)
def test_before_a_wall_that_faces_the_camera_the_tips_are_nearest(bench, passed, deepest_mm, phase):
    pin = transform(np.eye(3), np.array([0.0, 0.0, 0.05]))
    found = nearest_to_tissue(bench.tissue(70.0).tissue, pin[None], passed, CERTAIN)
    # along the ray, which is a little oblique
    assert found.clearance_m[0] == pytest.approx(1e-3 * (20.0 - deepest_mm), abs=2e-5)
    assert passed.phase[found.step[0]] is phase
    assert found.known[0] == 1
    assert found.place_camera[0, 2] == pytest.approx(0.05 + 1e-3 * deepest_mm)


@given(st.tuples(*[st.floats(-0.01, 0.01)] * 3), st.floats(0, 3), st.floats(0.5, 10))
def test_tissue_that_is_deeper_is_farther_from_the_jaws(bench, turn, sigmas, deeper):
    config = dataclasses.replace(CONFIG, sigmas=sigmas)
    pose = transform(exp_so3(30 * np.array(turn)), np.array([turn[1], turn[2], 0.05]))[None]
    near, far = (
        nearest_to_tissue(bench.tissue(z).tissue, pose, capture_pass(config), config) for z in (70, 70 + deeper)
    )
    assert far.bound_m[0] > near.bound_m[0]


def test_the_more_deviations_count_the_less_is_left(bench):
    pose = transform(np.eye(3), np.array([0.0, 0.0, 0.05]))[None]
    found = [
        nearest_to_tissue(
            bench.tissue(70.0, deviation_mm=0.5).tissue,
            pose,
            slide_pass(CONFIG),
            dataclasses.replace(CONFIG, sigmas=sigmas),
        )
        for sigmas in (0.0, 1.0, 2.0)
    ]
    np.testing.assert_allclose(np.diff([f.bound_m[0] for f in found]), -0.0005, rtol=0.02)
    np.testing.assert_allclose([f.deviation_m[0] for f in found], 0.0005, rtol=0.02)


def test_the_way_in_counts_too(bench):
    """A ridge that only the jaws on their way to the thread would touch: they come slantwise from below."""
    slant = exp_so3(np.array([-np.radians(60), 0, 0]))
    pose = transform(slant, np.array([0.0, 0.0, 0.06]) - 0.0082 * slant[:, 2])[None]
    ridge = bench.tissue(lambda _, v: np.where(np.abs(v - 170) < 60, 45.0, 80.0)).tissue
    arrived = nearest_to_tissue(ridge, pose, slide_pass(CERTAIN), CERTAIN)
    coming = nearest_to_tissue(ridge, pose, capture_pass(CERTAIN), CERTAIN)
    assert coming.bound_m[0] < arrived.bound_m[0]
    assert capture_pass(CERTAIN).phase[coming.step[0]] is Phase.APPROACH


def test_where_nothing_is_known_nothing_is_told(bench):
    pose = transform(np.eye(3), np.array([0.0, 0.0, 0.05]))[None]
    tissue = bench.tissue(70.0, known=lambda u, _: u > 700).tissue
    found = nearest_to_tissue(tissue, pose, slide_pass(CONFIG), CONFIG)
    assert found.known[0] == 0
    assert found.bound_m[0] == np.inf
    assert np.isnan(found.clearance_m[0])
