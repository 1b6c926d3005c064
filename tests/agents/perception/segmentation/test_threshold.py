"""Drawn threads on plain grounds: faint, thin, noisy, compressed, coloured, on gradients."""

import cv2
import numpy as np
import pytest
from jaxtyping import UInt8

from agents.perception.segmentation.near import Near
from agents.perception.segmentation.threshold import segment_threshold

HEIGHT, WIDTH = 240, 320
Image = UInt8[np.ndarray, "h w 3"]


def coverage(thickness_px=2.0, scale=8):
    """A curved thread drawn large and averaged down, so that its edges are covered in part."""
    big = np.zeros((HEIGHT * scale, WIDTH * scale), np.uint8)
    t = np.linspace(0, 1, 400)
    points = np.column_stack((40 + 240 * t, 120 + 70 * np.sin(5 * t))) * scale
    cv2.polylines(big, [np.round(points).astype(np.int32)], False, 255, max(1, round(thickness_px * scale)))
    return cv2.resize(big, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) / 255.0


def laid(thread, ground=(206, 206, 206), colour=(150, 150, 150), noise=0.0, jpeg=None) -> Image:
    behind = np.broadcast_to(np.asarray(ground, float), (HEIGHT, WIDTH, 3))
    image = behind + thread[..., None] * (np.asarray(colour, float) - behind)
    image = image + np.random.default_rng(0).normal(0, noise, image.shape)
    image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    if jpeg is not None:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg])
        image = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
    return image


def recall_and_precision(found, thread):
    near = cv2.dilate((found > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    truly_near = cv2.dilate((thread > 0.05).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return near[thread > 0.5].mean(), truly_near[found > 0].mean()


GRADIENT = np.linspace(120, 230, WIDTH)[None, :, None] + np.linspace(-20, 20, HEIGHT)[:, None, None] + np.zeros(3)


PLAIN = {
    "thin, faint": (1.2, {"colour": (165, 165, 165)}),
    "faint, noise and JPEG": (1.6, {"colour": (160, 160, 160), "noise": 1.0, "jpeg": 90}),
    "strong JPEG": (2.0, {"jpeg": 75}),
    "on white": (5.0, {"ground": (255, 255, 255), "colour": (60, 40, 90)}),
    "pale on white": (3.0, {"ground": (255, 255, 255), "colour": (200, 200, 235)}),
    "brighter than its ground": (2.0, {"ground": (90, 90, 90), "colour": (190, 190, 190)}),
    "only its colour differs": (3.0, {"ground": (150, 150, 150), "colour": (220, 150, 90)}),
    "gradient, noise and JPEG": (2.5, {"ground": GRADIENT, "colour": (60, 60, 60), "noise": 1.0, "jpeg": 85}),
}


@pytest.mark.parametrize(("thickness", "how"), PLAIN.values(), ids=PLAIN)
def test_a_thread_on_a_plain_ground_is_found_and_nothing_else(thickness, how):
    thread = coverage(thickness)
    recall, precision = recall_and_precision(segment_threshold(laid(thread, **how)), thread)
    assert recall > 0.97
    assert precision > 0.97


def test_coverage_is_fuller_in_the_middle_than_at_the_edge():
    thread = coverage(4.0)
    found = segment_threshold(laid(thread, colour=(90, 90, 90)))
    assert found[thread > 0.99].mean() > 240
    assert found[(thread > 0.3) & (thread < 0.5) & (found > 0)].mean() < 200
    assert found[found > 0].min() >= 128


def test_specks_noise_and_images_of_one_colour_hold_no_thread():
    empty = np.zeros((HEIGHT, WIDTH))
    specks = laid(empty)
    specks[50, 60:62] = specks[200, 300] = 100
    for image in (specks, laid(empty, noise=1.5), np.full((HEIGHT, WIDTH, 3), 255, np.uint8)):
        assert not segment_threshold(image).any()


def test_tiny_images_are_segmented_without_complaint():
    for shape in ((1, 1), (1, 40), (40, 1), (7, 7)):
        image = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
        assert segment_threshold(image).shape == shape


def test_only_pieces_near_the_place_are_kept():
    image = laid(coverage())
    v, u = np.nonzero(segment_threshold(image))
    near = np.zeros((HEIGHT, WIDTH), bool)
    assert not segment_threshold(image, Near(near, is_bright=False)).any()
    near[v[0], u[0]] = True
    near = cv2.dilate(near.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    np.testing.assert_array_equal(segment_threshold(image, Near(near, is_bright=False)), segment_threshold(image))
