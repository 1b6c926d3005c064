"""The trained network, run by OpenCV, on light renders of seeds that it was not trained on, and on drawn images."""

import functools
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.classes import thread_score
from agents.perception.segmentation.near import Meant, Near
from agents.perception.segmentation.network import WEIGHTS, evidence, lines_in, segment_network, thread_in
from shared.scene.__main__ import make_scene
from shared.scene.render import RenderedPair, render


@functools.cache
def scene(config, colour, seed) -> RenderedPair:
    return render(make_scene(config, "tissue", seed, colour))


def around(coverage, side):
    return cv2.dilate(coverage, np.ones((side, side), np.uint8)) >= 96


@pytest.mark.parametrize(
    ("config", "colour", "seed"),
    [("medium", "black", 7032), ("crossing", "green", 7034), ("hard", "violet", 7035), ("easy", "white", 7036)],
)
def test_thread_over_tissue_is_found_whole_and_alone(config, colour, seed):
    pair = scene(config, colour, seed)
    found = segment_network(pair.left_bgr)
    assert around(found, 5)[pair.coverage_left > 128].mean() > 0.97
    assert around(pair.coverage_left, 7)[found >= 96].mean() > 0.97


def test_the_score_is_graded_and_the_mask_as_large_as_the_true_one():
    pair = scene("medium", "black", 7032)
    score, found = thread_score(pair.left_bgr)[..., 0], segment_network(pair.left_bgr)
    assert ((score > 20) & (score < 235)).sum() > 0.2 * (score > 20).sum()
    assert set(np.unique(found)) == {0, 255}
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


def test_nothing_is_found_where_nothing_is_looked_at():
    image = scene("medium", "black", 7032).left_bgr
    assert not segment_network(image, Near(np.zeros(image.shape[:2], bool), is_bright=False)).any()


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


@pytest.mark.parametrize("size", [(37, 51), (540, 960), (17, 1300)])
def test_images_of_any_size_have_coverage_of_their_size(size):
    image = np.random.default_rng(1).integers(0, 256, (*size, 3), dtype=np.uint8)
    assert segment_network(image).shape == size


def test_a_wide_image_is_looked_at_in_the_usual_width():
    pair = scene("medium", "black", 7032)
    wide = cv2.resize(pair.left_bgr, (1920, 1080), interpolation=cv2.INTER_LINEAR)
    found = cv2.resize(segment_network(wide), (960, 540), interpolation=cv2.INTER_AREA)
    assert around(found, 5)[pair.coverage_left > 128].mean() > 0.95


def test_several_threads_of_the_process_may_segment_at_once():
    images = [scene("medium", "black", 7032).left_bgr, scene("crossing", "green", 7034).left_bgr] * 3
    alone = [thread_score(image) for image in images[:2]]
    with ThreadPoolExecutor(3) as pool:
        for found, expected in zip(pool.map(thread_score, images), alone * 3, strict=True):
            np.testing.assert_array_equal(found, expected)


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


def test_more_length_and_less_metal_speak_for_thread():
    def odds(score):
        return (evidence(lines_in(score)) @ WEIGHTS)[1]

    assert odds(line_of(150, length_px=100)) < odds(line_of(150, length_px=200))
    assert odds(line_of(150, metal=50)) < odds(line_of(150))
    assert odds(line_of(150)) < odds(line_of(180))


def test_a_faint_line_is_thread_where_it_goes_on_from_thread():
    score = np.zeros((60, 300, 2), np.uint8)
    for first, last, mean in ((40, 160, 230), (190, 200, 60), (230, 280, 60)):
        score[28:33, first:last, 0] = mean
    score[28:33, 160:190, 0] = np.linspace(230, 60, 30)
    found = thread_in(score)
    assert [bool(found[30, column]) for column in (100, 175, 195, 250)] == [True, True, True, False]


def test_what_scores_little_beside_thread_makes_it_no_wider():
    score = line_of(240)
    score[25:28, 40:160, 0] = score[33:36, 40:160, 0] = 90
    assert thread_in(score)[:, 100].sum() == 5
