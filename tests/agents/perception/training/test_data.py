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


def test_masks_of_needles_and_instruments_are_read_where_they_are_asked_for(tmp_path):
    shape = (40, 60)
    for name in ("lab_1", "traced_1", "light_1"):
        cv2.imwrite(str(tmp_path / f"{name}_left.png"), np.zeros((*shape, 3), np.uint8))
        cv2.imwrite(str(tmp_path / f"{name}_mask_left.png"), np.full(shape, 1, np.uint8))
    cv2.imwrite(str(tmp_path / "lab_1_needle_left.png"), np.full(shape, 2, np.uint8))
    cv2.imwrite(str(tmp_path / "lab_1_instrument_left.png"), np.full(shape, 3, np.uint8))
    cv2.imwrite(str(tmp_path / "traced_1_tool_left.png"), np.full(shape, 4, np.uint8))
    lab, light, traced = views_in([tmp_path], classes=True)
    assert [most(part) for part in (lab.coverage, lab.needle, lab.instrument)] == [1, 2, 3]
    assert [most(part) for part in (light.needle, light.instrument)] == [None, None]
    assert [most(part) for part in (traced.needle, traced.instrument)] == [None, 4]
    assert all(view.needle is None and view.instrument is None for view in views_in([tmp_path]))


def most(coverage):
    return None if coverage is None else coverage.max()
