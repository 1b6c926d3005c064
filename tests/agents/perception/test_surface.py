"""The tissue of rendered scenes against the depth that the renderer drew it at."""

import dataclasses
import functools
from typing import Any

import cv2
import numpy as np
import pytest

from agents.perception.surface import surface_is_due, tissue_surface
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


@pytest.mark.parametrize(("config", "seed"), [("easy", 12), ("medium", 32), ("crossing", 34)])
def test_tissue_is_measured_to_a_millimetre_where_it_is_valid(config, seed):
    surface, _, truth = measured(config, seed)
    v, u = np.nonzero(surface.valid)
    at = np.round(surface.v_px[v]).astype(int), np.round(surface.u_px[u]).astype(int)
    error = np.abs(surface.depth[v, u] - truth[at])
    assert surface.valid.mean() > 0.7
    assert np.median(error) < 0.3
    assert np.percentile(error, 95) < 1.0


def test_errors_are_as_large_as_they_are_stated():
    stated = []
    for config, seed in (("easy", 12), ("medium", 32), ("crossing", 34)):
        surface, _, truth = measured(config, seed)
        v, u = np.nonzero(surface.valid)
        at = np.round(surface.v_px[v]).astype(int), np.round(surface.u_px[u]).astype(int)
        stated.append(np.abs(surface.depth[v, u] - truth[at]) / surface.deviation[v, u])
    stated = np.concatenate(stated)
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


@pytest.mark.parametrize("disparity", [20.0, 20.25, 20.5, 20.75, 41.3])
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


def test_the_thread_does_not_stand_out_of_the_tissue():
    surface, thread, truth = measured("medium", 32)
    v, u = np.nonzero(surface.valid)
    rows, columns = np.round(surface.v_px[v]).astype(int), np.round(surface.u_px[u]).astype(int)
    beside = np.array([thread[r - 15 : r + 16, c - 15 : c + 16].any() for r, c in zip(rows, columns, strict=True)])
    assert beside.sum() > 20
    assert np.percentile(np.abs(surface.depth[v, u] - truth[rows, columns])[beside], 90) < 1.5


def test_a_plain_ground_is_nowhere_valid():
    surface, *_ = measured("easy", 12, "plain")
    assert surface.valid.mean() < 0.05
    assert (surface.depth[~surface.valid] == 0).all()


def test_the_grid_covers_the_image():
    surface, thread, _ = measured("easy", 12)
    for middles, size in ((surface.u_px, thread.shape[1]), (surface.v_px, thread.shape[0])):
        step = np.diff(middles)[0]
        np.testing.assert_allclose(middles[0] + 0.5, step / 2)
        assert size - step < middles[-1] + step / 2 + 0.5 <= size


def test_no_cell_stands_alone():
    """What matches nothing beside it is a false match: on each of these scenes one cell was off by centimetres."""
    camera = dataclasses.replace(ENDOSCOPE, image_width=480, image_height=270, fx_px=500.0, fy_px=500.0)
    camera = dataclasses.replace(camera, cx_px=239.5, cy_px=134.5)
    for config, distance, seed in (("medium", 82.0, 2005), ("hard", 95.0, 2010)):
        scene = make_scene(config, "tissue", seed, distance_mm=distance, camera=camera)
        pair = render(scene)
        surface = tissue_surface(STAMP, camera, pair.left_bgr, pair.right_bgr, pair.coverage_left > 0)
        assert np.abs(surface.depth[surface.valid] - distance).max() < 15


@pytest.mark.parametrize("shape", [(1, 1), (5, 700), (700, 5), (64, 64)])
def test_images_of_any_size_give_a_surface(shape):
    camera = make_scene("easy", "tissue", 12).camera
    small = dataclasses.replace(camera, image_width=shape[1], image_height=shape[0])
    image = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    surface = tissue_surface(STAMP, small, image, image, np.zeros(shape, bool))
    assert decode(TissueSurface, encode(surface)).depth.shape == surface.valid.shape


@pytest.mark.parametrize(("left_out", "surfaces"), [(0, 8), (2, 5), (9, 3), (14, 2)])
def test_a_surface_is_due_with_the_second_frame_that_is_looked_at_and_then_once_in_so_many(left_out, surfaces):
    frames = list(range(7, 127, left_out + 1))
    before, newest, due = None, None, []
    for frame in frames:
        if surface_is_due(frame, before, newest):
            newest = frame
            due.append(frame)
        before = frame
    assert len(due) == surfaces
    assert due[0] == frames[1]
    # another run of the camera counts from 0 again
    assert surface_is_due(0, before, newest)
