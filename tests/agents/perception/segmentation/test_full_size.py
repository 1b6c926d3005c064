"""What is enlarged around a ridge, beside the same of the whole image."""

import cv2
import numpy as np
import pytest

from agents.perception.segmentation import full_size
from agents.perception.segmentation.full_size import at_full_size, without_specks


@pytest.mark.parametrize("size", [(960, 540), (1280, 720), (480, 270), (641, 479)])
@pytest.mark.parametrize("is_bright", [False, True])
def test_around_a_ridge_the_pixels_are_those_of_the_whole_image(size, is_bright, monkeypatch):
    random = np.random.default_rng(3)
    reduced = 480, round(size[1] * 480 / size[0])
    image = random.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    background = random.integers(100, 156, (reduced[1], reduced[0], 3), dtype=np.uint8)
    ridge = np.zeros(background.shape[:2], np.uint8)
    cv2.polylines(ridge, [np.array([[301, 90], [377, 143], [411, 140]], np.int32)], False, 1)
    contrast = random.uniform(0, 60, ridge.shape).astype(np.float32)
    around = at_full_size(image, background, ridge > 0, contrast, is_bright)
    assert np.count_nonzero(around) > 100
    monkeypatch.setattr(full_size, "BLUR_MARGIN_PX", 10_000)
    np.testing.assert_array_equal(at_full_size(image, background, ridge > 0, contrast, is_bright), around)


def test_without_a_ridge_there_is_no_thread():
    image = np.zeros((54, 96, 3), np.uint8)
    assert not at_full_size(image, image[::2, ::2], np.zeros((27, 48), bool), np.ones((27, 48), np.float32), True).any()


@pytest.mark.parametrize("streak", [(200, 120, 200), (90, 110, 160)], ids=["thread's", "ground's"])
def test_a_streak_of_light_along_a_dark_thread_is_thread_and_a_streak_of_ground_is_not(streak):
    background = np.full((270, 480, 3), (90, 110, 160), np.uint8)
    image = np.full((540, 960, 3), (90, 110, 160), np.uint8)
    # blue first: a violet thread, and in its middle something as bright as the ground
    cv2.line(image, (100, 270), (800, 270), (80, 30, 70), 7)
    cv2.line(image, (100, 270), (800, 270), streak, 1)
    reduced = cv2.resize(image, (480, 270), interpolation=cv2.INTER_AREA)
    contrast = np.maximum(background.astype(np.float32) - reduced, 0).mean(axis=2)
    thread = at_full_size(image, background, contrast > 30, contrast, is_bright=False)
    assert (thread[268:273, 150:750] == 255).all() == (streak[0] > 90)


def test_a_strand_of_which_only_both_sides_are_dark_is_filled_all_along():
    ground = (105, 110, 160)
    background = np.full((270, 480, 3), ground, np.uint8)
    image = np.full((540, 960, 3), ground, np.uint8)
    # blue first: the streak is as bright as the ground, and of a colour between it and the thread's
    image[266:273, 100:800], image[268:271, 100:800] = (60, 10, 40), (150, 115, 165)
    reduced = cv2.resize(image, (480, 270), interpolation=cv2.INTER_AREA)
    contrast = np.maximum(background.astype(np.float32) - reduced, 0).mean(axis=2)
    thread = at_full_size(image, background, contrast > 10, contrast, is_bright=False)
    assert (thread[266:273, 150:750] == 255).all()


def pieces(*lengths):
    coverage = np.zeros((20 * len(lengths), 300), np.uint8)
    for k, length in enumerate(lengths):
        coverage[20 * k + 10, 5 : 5 + length] = 255
    return coverage


def test_specks_are_left_out_and_pieces_of_a_thread_are_not():
    np.testing.assert_array_equal(without_specks(pieces(200, 12, 9), 20.0), pieces(200, 0, 0))
    np.testing.assert_array_equal(without_specks(pieces(200, 25, 9), 20.0), pieces(200, 25, 0))


def test_a_thread_that_shows_in_specks_alone_is_kept():
    np.testing.assert_array_equal(without_specks(pieces(12, 9, 15, 30), 20.0), pieces(12, 9, 15, 30))
    assert not without_specks(pieces(0), 20.0).any()
