"""The tissue of rendered scenes against the depth that the renderer drew it at."""

import dataclasses
import functools
from typing import Any

import cv2
import numpy as np
import pytest

from agents.perception.surface import tissue_surface
from schemas.codec import decode, encode
from schemas.messages import FrameStamp, TissueSurface
from shared.scene.__main__ import ENDOSCOPE, make_scene
from shared.scene.render import render, render_backdrop

STAMP = FrameStamp(4, 5, 6, "made up")


@functools.cache
def measured(config, seed, background="tissue") -> Any:
    scene = make_scene(config, background, seed)
    pair = render(scene)
    thread = pair.coverage_left > 0
    surface = tissue_surface(STAMP, scene.camera, pair.left_bgr, pair.right_bgr, thread)
    behind = render_backdrop(scene.camera, background, scene.distance_mm, scene.seed)
    return decode(TissueSurface, encode(surface)), thread, behind.depth_left_mm


def errors(config, seed):
    """By how much the valid cells' depth is off, their stated deviation, and their rows and columns in the image."""
    surface, _, truth = measured(config, seed)
    v, u = np.nonzero(surface.valid)
    at = np.round(surface.v_px[v]).astype(int), np.round(surface.u_px[u]).astype(int)
    return np.abs(surface.depth[v, u] - truth[at]), surface.deviation[v, u], at


@pytest.mark.slow
@pytest.mark.parametrize(("config", "seed"), [("easy", 12), ("medium", 32)])
def test_tissue_is_measured_to_a_millimetre_where_it_is_valid(config, seed):
    surface, thread, _ = measured(config, seed)
    error, _, at = errors(config, seed)
    assert surface.valid.mean() > 0.7
    assert np.median(error) < 0.3
    assert np.percentile(error, 95) < 1.0
    # the thread does not stand out of the tissue
    beside = np.array([thread[r - 15 : r + 16, c - 15 : c + 16].any() for r, c in zip(*at, strict=True)])
    assert beside.sum() > 20
    assert np.percentile(error[beside], 90) < 1.5


@pytest.mark.slow
def test_errors_are_as_large_as_they_are_stated():
    stated = np.concatenate([errors(*scene)[0] / errors(*scene)[1] for scene in (("easy", 12), ("medium", 32))])
    assert 0.6 < (stated < 1).mean() < 0.75
    assert 0.93 < (stated < 2).mean() < 0.98
    assert (stated < 3).mean() > 0.985


def shifted_noise(disparity, shape=(270, 480)):
    """A textured plane that faces both eyes, at a disparity that need not be whole."""
    rng = np.random.default_rng(3)
    wide = cv2.GaussianBlur(rng.uniform(0, 255, (shape[0], shape[1] + 200)), (0, 0), 2.0)
    wide = (wide - wide.mean()) / wide.std() * 40 + 128
    eyes = [
        cv2.warpAffine(wide, np.array([[1.0, 0.0, -100.0 - by], [0.0, 1.0, 0.0]]), shape[::-1])
        for by in (0.0, disparity)
    ]
    left, right = (np.clip(np.rint(eye), 0, 255).astype(np.uint8)[..., None].repeat(3, axis=2) for eye in eyes)
    return left, right


@pytest.mark.parametrize("disparity", [20.0, 20.5, 41.3])
def test_no_disparity_is_drawn_to_a_whole_one(disparity):
    camera = dataclasses.replace(ENDOSCOPE, image_width=480, image_height=270)
    surface = tissue_surface(STAMP, camera, *shifted_noise(disparity), np.zeros((270, 480), bool))
    found = camera.fx_px * camera.baseline / surface.depth[surface.valid]
    assert surface.valid.mean() > 0.8
    assert abs(np.median(found) - disparity) < 0.04


def test_a_tool_before_the_tissue_is_measured_where_it_is():
    """What is far nearer than the rest still lies within the disparities that are searched."""
    camera = dataclasses.replace(ENDOSCOPE, image_width=480, image_height=270)
    (left, right), near = shifted_noise(20.0), shifted_noise(45.0)
    left[100:180, 200:300], right[100:180, 155:255] = near[0][100:180, 200:300], near[1][100:180, 155:255]
    surface = tissue_surface(STAMP, camera, left, right, np.zeros((270, 480), bool))
    middle = np.ix_((surface.v_px > 120) & (surface.v_px < 160), (surface.u_px > 220) & (surface.u_px < 280))
    assert surface.valid[middle].mean() > 0.7
    found = camera.fx_px * camera.baseline / surface.depth[middle][surface.valid[middle]]
    np.testing.assert_allclose(np.median(found), 45.0, atol=0.1)


def test_a_plain_ground_is_nowhere_valid():
    camera = dataclasses.replace(ENDOSCOPE, image_width=480, image_height=270)
    plain = np.full((270, 480, 3), 128, np.uint8)
    surface = tissue_surface(STAMP, camera, plain, plain, np.zeros((270, 480), bool))
    assert surface.valid.mean() < 0.05
    assert (surface.depth[~surface.valid] == 0).all()


@pytest.mark.slow
def test_the_grid_covers_the_image():
    surface, thread, _ = measured("easy", 12)
    for middles, size in ((surface.u_px, thread.shape[1]), (surface.v_px, thread.shape[0])):
        step = np.diff(middles)[0]
        np.testing.assert_allclose(middles[0] + 0.5, step / 2)
        assert size - step < middles[-1] + step / 2 + 0.5 <= size


def test_no_cell_stands_alone():
    """What matches nothing beside it is a false match: on this scene one cell was off by centimetres."""
    camera = dataclasses.replace(ENDOSCOPE, image_width=480, image_height=270, fx_px=500.0, fy_px=500.0)
    camera = dataclasses.replace(camera, cx_px=239.5, cy_px=134.5)
    scene = make_scene("medium", "tissue", 2005, distance_mm=82.0, camera=camera)
    pair = render(scene)
    surface = tissue_surface(STAMP, camera, pair.left_bgr, pair.right_bgr, pair.coverage_left > 0)
    assert np.abs(surface.depth[surface.valid] - 82.0).max() < 15


@pytest.mark.parametrize("shape", [(1, 1), (5, 200), (64, 64)])
def test_images_of_any_size_give_a_surface(shape):
    small = dataclasses.replace(ENDOSCOPE, image_width=shape[1], image_height=shape[0])
    image = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    surface = tissue_surface(STAMP, small, image, image, np.zeros(shape, bool))
    assert decode(TissueSurface, encode(surface)).depth.shape == surface.valid.shape
