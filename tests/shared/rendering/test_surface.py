"""Rays meet the surface where geometry has it, and both eyes see one and the same background."""

import cv2
import numpy as np
import pytest

from schemas.messages import RectifiedStereo
from shared.rendering.render import render_backdrop
from shared.rendering.surface import depth_at_points, flat_surface, meet_rays, ray_tangents, tissue_surface

CAMERA = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)


@pytest.mark.parametrize("eye_x_mm", [0.0, CAMERA.baseline])
def test_every_ray_ends_on_the_surface_which_was_made_wide_enough(eye_x_mm):
    surface = tissue_surface(CAMERA, 95.0, 2)
    p, q = ray_tangents(CAMERA)
    z = meet_rays(surface, p, q, eye_x_mm)
    ends = np.column_stack(((eye_x_mm + p * z).ravel(), (q * z).ravel())).astype(np.float64)
    assert np.abs(depth_at_points(surface, ends[:30000]) - z.ravel()[:30000]).max() < 2e-3
    assert 80.0 < z.min() < z.max() < 115.0
    place = (ends - (surface.x0_mm, surface.y0_mm)) / surface.step_mm
    assert place.min() >= 0
    assert (place <= np.array(surface.depth_mm.shape[::-1]) - 1).all()
    assert (meet_rays(flat_surface(88.0), p, q, eye_x_mm) == 88.0).all()


def shift_left_over(seen: np.ndarray, expected: np.ndarray) -> float:
    """By how many pixels along u the seen image differs from the expected one, by its gradient (Lucas and Kanade)."""
    # the vignette stays with each camera, so that only detail can be compared
    seen, expected = (image - cv2.GaussianBlur(image, (0, 0), 4.0) for image in (seen, expected))
    gradient = np.gradient(expected, axis=1)
    difference = seen - expected
    # gloss moves with the eye, so that what differs strongly is no texture
    same = np.abs(difference) < 8.0
    return float((gradient * difference)[same].sum() / (gradient**2)[same].sum())


def test_the_background_has_the_disparity_of_its_depth():
    backdrop = render_backdrop(CAMERA, "tissue", 95.0, 1)
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
