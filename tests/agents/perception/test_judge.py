"""Faults made on purpose in pairs that are otherwise clean."""

import cv2
import numpy as np
import pytest

from agents.perception.judge import Correspondence, correspondence_of_masks, correspondence_of_texture, judge
from agents.perception.judging.correspondence import _robust_plane
from agents.perception.judging.features import Matched
from schemas.messages import Severity

HEIGHT, WIDTH = SHAPE = 270, 480
NOTHING = np.zeros((HEIGHT, WIDTH), bool)


def moved(image, right_px, down_px):
    return cv2.warpAffine(
        image, np.array([[1.0, 0, right_px], [0, 1, down_px]]), (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT
    )


def tissue_like(seed=0):
    noise = np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH, 3)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.clip(128 + 60 * blurred / blurred.std(), 0, 255).astype(np.uint8)


def thread_mask():
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    u = np.linspace(150, 400, 100)
    points = np.column_stack((u, 140 + 80 * np.sin(u / 60)))
    cv2.polylines(mask, [np.round(points).astype(np.int32)], False, 255, 4)
    return mask


def codes(findings):
    return {finding.code: finding.severity for finding in findings}


def textured(disparity, rows):
    left = tissue_like()
    return correspondence_of_texture(left, moved(left, -disparity, -rows), NOTHING, NOTHING)


def plain(disparity, rows):
    left = thread_mask()
    return correspondence_of_masks(left > 0, moved(left, -disparity, -rows) > 0)


both_grounds = pytest.mark.parametrize("seen", [textured, plain])


@both_grounds
@pytest.mark.parametrize(("disparity", "rows"), [(20, 0), (35, 4), (12, -7), (-18, 0)])
def test_shifts_are_measured_on_any_ground(seen, disparity, rows):
    found = seen(disparity, rows)
    assert found.disparity_px == pytest.approx(disparity, abs=1.0 if seen is textured else 4.0)
    assert found.row_residual_px == pytest.approx(rows, abs=0.5)


@both_grounds
def test_a_clean_pair_is_not_judged(seen):
    assert judge(seen(20, 0), SHAPE) == ()


@both_grounds
def test_exchanged_images_are_a_fault_with_its_remedy(seen):
    findings = judge(seen(-20, 0), SHAPE)
    assert codes(findings) == {"left_right_swapped": Severity.FAULT}
    assert "20 px further left" in findings[0].finding or seen is plain
    assert "exchange --left and --right" in findings[0].remedy


@both_grounds
@pytest.mark.parametrize(("rows", "severity"), [(2, Severity.WARNING), (-2, Severity.WARNING), (8, Severity.FAULT)])
def test_row_offsets_are_warnings_while_small_and_faults_beyond(seen, rows, severity):
    findings = judge(seen(20, rows), SHAPE)
    assert codes(findings) == {"row_residual": severity}
    assert f"{abs(rows)}.0 px apart in rows" in findings[0].finding


def test_what_is_unknown_is_not_judged():
    assert judge(Correspondence(None, None), SHAPE) == ()


def test_pairs_of_different_scenes_do_not_correspond():
    assert correspondence_of_texture(tissue_like(1), tissue_like(2), NOTHING, NOTHING) is None


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (300, 1), (63, 200)])
def test_images_too_small_for_features_say_nothing(shape):
    image, nothing = np.zeros((*shape, 3), np.uint8), np.zeros(shape, bool)
    assert correspondence_of_texture(image, image, nothing, nothing) is None


def test_a_plain_ground_says_nothing():
    plain_image = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
    assert correspondence_of_texture(plain_image, plain_image, NOTHING, NOTHING) is None


def test_features_of_the_thread_are_left_out():
    left = tissue_like()
    everywhere = np.ones((HEIGHT, WIDTH), bool)
    assert correspondence_of_texture(left, moved(left, -20, 0), everywhere, everywhere) is None


def test_an_empty_mask_corresponds_to_nothing():
    some = thread_mask() > 0
    for pair in ((NOTHING, some), (some, NOTHING), (NOTHING, NOTHING)):
        assert correspondence_of_masks(*pair) == Correspondence(None, None)


def test_masks_of_different_threads_give_no_row_shift():
    left, right = NOTHING.copy(), NOTHING.copy()
    left[20:40, 100:104] = True
    right[200:204, 60:300] = True
    found = correspondence_of_masks(left, right)
    assert found == Correspondence(None, None)


def test_one_image_given_twice_is_no_stereo_pair():
    (finding,) = judge(Correspondence(0.0, 0.0), (480, 640))
    assert (finding.code, finding.severity) == ("no_disparity", Severity.FAULT)


def test_the_plane_of_rows_is_told_though_two_fifths_of_the_matches_are_wrong_alike():
    """As over a pad's slits, each of which looks like the next one."""
    rng = np.random.default_rng(4)
    left = rng.uniform((0, 0), (1280, 960), (100, 2))
    middle, turn = np.array((639.5, 479.5)), np.radians(-0.2)
    down = 1.5 + np.sin(turn) * (left - middle)[:, 0] + rng.normal(0, 0.15, 100)
    down[:40] = -2.0 + 0.02 * (left - middle)[:40, 0] + rng.normal(0, 0.5, 40)
    plane, _, _ = _robust_plane(Matched(left, left + np.column_stack((np.full(100, -300.0), down)), 100), middle)
    assert plane[0] == pytest.approx(1.5, abs=0.1)
    assert abs(plane[1] - np.sin(turn)) < 2e-4
