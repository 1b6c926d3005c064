"""Instruments stand above the ground and pass through no thread; what breaks either rule is told."""

from dataclasses import replace

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
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


def test_an_instrument_in_the_air_beside_the_thread_is_clear_and_one_in_the_ground_is_not(field):
    ground = float(field.ground.surface.depth_mm.min())
    (aside,) = depth_at_points(field.ground.surface, np.array([[0.0, -12.0]]))
    assert clear_of(held((0.0, -12.0, ground - 25.0))[1], replace(field, strands=[]))
    assert not clear_of(held((0.0, -12.0, aside + 1.0))[1], replace(field, strands=[]))


def test_an_instrument_through_the_thread_is_not_clear(field):
    points = sampled(field.strands[0].curve, 0.5)[0]
    middle = points[len(points) // 2]
    pose, _ = held(middle)
    through = instrument(
        replace(pose, tip=middle - 30.0 * pose.towards_shaft), 3.0, 0.0, "steel", np.random.default_rng(0)
    )
    above = replace(field, ground=replace(field.ground, surface=deeper(field.ground.surface)))
    assert not clear_of(through, above)
    assert clear_of(through, replace(above, strands=[]))


def deeper(surface):
    return replace(surface, depth_mm=surface.depth_mm + 200.0)


def test_what_hides_the_thread_leaves_its_ends_to_be_seen_by_both_eyes():
    field = arranged(Recipe("occlusion", "chicken", 1), endoscope(320, 180)).field
    tools = field.tools
    assert clear_of(tools, field)
    points = sampled(field.strands[0].curve, 0.5)[0]
    tips = np.vstack((points[: len(points) // 9], points[-(len(points) // 9) :]))
    for eye in (0.0, field.camera.baseline):
        cover = silhouette(field.camera, tools, eye) > 0
        for places, least, most in ((tips, 0.0, 0.0), (points, 0.3, 0.51)):
            u = field.camera.fx_px * (places[:, 0] - eye) / places[:, 2] + field.camera.cx_px
            v = field.camera.fy_px * places[:, 1] / places[:, 2] + field.camera.cy_px
            assert least <= cover[np.rint(v).astype(int), np.rint(u).astype(int)].mean() <= most


def test_bystanders_areclear_of_thread_and_ground(field):
    tools = bystanders(field, np.random.default_rng(5), 2, 4.0)
    assert tools
    assert clear_of(tools, field)
