"""What the network is trained on: scenes from folders, and crops of them in many variations."""

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.network import together
from agents.perception.training.augmentation import crop_of, varied
from agents.perception.training.clutter import with_glints, with_tools, with_vessels
from agents.perception.training.crops import CROP_PX, batches, coverage_phases
from agents.perception.training.dyeing import with_other_dye
from agents.perception.training.light_scenes import scenes_over_one_backdrop, write_scenes
from agents.perception.training.scenes import SceneFolderError, View, views_in
from schemas.messages import RectifiedStereo

SMALL = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)


def drawn(side=256):
    """A dark thread over a bright ground, and its coverage."""
    coverage = np.zeros((side, side), np.uint8)
    cv2.line(coverage, (30, 40), (220, 200), 255, 7, cv2.LINE_AA)
    ground = np.random.default_rng(1).normal(180, 3, (side, side, 3))
    image = ground + coverage[..., None] / 255 * (np.array([60, 30, 50]) - ground)
    return np.clip(image, 0, 255).astype(np.uint8), coverage


@pytest.mark.parametrize("seed", range(12))
def test_what_is_covered_still_shows_the_thread_after_a_variation(seed):
    rng = np.random.default_rng(seed)
    image, coverage = varied(*crop_of(*drawn(), np.array([120.0, 120.0]), 256, rng), rng)
    assert image.shape == (256, 256, 3)
    assert coverage.shape == (256, 256)
    seen = cv2.GaussianBlur(image, (0, 0), 1.0).astype(float)
    inside = coverage > 200
    beside = cv2.dilate(coverage, np.ones((25, 25), np.uint8)) > 0
    outside = beside & (cv2.dilate(coverage, np.ones((9, 9), np.uint8)) == 0)
    if inside.sum() > 100:
        # dyed anew it may be brighter than the ground
        assert np.abs(np.median(seen[inside], axis=0) - np.median(seen[outside], axis=0)).max() > 5


def test_another_dye_leaves_the_ground_and_the_edges_as_they_are():
    image, coverage = drawn()
    colours = []
    for seed in range(8):
        dyed = with_other_dye(image, coverage, np.random.default_rng(seed)).astype(float)
        np.testing.assert_array_equal(dyed[coverage == 0], image[coverage == 0])
        thread, ground = (np.median(dyed[part], axis=0) for part in (coverage == 255, coverage == 0))
        colours.append(thread)
        assert np.abs(thread - ground).max() > 20
        # a half covered pixel still shows half of each
        half = (coverage > 110) & (coverage < 145)
        np.testing.assert_allclose(np.median(dyed[half], axis=0), (thread + ground) / 2, atol=25)
    assert np.ptp(colours, axis=0).min() > 60
    no_thread = np.zeros_like(coverage)
    np.testing.assert_array_equal(with_other_dye(image, no_thread, np.random.default_rng(1)), image)


def test_a_crop_that_is_not_resampled_is_exact():
    image, coverage = drawn()
    for seed in range(20):
        rng = np.random.default_rng(seed)
        seen, covered = crop_of(image, coverage, np.array([127.6, 127.3]), 128, rng)
        if np.array_equal(seen, image[64:192, 64:192]):
            np.testing.assert_array_equal(covered, coverage[64:192, 64:192])
            return
    pytest.fail("none of 20 crops was taken as it is")


@pytest.mark.parametrize("clutter", [with_glints, with_vessels])
def test_glints_and_vessels_leave_the_thread_as_it_is(clutter):
    image, coverage = drawn()
    changed = clutter(image, coverage, np.random.default_rng(3))
    assert not np.array_equal(changed, image)
    np.testing.assert_array_equal(changed[coverage == 255], image[coverage == 255])


def test_a_tool_over_a_thread_takes_its_coverage_and_one_beneath_leaves_it():
    image, coverage = drawn()
    left = [with_tools(image, coverage, np.random.default_rng(seed))[1] for seed in range(12)]
    assert all((part <= coverage).all() for part in left)
    assert any((part < coverage).any() for part in left)
    assert any(np.array_equal(part, coverage) for part in left)


def test_the_network_s_four_coverages_are_the_image_s_pixels():
    _, coverage = drawn()
    np.testing.assert_array_equal(together(coverage_phases(coverage)[None]), coverage)


def test_batches_follow_from_their_seed():
    view = View("drawn_left", *drawn(400))
    first, again, other = (next(batches([[view]], 3, seed)) for seed in (1, 1, 2))
    assert first[0].shape == (3, 12, CROP_PX // 2, CROP_PX // 2)
    assert first[1].shape == (3, 4, CROP_PX // 2, CROP_PX // 2)
    for one, same, differing in zip(first, again, other, strict=True):
        np.testing.assert_array_equal(one, same)
        assert not np.array_equal(one, differing)


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
