"""Instruments: their meshes and jaws, where they stand clear of thread and ground, and what they hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.camera import project
from shared.rendering.path_traced.holding import holding_needle, holding_thread
from shared.rendering.path_traced.meshes import (
    JAW,
    JAW_MM,
    LONGEST_EDGE_MM,
    Joints,
    driver,
    driver_parts,
    jaw_frame,
    placed,
    posed,
    read_mesh,
)
from shared.rendering.path_traced.placing import above_ground, bystanders, clear_of
from shared.rendering.path_traced.recipe import Recipe, arranged
from shared.rendering.path_traced.solids import instrument, pose_towards, silhouette
from shared.rendering.path_traced.splines import sampled
from shared.rendering.render import SceneError
from shared.rendering.surface import depth_at_points

MESHES = Path("../shared/data/instruments")
needs_meshes = pytest.mark.skipif(not MESHES.exists(), reason=f"needs {MESHES}")
JOINTS = Joints(0.4, -0.3, 0.5)
RIG = endoscope(320, 180)


def corners_of(tools):
    return np.vstack([tool.vertices for tool in tools if not tool.is_lofted])


@needs_meshes
def test_meshes_are_in_mm_with_unit_normals_and_short_edges():
    jaw = driver_parts(MESHES)[JAW]
    assert np.ptp(jaw.vertices, axis=0) == pytest.approx((5.0, 13.1, 2.25), abs=0.1)
    assert jaw.normals is not None
    np.testing.assert_allclose(np.linalg.norm(jaw.normals, axis=1), 1.0, atol=1e-6)
    corners = jaw.vertices[jaw.faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= LONGEST_EDGE_MM


@pytest.mark.parametrize(("text", "said"), [(None, "cannot read"), ("<COLLADA/>", "is no mesh"), ("no", "is no mesh")])
def test_a_mesh_that_is_absent_or_none_is_named(tmp_path, text, said):
    if text is not None:
        (tmp_path / "tip.dae").write_text(text)
    with pytest.raises(SceneError, match=rf"{said}|tip.dae {said}"):
        read_mesh(tmp_path / "tip.dae")


@needs_meshes
def test_jaws_open_about_their_middle_and_end_at_the_pose():
    frame, pin = jaw_frame(JOINTS)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)
    own = (corners_of(driver(driver_parts(MESHES), JOINTS)) - pin) @ frame
    tips = own[own[:, 1] > 9.0]
    assert np.hypot(*tips[:, :2].T).max() == pytest.approx(JAW_MM, abs=0.4)
    # either jaw is half the opening away from the middle
    away = np.arctan2(tips[:, 0], tips[:, 1])
    for side in (-1.0, 1.0):
        assert np.median(away[side * away > 0]) == pytest.approx(side * 0.5 * JOINTS.opening, abs=0.08)
    tip = np.array([5.0, -3.0, 80.0])
    tools = posed(driver_parts(MESHES), pose_towards(tip, 0.3, 0.5, 1.0), replace(JOINTS, opening=0.0))
    assert np.linalg.norm(corners_of(tools) - tip, axis=1).min() < 0.4


@needs_meshes
def test_the_silhouette_of_a_mesh_covers_what_it_projects_to_and_little_else():
    part = placed([driver_parts(MESHES)[JAW]], np.eye(3), np.array([0.0, 0.0, 40.0]))[0]
    u, v = np.floor(project(RIG.near_enough, part.vertices)[0]).astype(int).T
    cover = silhouette(RIG.near_enough, [part])
    assert (cover[v, u] > 0).mean() > 0.95
    for at, of in zip(np.nonzero(cover), (v, u), strict=True):
        assert of.min() - 1 <= at.min() <= at.max() <= of.max() + 1


@pytest.fixture(scope="module")
def field():
    """A thread on flesh, and nothing else."""
    return arranged(Recipe("easy", "chicken", 4), RIG).field


def lower(field):
    """The same thread far above the ground."""
    surface = field.ground.surface
    return replace(field, ground=replace(field.ground, surface=replace(surface, depth_mm=surface.depth_mm + 200.0)))


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
    pose, _ = held(points[len(points) // 2])
    through = held(pose.tip - 30.0 * pose.towards_shaft)[1]
    assert not clear_of(through, lower(field))
    assert clear_of(through, lower(alone))
    tools = bystanders(field, np.random.default_rng(5), 2, 4.0)
    assert tools
    assert clear_of(tools, field)


@needs_meshes
def test_a_driver_through_the_thread_is_not_clear_of_it(field):
    points = sampled(field.strands[0].curve, 0.5)[0]
    pose = pose_towards(points[len(points) // 2], 0.3, 0.5, 0.0)
    pose = replace(pose, tip=pose.tip - 15.0 * pose.towards_shaft)
    through = posed(driver_parts(MESHES), pose, Joints(0.0, 0.0, 0.0))
    assert not clear_of(through, lower(field))
    assert clear_of(through, replace(lower(field), strands=[]))


def first_held(hold, field):
    """The instrument that holds something, by the first seed that finds a place for it."""
    found = (hold(field, driver_parts(MESHES), np.random.default_rng(seed)).tools for seed in range(6))
    return next(tools for tools in found if tools)


def gap(tools, points):
    return min(float(np.linalg.norm(corners_of(tools) - point, axis=1).min()) for point in points)


@pytest.mark.slow
@needs_meshes
def test_a_needle_is_held_between_jaws_above_the_ground_and_a_thread_by_its_end_in_the_air():
    field = arranged(Recipe("needle", "phantom", 1), RIG).field
    tools, needle = first_held(holding_needle, field), field.needle
    assert above_ground(tools, field)
    assert needle is not None
    assert gap(tools, sampled(needle.curve, 0.1)[0]) < needle.radius_mm + 0.4
    field = arranged(Recipe("easy", "phantom", 4), RIG).field
    (strand,) = field.strands
    near = replace(strand.curve, control_points=strand.curve.control_points - (0.0, 0.0, 12.0))
    tools = first_held(holding_thread, replace(field, strands=[replace(strand, curve=near)]))
    assert gap(tools, near.at(np.array([float(near.spans)]))) < 2.0
