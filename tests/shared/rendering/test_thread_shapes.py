"""Threads keep what their configuration promises, judged by finite differences of densely evaluated curves."""

import numpy as np
import pytest

from schemas.messages import RectifiedStereo
from shared.camera import project
from shared.rendering import thread_shapes
from shared.rendering.surface import depth_at_points, flat_surface, tissue_surface
from shared.rendering.thread_shapes import CONFIGS, ShapeError, crossings, thread_on
from shared.splines import evaluate

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)


def drawn(config: str, seed: int):
    surface = tissue_surface(CAMERA, 85.0 + 6 * seed, seed)
    thread = thread_on(CAMERA, surface, config, seed)
    return surface, thread, evaluate(thread.knots, thread.control_points, 3, np.linspace(0, 1, 5000))


@pytest.mark.parametrize("config", CONFIGS)
def test_threads_lie_above_the_tissue_inside_both_images_and_cross_only_if_told_to(config):
    surface, thread, points = drawn(config, 1)
    assert (crossings(CAMERA, thread) > 0) == (config == "crossing")
    assert (depth_at_points(surface, points[:, :2]) - points[:, 2]).min() > thread.radius_mm
    for pixels in project(CAMERA, points):
        assert pixels.min() > 20.0
        assert (pixels < (940.0, 520.0)).all()


def test_hard_threads_run_along_the_rows_for_three_quarters_of_their_length():
    _, _, points = drawn("hard", 1)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    du, dv = np.abs(np.diff(project(CAMERA, points)[0], axis=0)).T
    assert np.average(dv < np.tan(np.radians(6.0)) * du, weights=length) == pytest.approx(0.73, abs=0.03)


def test_singular_threads_run_fifteen_millimetres_along_the_line_of_sight():
    _, _, points = drawn("singularity", 1)
    step, sight = np.diff(points, axis=0), points[1:]
    length = np.linalg.norm(step, axis=1)
    along = np.abs((step * sight).sum(axis=1)) / length / np.linalg.norm(sight, axis=1)
    assert length[along > np.cos(np.radians(15.0))].sum() == pytest.approx(15.0, abs=1.2)
    assert np.ptp(points[:, 2]) > 15.0


def test_the_seed_decides():
    surface = tissue_surface(CAMERA, 95.0, 1)
    one, same, other = (thread_on(CAMERA, surface, "medium", seed).control_points for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_an_unknown_configuration_and_a_view_that_is_too_narrow_are_refused(monkeypatch):
    with pytest.raises(ShapeError, match="easy, medium, hard, singularity, crossing"):
        thread_on(CAMERA, flat_surface(95.0), "simple", 1)
    monkeypatch.setattr(thread_shapes, "ATTEMPTS", 5)
    narrow = RectifiedStereo(320, 240, 2000.0, 2000.0, 159.5, 119.5, 5.5, 1e-3)
    with pytest.raises(ShapeError, match="wider or more distant"):
        thread_on(narrow, flat_surface(80.0), "hard", 1)
