"""The tissue of rendered scenes against the depth that the renderer drew it at."""

import dataclasses
import functools

import numpy as np
import pytest

from agents.perception.surface import surface_is_due, tissue_surface
from schemas.codec import decode, encode
from schemas.messages import FrameStamp, TissueSurface
from shared.scene.__main__ import make_scene
from shared.scene.render import render, render_backdrop

STAMP = FrameStamp(4, 5, 6, "made up")


@functools.cache
def measured(config, seed, background="tissue"):
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
    assert np.median(error) < 0.5
    assert np.percentile(error, 95) < 1.5


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


@pytest.mark.parametrize("shape", [(1, 1), (5, 700), (700, 5), (64, 64)])
def test_images_of_any_size_give_a_surface(shape):
    camera = make_scene("easy", "tissue", 12).camera
    small = dataclasses.replace(camera, image_width=shape[1], image_height=shape[0])
    image = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    surface = tissue_surface(STAMP, small, image, image, np.zeros(shape, bool))
    assert decode(TissueSurface, encode(surface)).depth.shape == surface.valid.shape


@pytest.mark.parametrize(("left_out", "surfaces"), [(0, 11), (2, 9), (9, 2), (14, 1)])
def test_a_surface_is_due_once_in_so_many_frames_of_which_four_were_looked_at_and_not_with_the_very_first(
    left_out, surfaces
):
    stamps = [FrameStamp(number, 0, 0, "") for number in range(0, 120, left_out + 1)]
    due = [surface_is_due(now, before) for before, now in zip([None, *stamps], stamps, strict=False)]
    assert sum(due) == surfaces
    assert not due[0]
