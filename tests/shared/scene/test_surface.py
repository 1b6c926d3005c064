"""Rays meet the surface where geometry has it, and both eyes see one and the same background."""

import cv2
import numpy as np
import pytest

from schemas.messages import RectifiedStereo
from shared.scene.render import render_backdrop
from shared.scene.surface import depth_at_points, flat_surface, meet_rays, ray_tangents, tissue_surface

CAMERA = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("eye_x_mm", [0.0, 5.5])
def test_every_ray_ends_on_the_surface(seed, eye_x_mm):
    surface = tissue_surface(CAMERA, 95.0, seed)
    p, q = ray_tangents(CAMERA)
    z = meet_rays(surface, p, q, eye_x_mm)
    ends = np.column_stack(((eye_x_mm + p * z).ravel(), (q * z).ravel())).astype(np.float64)
    assert np.abs(depth_at_points(surface, ends[:30000]) - z.ravel()[:30000]).max() < 2e-3
    assert z.min() > 80.0
    assert z.max() < 115.0


def test_both_cameras_see_surface_that_was_made_for_them():
    surface = tissue_surface(CAMERA, 95.0, 2)
    p, q = ray_tangents(CAMERA)
    rows, columns = surface.depth_mm.shape
    for eye_x_mm in (0.0, CAMERA.baseline):
        z = meet_rays(surface, p, q, eye_x_mm)
        column = (eye_x_mm + p * z - surface.x0_mm) / surface.step_mm
        row = (q * z - surface.y0_mm) / surface.step_mm
        assert column.min() >= 0
        assert column.max() <= columns - 1
        assert row.min() >= 0
        assert row.max() <= rows - 1


def test_a_flat_surface_is_equally_deep_everywhere():
    p, q = ray_tangents(CAMERA)
    assert (meet_rays(flat_surface(88.0), p, q, 5.5) == 88.0).all()


def shift_left_over(seen: np.ndarray, expected: np.ndarray) -> float:
    """By how many pixels along u the seen image differs from the expected one, by its gradient (Lucas and Kanade)."""
    # the vignette stays with each camera, so that only detail can be compared
    seen, expected = (image - cv2.GaussianBlur(image, (0, 0), 4.0) for image in (seen, expected))
    gradient = np.gradient(expected, axis=1)
    difference = seen - expected
    # gloss moves with the eye, so that what differs strongly is no texture
    same = np.abs(difference) < 8.0
    return float((gradient * difference)[same].sum() / (gradient**2)[same].sum())


@pytest.mark.parametrize("seed", [1, 2])
def test_the_background_has_the_disparity_of_its_depth(seed):
    backdrop = render_backdrop(CAMERA, "tissue", 95.0, seed)
    columns, rows = np.meshgrid(np.arange(480, dtype=np.float32), np.arange(270, dtype=np.float32))
    left = backdrop.left_bgr[..., 1].astype(np.float32)
    right = backdrop.right_bgr[..., 1].astype(np.float32)

    def expected(depth_error_mm: float) -> np.ndarray:
        disparity = CAMERA.fx_px * CAMERA.baseline / (backdrop.depth_right_mm + depth_error_mm)
        return cv2.remap(left, columns + disparity.astype(np.float32), rows, cv2.INTER_CUBIC)

    seen = slice(0, 270), slice(0, 430)
    assert abs(shift_left_over(right[seen], expected(0.0)[seen])) < 0.02
    # a millimetre is 0.3 px here, of which the estimate keeps a part, since it leaves out what differs most
    assert shift_left_over(right[seen], expected(1.0)[seen]) > 0.08


def test_gloss_differs_between_the_eyes_by_more_than_disparity():
    backdrop = render_backdrop(CAMERA, "tissue", 95.0, 1)
    columns, rows = np.meshgrid(np.arange(480, dtype=np.float32), np.arange(270, dtype=np.float32))
    disparity = CAMERA.fx_px * CAMERA.baseline / backdrop.depth_right_mm
    moved = cv2.remap(backdrop.left_bgr, columns + disparity, rows, cv2.INTER_LINEAR)
    glints = backdrop.right_bgr.min(axis=2) > 240
    assert 0.001 < glints.mean() < 0.06
    assert (moved[glints].min(axis=1) < 200).mean() > 0.05
