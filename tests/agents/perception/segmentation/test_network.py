"""The trained network, run by OpenCV, on light renders of seeds that it was not trained on, and on drawn images."""

import functools

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.near import Meant, Near
from agents.perception.segmentation.network import segment_network, thread_in
from shared.scene.__main__ import make_scene
from shared.scene.render import RenderedPair, render


@functools.cache
def scene(config, colour, seed) -> RenderedPair:
    return render(make_scene(config, "tissue", seed, colour))


def around(coverage, side):
    return cv2.dilate(coverage, np.ones((side, side), np.uint8)) >= 96


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "colour", "seed"), [("medium", "black", 7032), ("crossing", "green", 7034), ("easy", "white", 7036)]
)
def test_thread_over_tissue_is_found_whole_and_alone(config, colour, seed):
    pair = scene(config, colour, seed)
    found = segment_network(pair.left_bgr)
    assert set(np.unique(found)) == {0, 255}
    assert around(found, 5)[pair.coverage_left > 128].mean() > 0.97
    assert around(pair.coverage_left, 7)[found >= 96].mean() > 0.97
    assert found.mean() == pytest.approx(pair.coverage_left.mean(), rel=0.2)


def test_no_thread_is_found_in_tissue_without_one():
    pair = scene("medium", "black", 7032)
    bare = cv2.inpaint(pair.left_bgr, (around(pair.coverage_left, 9) * 255).astype(np.uint8), 5, cv2.INPAINT_TELEA)
    assert not segment_network(bare).any()


def test_near_a_thread_the_same_is_found_as_in_the_whole_image():
    pair = scene("crossing", "green", 7034)
    whole = segment_network(pair.left_bgr)
    near = segment_network(pair.left_bgr, Near(around(whole, 61), is_bright=False))
    differing = np.abs(whole.astype(int) - near) > 32
    assert differing.sum() < 0.02 * (whole >= 96).sum()
    nowhere = Near(np.zeros(whole.shape, bool), is_bright=False)
    assert not segment_network(pair.left_bgr, nowhere).any()


def test_of_two_threads_only_the_one_that_is_meant_is_kept_when_it_is_meant_alone():
    pair = scene("medium", "black", 7032)
    image = np.vstack((pair.left_bgr, pair.left_bgr[::-1]))
    weight = np.zeros(image.shape[:2], np.float32)
    weight[:540][pair.coverage_left > 200] = 1.0
    both = segment_network(image, None, Meant(weight, alone=False))
    one = segment_network(image, None, Meant(weight, alone=True))
    assert both[540:].any()
    assert not one[540:].any()
    np.testing.assert_array_equal(one[:500], both[:500])


def line_of(thread, metal=0, length_px=120):
    score = np.zeros((60, 300, 2), np.uint8)
    score[28:33, 40 : 40 + length_px] = thread, metal
    return score


@pytest.mark.parametrize(
    ("score", "is_thread"),
    [
        (line_of(200), True),
        (line_of(130, length_px=240), True),
        (line_of(130, length_px=40), False),
        (line_of(90), False),
    ],
    ids=["likely", "long", "short", "unlikely"],
)
def test_a_line_is_thread_where_enough_speaks_for_it_as_a_whole(score, is_thread):
    assert thread_in(score).any() == is_thread


def test_a_faint_line_is_thread_where_it_goes_on_from_thread_and_makes_it_no_wider():
    score = np.zeros((60, 300, 2), np.uint8)
    for first, last, mean in ((40, 160, 230), (190, 200, 60), (230, 280, 60)):
        score[28:33, first:last, 0] = mean
    score[28:33, 160:190, 0] = np.linspace(230, 60, 30)
    found = thread_in(score)
    assert [bool(found[30, column]) for column in (100, 175, 195, 250)] == [True, True, True, False]
    score[25:28, 40:160, 0] = score[33:36, 40:160, 0] = 90
    assert thread_in(score)[:, 100].sum() == 5
