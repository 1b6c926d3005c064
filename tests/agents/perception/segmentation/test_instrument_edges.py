"""A shaft over tissue, whose outline is as dark as the thread that is in view with it."""

import cv2
import numpy as np
import pytest

from agents.perception.segmentation import ridge_view
from agents.perception.segmentation.instrument_edges import along_borders, instruments_in
from agents.perception.segmentation.near import Meant
from agents.perception.segmentation.ridge import segment_ridge

TISSUE, STEEL, SIDE, BLACK = (80, 85, 170), (105, 105, 105), (60, 58, 61), (30, 28, 30)
SHAFT, THREAD = ((640, -20), (420, 330)), ((120, 130), (900, 430))


def drawn(*lines, shaft=True):
    """A shaft that reaches into the image, with dark sides, over tissue with texture; and black lines over both."""
    scale = 2
    image = np.full((540 * scale, 960 * scale, 3), TISSUE, np.uint8)
    begin, end = (np.multiply(scale, point).tolist() for point in SHAFT)
    if shaft:
        for colour, width in ((SIDE, 96), (STEEL, 82)):
            cv2.line(image, begin, end, colour, scale * width)
    for one, other in lines:
        cv2.line(image, tuple(scale * v for v in one), tuple(scale * v for v in other), BLACK, scale * 5, cv2.LINE_AA)
    image = cv2.resize(image, (960, 540), interpolation=cv2.INTER_AREA)
    random = np.random.default_rng(0)
    texture = cv2.resize(random.normal(0, 5, (54, 96, 1)).astype(np.float32), (960, 540))[..., None]
    return np.clip(image + texture + random.normal(0, 2, image.shape), 0, 255).astype(np.uint8)


def near_line(ends, width):
    mask = np.zeros((540, 960), np.uint8)
    cv2.line(mask, ends[0], ends[1], 255, width)
    return mask > 0


def test_thread_is_found_and_the_outline_of_an_instrument_is_not():
    found = segment_ridge(drawn(THREAD)) > 0
    on_thread = near_line(THREAD, 9)
    assert (found & ~on_thread).sum() < 0.02 * found.sum()
    outside = near_line(THREAD, 1) & ~near_line(SHAFT, 130)
    assert found[outside].mean() > 0.98


def test_thread_is_found_up_to_the_instrument_that_it_crosses():
    found = segment_ridge(drawn(THREAD)) > 0
    assert found[near_line(THREAD, 1) & near_line(SHAFT, 130)].mean() > 0.8


def test_an_instrument_alone_is_no_thread():
    assert not segment_ridge(drawn()).any()


def test_where_it_is_said_which_thread_is_meant_it_may_lie_along_an_instrument():
    image = drawn()
    side = near_line(SHAFT, 96) & ~near_line(SHAFT, 80)
    found = segment_ridge(image, meant=Meant(side.astype(np.float32), alone=True)) > 0
    assert found.any()
    assert side[found].mean() > 0.9


def reduced(image):
    return cv2.resize(image, (ridge_view.DETECTION_WIDTH_PX, 270), interpolation=cv2.INTER_AREA)


def test_lines_along_a_border_are_told_from_lines_across_it():
    small = reduced(drawn(THREAD))
    instruments = instruments_in(small)
    assert instruments is not None
    contrast = np.clip(np.array(TISSUE).mean() - small.mean(axis=2), 0, None).astype(np.float32)
    pixel = np.flatnonzero(contrast > 40)
    along = np.zeros(contrast.size, bool)
    along[pixel] = along_borders(instruments, contrast, pixel)
    along = cv2.resize(along.reshape(contrast.shape).view(np.uint8), (960, 540), interpolation=cv2.INTER_NEAREST) > 0
    outline = near_line(SHAFT, 92) & ~near_line(SHAFT, 88) & ~near_line(THREAD, 60)
    outline[:20] = outline[320:] = False
    assert along[outline].mean() > 0.9
    crossing = near_line(THREAD, 3)
    assert along[crossing].mean() < 0.1


@pytest.mark.parametrize("image", [drawn(THREAD, shaft=False), np.full((540, 960, 3), 128, np.uint8)])
def test_without_an_instrument_there_is_none(image):
    assert instruments_in(reduced(image)) is None


@pytest.mark.parametrize("shape", [(1, 1), (3, 480), (270, 3), (8, 240)])
def test_images_too_small_for_instruments_hold_none(shape):
    assert instruments_in(np.full((*shape, 3), TISSUE, np.uint8)) is None
