"""Drawn stitches: where they lie, and that nothing is seen of the thread between its holes."""

import numpy as np
import pytest

from agents.camera.scene_source import camera_in_mm
from agents.simulator.agent import ENDOSCOPE
from shared.camera import project
from shared.rendering.render import render_backdrop
from shared.rendering.stitches import GAP_MM, STANDING_MM, TAIL_MM, render_strands, stitch_on, strand_thread
from shared.rendering.surface import depth_at_points, flat_surface
from shared.rendering.thread_shapes import ShapeError

CAMERA = camera_in_mm(ENDOSCOPE)
GROUND = flat_surface(95.0)


def length(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


def test_stitches_are_as_long_as_they_may_be_lie_on_the_tissue_in_view_and_are_drawn_by_their_seed():
    drawn = [stitch_on(CAMERA, GROUND, seed) for seed in range(1, 7)]
    for stitch in drawn:
        gap = np.linalg.norm(stitch.holes[1] - stitch.holes[0])
        assert GAP_MM[0] - 0.01 <= gap <= GAP_MM[1] + 0.01
        for points, limits in ((stitch.tail, TAIL_MM), (stitch.standing, STANDING_MM)):
            assert limits[0] - 0.5 < length(points) < limits[1] + 0.5
            above = depth_at_points(GROUND, points[:, :2]) - points[:, 2]
            assert above[0] == pytest.approx(0.0, abs=1e-5) and above[1:] == pytest.approx(stitch.radius_mm, abs=1e-5)
            for pixels in project(CAMERA, points):
                assert (pixels > 0).all() and (pixels < (CAMERA.image_width, CAMERA.image_height)).all()
    again = stitch_on(CAMERA, GROUND, 3)
    assert np.array_equal(again.tail, drawn[2].tail) and again.knot_mm == drawn[2].knot_mm
    assert not np.array_equal(drawn[0].tail[:20], drawn[1].tail[:20])
    with pytest.raises(ShapeError, match="wider or more distant"):
        stitch_on(CAMERA, flat_surface(30.0), 1)


def test_both_strands_are_drawn_and_nothing_between_their_holes():
    stitch = stitch_on(CAMERA, GROUND, 1)
    backdrop = render_backdrop(CAMERA, "plain", 95.0, 1)
    strands = tuple(strand_thread(points, stitch.radius_mm) for points in (stitch.tail, stitch.standing))
    left, right = render_strands(CAMERA, strands, stitch.holes[:0], stitch.radius_mm, "violet", backdrop)
    with_holes, _ = render_strands(CAMERA, strands, stitch.holes, stitch.radius_mm, "violet", backdrop)

    def differs(image, points, eye):
        u, v = np.rint(project(CAMERA, points)[eye]).astype(int).T
        return np.abs(image[v, u].astype(int) - backdrop.left_bgr[v, u]).max(axis=1) > 20

    between = stitch.holes[0] + np.linspace(0.15, 0.85, 30)[:, None] * (stitch.holes[1] - stitch.holes[0])
    for eye, image in enumerate((left, right)):
        for points in (stitch.tail, stitch.standing):
            assert differs(image, points[1:-1], eye).all()
        assert not differs(image, between, eye).any()
    assert (with_holes <= left).all() and (with_holes < left).any()


def test_a_strand_of_which_nothing_is_left_is_not_drawn():
    assert strand_thread(np.zeros((0, 3)), 0.2) is None
    assert strand_thread(np.array([(0.0, 0.0, 90.0), (0.1, 0.0, 90.0)]), 0.2) is None
