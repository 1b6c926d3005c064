"""What the network is trained on: quick scenes, and folders of scenes that are read again."""

import cv2
import numpy as np
import pytest

from agents.perception.training.light_scenes import scenes_over_one_backdrop, write_scenes
from agents.perception.training.scenes import SceneFolderError, views_in
from schemas.messages import RectifiedStereo

SMALL = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)


def test_light_scenes_have_dark_or_bright_thread_where_they_say():
    scenes = scenes_over_one_backdrop(4, SMALL)
    covered = [(image, coverage) for eyes in scenes for image, coverage in eyes if coverage.any()]
    assert covered
    for image, coverage in covered:
        beside = cv2.dilate(coverage, np.ones((15, 15), np.uint8)) > 0
        away = image[coverage > 200].mean(axis=0) - image[beside & (coverage == 0)].mean(axis=0)
        assert np.abs(away).max() > 5


def test_written_scenes_are_read_again_with_their_masks(tmp_path):
    write_scenes(tmp_path, 5, 1, SMALL)
    views = views_in([tmp_path])
    assert [view.name for view in views] == [f"light_00005_{k}_{eye}" for k in range(3) for eye in ("left", "right")]
    assert all(view.coverage.shape == view.image.shape[:2] for view in views)
    written = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    write_scenes(tmp_path, 5, 1, SMALL)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == written


def test_a_folder_without_scenes_says_what_is_missing(tmp_path):
    with pytest.raises(SceneFolderError, match="render scenes into it"):
        views_in([tmp_path])
