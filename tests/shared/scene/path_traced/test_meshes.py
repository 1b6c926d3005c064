"""Needle drivers from their meshes: what is read, where their jaws are, and that lofts and triangles are told apart."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.camera import project
from shared.scene.path_traced.meshes import (
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
from shared.scene.path_traced.placing import clear_of
from shared.scene.path_traced.recipe import Recipe, arranged
from shared.scene.path_traced.solids import pose_towards, silhouette
from shared.scene.path_traced.splines import sampled
from shared.scene.render import SceneError

MESHES = Path("../shared/data/instruments")
needs_meshes = pytest.mark.skipif(not MESHES.exists(), reason=f"needs {MESHES}")
JOINTS = Joints(0.4, -0.3, 0.5)


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
    points = np.vstack([part.vertices for part in driver(driver_parts(MESHES), JOINTS) if not part.is_lofted])
    own = (points - pin) @ frame
    tips = own[own[:, 1] > 9.0]
    assert np.hypot(*tips[:, :2].T).max() == pytest.approx(JAW_MM, abs=0.4)
    # either jaw is half the opening away from the middle
    away = np.arctan2(tips[:, 0], tips[:, 1])
    for side in (-1.0, 1.0):
        assert np.median(away[side * away > 0]) == pytest.approx(side * 0.5 * JOINTS.opening, abs=0.08)
    tip = np.array([5.0, -3.0, 80.0])
    tools = posed(driver_parts(MESHES), pose_towards(tip, 0.3, 0.5, 1.0), replace(JOINTS, opening=0.0))
    ends = np.vstack([part.vertices for part in tools if not part.is_lofted])
    assert np.linalg.norm(ends - tip, axis=1).min() < 0.4


@needs_meshes
def test_the_silhouette_of_a_mesh_covers_what_it_projects_to_and_little_else():
    camera = endoscope(320, 180).near_enough
    part = placed([driver_parts(MESHES)[JAW]], np.eye(3), np.array([0.0, 0.0, 40.0]))[0]
    u, v = np.floor(project(camera, part.vertices)[0]).astype(int).T
    cover = silhouette(camera, [part])
    assert (cover[v, u] > 0).mean() > 0.95
    rows, columns = np.nonzero(cover)
    assert rows.min() >= v.min() - 1 and rows.max() <= v.max() + 1
    assert columns.min() >= u.min() - 1 and columns.max() <= u.max() + 1


@needs_meshes
def test_a_driver_through_the_thread_is_not_clear_of_it():
    field = arranged(Recipe("easy", "chicken", 4), endoscope(320, 180)).field
    surface = field.ground.surface
    above = replace(field, ground=replace(field.ground, surface=replace(surface, depth_mm=surface.depth_mm + 200.0)))
    points = sampled(field.strands[0].curve, 0.5)[0]
    pose, joints = pose_towards(points[len(points) // 2], 0.3, 0.5, 0.0), Joints(0.0, 0.0, 0.0)
    through = posed(driver_parts(MESHES), replace(pose, tip=pose.tip - 15.0 * pose.towards_shaft), joints)
    assert not clear_of(through, above)
    assert clear_of(through, replace(above, strands=[]))
