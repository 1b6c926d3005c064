"""The tube against brute-force ray casting, closed forms, and path-traced masks."""

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from schemas.messages import RectifiedStereo
from shared.camera import project
from shared.rendering.centreline import Centreline, Thread, sample_centreline, shifted_to_right
from shared.rendering.compositing import lay_over
from shared.rendering.surface import tissue_surface
from shared.rendering.thread_shapes import thread_on
from shared.rendering.tube import TubePixels, coverage_image, tube_pixels
from shared.splines import clamped_uniform_knots, evaluate

RENDERS = Path(__file__).parents[3] / "../shared/data/renders"
CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)


def straight(start: tuple[float, float, float], end: tuple[float, float, float], radius_mm: float) -> Thread:
    return Thread(clamped_uniform_knots(4), np.linspace(start, end, 4), radius_mm)


def dense(thread: Thread, count: int = 20000) -> np.ndarray:
    return evaluate(thread.knots, thread.control_points, thread.degree, np.linspace(0.0, 1.0, count))


def both_eyes(camera: RectifiedStereo, thread: Thread) -> list[tuple[TubePixels, np.ndarray]]:
    """The tube's pixels and the densely projected truth, left and right."""
    centreline = sample_centreline(camera, thread)
    eyes = (centreline, shifted_to_right(camera, centreline))
    truths = project(camera, dense(thread))
    return [(tube_pixels(camera, eye, thread.radius_mm), truth) for eye, truth in zip(eyes, truths, strict=True)]


@pytest.mark.slow
def test_the_coverage_is_that_of_rays_that_meet_the_tube():
    camera = RectifiedStereo(48, 36, 60.0, 75.0, -10.0, 21.0, 5.5, 1e-3)
    control_points = np.array([[12.0, -40, 75], [16, -8, 70], [50, 16, 66], [30, 40, 80], [95, 60, 90]])
    thread = Thread(clamped_uniform_knots(5), control_points, 1.7)
    sub = (np.arange(6) - 2.5) / 6
    for eye_x, (tube, _) in zip((0.0, camera.baseline), both_eyes(camera, thread), strict=True):
        u = (np.arange(48)[:, None] + sub).ravel()
        v = (np.arange(36)[:, None] + sub).ravel()
        p, q = np.meshgrid((u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px)
        rays = np.dstack((p, q, np.ones_like(p))).reshape(-1, 3)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        points = dense(thread, 400) - (eye_x, 0.0, 0.0)
        square_distance = (points**2).sum(axis=1) - (rays @ points.T) ** 2
        hit = (square_distance.min(axis=1) < thread.radius_mm**2).reshape(36, 6, 48, 6).mean(axis=(1, 3))
        difference = coverage_image(camera, tube) - hit
        assert hit.max() == 1.0
        assert np.abs(difference).max() < 0.06
        assert abs(difference.mean()) < 1e-3


def test_a_straight_thread_has_the_area_of_its_rectangle_or_of_a_disc_and_ends_where_its_centreline_does():
    thread = straight((-8.0, 0.0, 100.0), (8.0, 0.0, 100.0), 0.2)
    (tube, truth), _ = both_eyes(CAMERA, thread)
    assert tube.coverage.sum() == pytest.approx(160.0 * 4.0, rel=1e-4)
    columns = coverage_image(CAMERA, tube).sum(axis=0) / 4.0
    inside = np.flatnonzero(columns)
    assert inside[0] + 0.5 - columns[inside[0]] == pytest.approx(truth[0, 0], abs=0.01)
    assert inside[-1] - 0.5 + columns[inside[-1]] == pytest.approx(truth[-1, 0], abs=0.01)
    # one that points at the camera shows its near end
    (tube, _), _ = both_eyes(CAMERA, straight((0.0, 0.0, 80.0), (1e-7, 0.0, 100.0), 0.4))
    assert tube.coverage.sum() == pytest.approx(np.pi * 5.0**2, rel=0.03)


def test_the_nearer_strand_lies_on_top_whichever_end_the_thread_starts_from():
    thread = thread_on(CAMERA, tissue_surface(CAMERA, 95.0, 5), "crossing", 5)
    reverse = Thread(1.0 - thread.knots[::-1], thread.control_points[::-1], thread.radius_mm)
    for one in (thread, reverse):
        (tube, _), _ = both_eyes(CAMERA, one)
        image = np.zeros((540, 960, 3), dtype=np.uint8)
        # depth as colour, so that the image itself says which strand is seen
        lay_over(image, tube, np.repeat((tube.depth_mm - 70.0)[:, None] * 5.0, 3, axis=1))
        full = tube.coverage > 0.999
        flat, count = np.unique(tube.flat[full], return_counts=True)
        crossing = flat[count == 2]
        assert len(crossing) >= 4
        for pixel in crossing:
            depths = tube.depth_mm[full & (tube.flat == pixel)]
            assert depths.max() - depths.min() > 0.5
            assert image.reshape(-1, 3)[pixel, 0] == np.rint((depths.min() - 70.0) * 5.0)


def test_a_thread_is_drawn_as_far_as_it_is_in_view():
    for start, end in (
        ((-300.0, 0.0, 90.0), (-200.0, 5.0, 90.0)),
        ((0.0, 0.0, -50.0), (5.0, 5.0, -10.0)),
        ((0.0, 0.0, 5.0), (3.0, 2.0, 15.0)),
    ):
        assert all(len(tube.flat) == 0 for tube, _ in both_eyes(CAMERA, straight(start, end, 0.2)))
    for tube, _ in both_eyes(CAMERA, straight((-200.0, -3.0, 90.0), (200.0, 8.0, 90.0), 0.2)):
        assert len(np.unique(tube.flat % 960)) == 960
    # one that comes from behind the camera begins at the near limit
    for tube, _ in both_eyes(CAMERA, straight((0.0, 3.0, -20.0), (2.0, -2.0, 90.0), 0.2)):
        assert len(tube.flat) > 0
        assert tube.depth_mm.min() >= 20.0


@pytest.mark.renders
@pytest.mark.parametrize("name", ["cfg_easy_paper", "cfg_hard_chicken", "cfg_singularity_paper"])
def test_coverage_agrees_with_path_traced_masks(name):
    if not RENDERS.is_dir():
        if os.environ.get("CI"):
            pytest.fail(f"{RENDERS} is missing, and CI must have it")
        pytest.skip(f"needs the published renders in {RENDERS}")
    truth = np.load(RENDERS / f"{name}.npy")
    about = json.loads((RENDERS / f"{name}.json").read_text())
    arc = np.linspace(truth[0, 3], truth[-1, 3], 3000)
    points = np.column_stack([np.interp(arc, truth[:, 3], axis) for axis in truth.T[:3]])
    centreline = Centreline(points, np.gradient(points, axis=0), arc)
    for side, eye in (("left", centreline), ("right", shifted_to_right(CAMERA, centreline))):
        tube = tube_pixels(CAMERA, eye, about["radius_mm"])
        image = cv2.imread(str(RENDERS / f"{name}_mask_{side}.png"), cv2.IMREAD_GRAYSCALE)
        mask = np.asarray(image, dtype=np.float64) / 255
        ours = coverage_image(CAMERA, tube)
        touched = (ours > 0) | (mask > 0)
        assert np.abs(ours - mask)[touched].mean() < 0.05
        assert ours.sum() == pytest.approx(mask.sum(), rel=0.02)
