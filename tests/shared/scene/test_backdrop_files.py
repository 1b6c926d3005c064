"""A field on disk comes back as it was, for its own camera alone."""

import numpy as np
import pytest

from schemas.messages import RectifiedStereo
from shared.scene.backdrop_files import read_backdrop, write_backdrop
from shared.scene.render import SceneError, render_backdrop, render_thread
from shared.scene.thread_shapes import thread_on

CAMERA = RectifiedStereo(320, 180, 1000.0 / 3.0, 1000.0 / 3.0, 159.5, 89.5, 5.5, 1e-3)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("field")
    backdrop = render_backdrop(CAMERA, "tissue", 95.0, 4)
    write_backdrop(folder, CAMERA, backdrop, {"seed": 4})
    return folder, backdrop


def test_images_and_depths_come_back_and_a_thread_can_be_laid_over_them(stored):
    folder, backdrop = stored
    read = read_backdrop(folder, CAMERA)
    assert np.abs(read.left_bgr.astype(float) - backdrop.left_bgr).mean() < 3.0
    np.testing.assert_allclose(read.depth_left_mm, backdrop.depth_left_mm, atol=0.01)
    np.testing.assert_allclose(read.depth_right_mm, backdrop.depth_right_mm, atol=0.01)
    left, _ = render_thread(CAMERA, thread_on(CAMERA, read.surface, "easy", 1), "violet", read)
    assert 0.001 < (np.abs(left.bgr.astype(int) - read.left_bgr).max(axis=2) > 20).mean() < 0.1


def test_another_camera_or_a_folder_without_a_field_is_refused(stored, tmp_path):
    other = RectifiedStereo(320, 180, 300.0, 300.0, 159.5, 89.5, 5.5, 1e-3)
    with pytest.raises(SceneError, match="another camera, which differs in fx_px, fy_px"):
        read_backdrop(stored[0], other)
    with pytest.raises(SceneError, match="suturegrasp scenes backdrop"):
        read_backdrop(tmp_path, CAMERA)
