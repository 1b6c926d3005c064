"""Instruments stand above the ground and pass through no thread; what breaks either rule is told."""

from dataclasses import replace

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.camera import project
from shared.scene.path_traced.placing import bystanders, clear_of
from shared.scene.path_traced.recipe import Recipe, arranged
from shared.scene.path_traced.solids import instrument, pose_towards, silhouette
from shared.scene.path_traced.splines import sampled
from shared.scene.surface import depth_at_points


@pytest.fixture(scope="module")
def field():
    """A thread on flesh, and nothing else."""
    return arranged(Recipe("easy", "chicken", 4), endoscope(320, 180)).field


def held(tip):
    """An instrument whose jaws close there."""
    pose = pose_towards(np.asarray(tip, float), 0.3, 0.5, 0.0)
    return pose, instrument(pose, 3.0, 0.0, "steel", np.random.default_rng(0))


def test_an_instrument_in_the_air_is_clear_and_one_in_the_ground_or_through_the_thread_is_not(field):
    surface, alone = field.ground.surface, replace(field, strands=[])
    (aside,) = depth_at_points(surface, np.array([[0.0, -12.0]]))
    assert clear_of(held((0.0, -12.0, float(surface.depth_mm.min()) - 25.0))[1], alone)
    assert not clear_of(held((0.0, -12.0, aside + 1.0))[1], alone)
    points = sampled(field.strands[0].curve, 0.5)[0]
    middle = points[len(points) // 2]
    through = held(middle - 30.0 * held(middle)[0].towards_shaft)[1]
    deeper = replace(field.ground, surface=replace(surface, depth_mm=surface.depth_mm + 200.0))
    assert not clear_of(through, replace(field, ground=deeper))
    assert clear_of(through, replace(alone, ground=deeper))


def test_what_hides_the_thread_hides_a_third_from_both_eyes_and_leaves_its_ends_to_be_seen():
    field = arranged(Recipe("occlusion", "chicken", 1), endoscope(320, 180)).field
    assert clear_of(field.tools, field)
    points = sampled(field.strands[0].curve, 0.5)[0]
    tips = np.vstack((points[: len(points) // 9], points[-(len(points) // 9) :]))
    for eye, at_mm in enumerate((0.0, field.camera.baseline)):
        cover = silhouette(field.camera, field.tools, at_mm) > 0
        for places, least, most in ((tips, 0.0, 0.0), (points, 0.3, 0.51)):
            u, v = np.rint(project(field.camera, places)[eye]).astype(int).T
            assert least <= cover[v, u].mean() <= most


def test_bystanders_are_clear_of_thread_and_ground(field):
    tools = bystanders(field, np.random.default_rng(5), 2, 4.0)
    assert tools
    assert clear_of(tools, field)
