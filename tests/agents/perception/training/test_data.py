"""What the network is trained on: quick scenes, and folders of scenes that are read again."""

import cv2
import numpy as np
import pytest

from agents.perception.training.light_scenes import scenes_over_one_backdrop, write_scenes
from agents.perception.training.photographs import stitches
from agents.perception.training.scenes import SceneFolderError, views_in
from schemas.messages import RectifiedStereo

SMALL = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)


@pytest.mark.slow
def test_light_scenes_have_dark_or_bright_thread_where_they_say():
    scenes = scenes_over_one_backdrop(4, SMALL)
    covered = [(image, coverage) for eyes in scenes for image, coverage in eyes if coverage.any()]
    assert covered
    for image, coverage in covered:
        beside = cv2.dilate(coverage, np.ones((15, 15), np.uint8)) > 0
        away = image[coverage > 200].mean(axis=0) - image[beside & (coverage == 0)].mean(axis=0)
        assert np.abs(away).max() > 5


@pytest.mark.slow
def test_written_scenes_are_read_again_with_their_masks(tmp_path):
    with pytest.raises(SceneFolderError, match="render scenes into it"):
        views_in([tmp_path])
    write_scenes(tmp_path, 5, 1, SMALL)
    views = views_in([tmp_path])
    assert [view.name for view in views] == [f"light_00005_{k}_{eye}" for k in range(3) for eye in ("left", "right")]
    assert all(view.coverage.shape == view.image.shape[:2] for view in views)
    written = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    write_scenes(tmp_path, 5, 1, SMALL)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == written


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


def test_black_stitches_on_a_photographed_pad_are_thread_and_ink_is_none():
    rng = np.random.default_rng(1)
    photograph = np.clip(rng.normal((120, 160, 215), 4, (640, 640, 3)), 0, 255).astype(np.uint8)
    cv2.line(photograph, (320, 60), (320, 580), (60, 50, 190), 14, cv2.LINE_AA)
    stitch = np.zeros((640, 640), np.uint8)
    cv2.line(stitch, (250, 300), (390, 330), 255, 4, cv2.LINE_AA)
    photograph[stitch > 127] = (30, 28, 35)
    found = stitches(photograph)
    assert found is not None
    np.testing.assert_array_equal(found[cv2.dilate(stitch, np.ones((5, 5))) == 0], 0)
    assert (found[stitch > 127] > 127).mean() > 0.9
    # more of it shows a white table with a ruler
    photograph[:, 300:] = 230
    assert stitches(photograph) is None
