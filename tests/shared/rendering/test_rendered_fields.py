"""The fields that come with the project fit both eyes at any distance, and other cameras see the same."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from shared.rendering.render import ENDOSCOPE, SceneError
from shared.rendering.rendered_fields import FIELDS, rendered_backdrop, rendered_surface
from shared.rendering.surface import depth_at_points

SEEDS = range(1, 1 + len(list(FIELDS.iterdir())))
SMALL = replace(ENDOSCOPE, image_width=480, image_height=270, fx_px=500.0, fy_px=500.0, cx_px=239.5, cy_px=134.5)


def dull(image):
    """Grey with glints, which are mirrored far behind the surface, taken out; and where those were."""
    grey = cv2.GaussianBlur(image.astype(np.float32).mean(axis=2), (0, 0), 1.0)
    return grey - cv2.GaussianBlur(grey, (0, 0), 8.0), cv2.dilate((grey > 185).astype(np.uint8), np.ones((25, 25))) > 0


@pytest.mark.parametrize(("seed", "distance_mm"), [(seed, 60.0 + 15.0 * seed) for seed in SEEDS])
def test_depth_carries_the_left_image_onto_the_right_one(seed, distance_mm):
    seen = rendered_backdrop(ENDOSCOPE, distance_mm, seed)
    u, v = np.meshgrid(np.arange(960, dtype=np.float32), np.arange(540, dtype=np.float32))
    disparity = ENDOSCOPE.fx_px * ENDOSCOPE.baseline / seen.depth_left_mm
    carried = cv2.remap(seen.right_bgr, (u - disparity).astype(np.float32), v, cv2.INTER_CUBIC)
    (left, glints), (right, others) = dull(seen.left_bgr), dull(carried)
    inner = ~(glints | others)
    inner[:, :100] = inner[:, -100:] = False
    slope = cv2.Sobel(left + right, cv2.CV_32F, 1, 0, scale=1 / 16)[inner]
    off_px = float((slope * (right - left)[inner]).sum() / (slope**2).sum())
    assert inner.mean() > 0.2
    assert abs(off_px) < 0.1
    assert np.corrcoef(left[inner], right[inner])[0, 1] > 0.9


def test_the_middle_is_as_far_away_as_asked_and_the_left_image_stays():
    near, far = (rendered_backdrop(ENDOSCOPE, distance_mm, 2) for distance_mm in (70.0, 110.0))
    assert (near.left_bgr == far.left_bgr).all()
    assert (near.right_bgr != far.right_bgr).any()
    for backdrop, distance_mm in ((near, 70.0), (far, 110.0)):
        middle = depth_at_points(backdrop.surface, np.zeros((1, 2)))[0]
        assert middle == pytest.approx(distance_mm)
        assert backdrop.depth_left_mm[270, 480] == pytest.approx(distance_mm, abs=0.05)
        assert np.ptp(backdrop.depth_left_mm) > 1.0
        assert sum(light.share for light in backdrop.lights) == pytest.approx(1.0)


def test_seeds_take_turns_and_name_the_same_surface():
    images = [rendered_backdrop(SMALL, 95.0, seed).left_bgr for seed in (*SEEDS, SEEDS[-1] + 1)]
    assert (images[0] == images[-1]).all()
    assert all(np.abs(images[0].astype(int) - other).mean() > 5 for other in images[1:-1])
    surface = rendered_surface(95.0, 3)
    assert (surface.depth_mm == rendered_backdrop(SMALL, 95.0, 3).surface.depth_mm).all()


def test_another_camera_sees_the_same_field_unless_it_sees_further_than_the_field_goes():
    whole, small = rendered_backdrop(ENDOSCOPE, 95.0, 1).left_bgr, rendered_backdrop(SMALL, 95.0, 1).left_bgr
    reduced = cv2.resize(whole, (480, 270), interpolation=cv2.INTER_AREA)
    assert np.abs(reduced.astype(int) - small).mean() < 3.0
    with pytest.raises(SceneError, match="sees further than the rendered fields go"):
        rendered_backdrop(replace(ENDOSCOPE, fx_px=500.0, fy_px=500.0), 95.0, 1)
