"""The network with classes: shapes, sizes, and that four pixels of a square come back to their places."""

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.classes import (
    Kind,
    as_usual,
    kinds_of_squares,
    phases,
    resized,
    score_within,
    scores_of,
    thread_score,
    together,
)


def picture(height, width):
    image = np.random.default_rng(2).normal((90, 110, 190), 6, (height, width, 3))
    return np.clip(cv2.GaussianBlur(image, (0, 0), 1.5), 0, 255).astype(np.uint8)


def with_thread(height, width):
    image = picture(height, width)
    cv2.line(image, (width // 8, height // 5), (7 * width // 8, 4 * height // 5), (120, 40, 30), 5, cv2.LINE_AA)
    return image


@pytest.mark.parametrize("size", [(1, 1), (17, 3), (45, 80), (60, 2000)])
def test_every_pixel_of_an_image_of_any_size_has_scores_that_are_one_together(size):
    scores = scores_of(picture(*size))
    assert scores.shape == (*size, len(Kind))
    assert scores.dtype == np.float32
    np.testing.assert_allclose(scores.sum(axis=2), 1, atol=1e-4)
    assert scores.min() >= 0


@pytest.mark.parametrize("size", [(270, 480), (540, 960), (720, 1920)])
def test_thread_and_metal_score_as_their_classes_do(size):
    image = with_thread(*size)
    scores = scores_of(image)
    metal = scores[..., Kind.NEEDLE] + scores[..., Kind.INSTRUMENT]
    expected = 255 * np.stack((scores[..., Kind.THREAD], metal), axis=2)
    seen = as_usual(image)
    assert seen.shape[1] == 960
    np.testing.assert_allclose(resized(thread_score(seen), size), expected, atol=2)
    within = score_within(image, np.s_[:, : size[1]])
    assert (np.abs(within - expected) > 8).mean() < 0.02


def test_half_as_many_rows_and_columns_have_a_class_each():
    image = with_thread(269, 960)
    kinds = kinds_of_squares(image)
    assert kinds.shape == (135, 480)
    shown = scores_of(image)[:268].reshape(134, 2, 480, 2, 4).mean(axis=(1, 3)).argmax(axis=2)
    assert (kinds[:134] == shown).mean() > 0.99


def test_the_four_pixels_of_a_square_come_back_to_their_places():
    image = picture(32, 48)
    apart = phases(image).reshape(4, 3, 16, 24)
    np.testing.assert_allclose(255 * together(apart), image, atol=1e-3)
    # those of a part of an image in memory too
    np.testing.assert_array_equal(phases(image[4:20, 6:30]), phases(image[4:20, 6:30].copy()))
