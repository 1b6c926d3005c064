"""Faults made on purpose in masks that are otherwise clean; what textures tell is in judging/test_pair.py."""

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


def seen(disparity, rows):
    left = thread_mask()
    return correspondence_of_masks(left > 0, moved(left, -disparity, -rows) > 0)


@pytest.mark.parametrize(
    ("disparity", "rows", "found"),
    [
        (20, 0, {}),
        (35, 2, {"row_residual": Severity.WARNING}),
        (20, -2, {"row_residual": Severity.WARNING}),
        (12, -7, {"row_residual": Severity.FAULT}),
        (-18, 0, {"left_right_swapped": Severity.FAULT}),
    ],
)
def test_shifts_of_masks_are_measured_and_judged_by_their_size(disparity, rows, found):
    correspondence = seen(disparity, rows)
    assert correspondence.disparity_px == pytest.approx(disparity, abs=4.0)
    assert correspondence.row_residual_px == pytest.approx(rows, abs=0.5)
    findings = judge(correspondence, SHAPE)
    assert codes(findings) == found
    for finding in findings:
        said = "exchange --left and --right" if disparity < 0 else f"{abs(rows)}.0 px apart in rows"
        assert said in f"{finding.finding}; {finding.remedy}"


def test_one_image_given_twice_is_no_stereo_pair_and_what_is_unknown_is_not_judged():
    assert codes(judge(Correspondence(0.0, 0.0), (480, 640))) == {"no_disparity": Severity.FAULT}
    assert judge(Correspondence(None, None), SHAPE) == ()


def test_grounds_of_other_scenes_without_features_or_covered_by_thread_do_not_correspond():
    assert correspondence_of_texture(tissue_like(1), tissue_like(2), NOTHING, NOTHING) is None
    left, everywhere = tissue_like(), np.ones((HEIGHT, WIDTH), bool)
    assert correspondence_of_texture(left, moved(left, -20, 0), everywhere, everywhere) is None
    for shape in ((HEIGHT, WIDTH), (1, 1), (1, 300), (63, 200)):
        plain_image, nothing = np.full((*shape, 3), 200, np.uint8), np.zeros(shape, bool)
        assert correspondence_of_texture(plain_image, plain_image, nothing, nothing) is None


def test_masks_that_are_empty_or_of_different_threads_correspond_to_nothing():
    some, other = thread_mask() > 0, NOTHING.copy()
    other[250:254, 60:300] = True
    for pair in ((NOTHING, some), (some, NOTHING), (NOTHING, NOTHING), (some, other)):
        assert correspondence_of_masks(*pair) == Correspondence(None, None)


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
