"""The outline of the jaws, and what of it is nearest to the tissue."""

import dataclasses

import numpy as np
import pytest

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
