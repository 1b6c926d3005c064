"""The trained network, run by OpenCV, on light renders of seeds that it was not trained on, and on drawn images."""

import functools
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.classes import thread_score
from agents.perception.segmentation.near import Meant, Near
from agents.perception.segmentation.network import segment_network, thread_in
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
    score, found = thread_score(pair.left_bgr), segment_network(pair.left_bgr)
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


BLACK, VIOLET, GROUND = (50, 45, 52), (110, 50, 90), (90, 110, 180)


def scored(*pieces):
    """The image and the score of pieces in rows 60 px apart, each with its colour, its mean and its best score."""
    image, score = np.full((60 * len(pieces), 200, 3), GROUND, np.uint8), np.zeros((60 * len(pieces), 200), np.uint8)
    for number, (colour, mean, best) in enumerate(pieces):
        row = 30 + 60 * number
        image[row : row + 5, 40:160] = colour
        score[row : row + 5, 40:160] = mean
        score[row + 2, 100] = best
    return image, score


def rows_of(thread):
    return [bool(thread[60 * number : 60 * number + 60].any()) for number in range(len(thread) // 60)]


def test_a_fainter_piece_far_from_the_others_is_thread_where_it_has_the_colour_of_one_that_is_sure():
    image, score = scored((BLACK, 230, 255), (BLACK, 140, 200), (VIOLET, 140, 200))
    assert rows_of(thread_in(score, image)) == [True, True, False]
    assert rows_of(thread_in(score)) == [True, False, False]


@pytest.mark.parametrize(("mean", "best"), [(120, 200), (140, 180)], ids=["too faint", "nowhere sure"])
def test_what_has_the_threads_colour_but_scores_too_little_is_none(mean, best):
    image, score = scored((BLACK, 230, 255), (BLACK, mean, best))
    assert rows_of(thread_in(score, image)) == [True, False]


def test_thread_goes_on_from_one_faint_piece_to_the_next_across_glints():
    """The second is too short to be asked by itself; beyond it only what is certain in places leads on."""
    spans, means, bests = (
        [(40, 160), (180, 190), (210, 240), (260, 300), (320, 340), (380, 440)],
        [230] + 5 * [140],
        [200] * 6,
    )
    score = np.zeros((60, 500), np.uint8)
    for (first, last), mean, best in zip(spans, means, bests, strict=True):
        score[28:33, first:last], score[30, first + 2] = mean, best
    found = thread_in(score)
    assert [bool(found[30, first]) for first, _ in spans] == [True, True, True, True, False, False]
    without_the_first = score.copy()
    without_the_first[:, :175] = 0
    assert not thread_in(without_the_first).any()


def test_a_brighter_piece_of_the_same_hue_is_none_and_faint_pieces_alone_are_no_thread():
    bright = tuple(np.array(BLACK) + 60)
    assert rows_of(thread_in(*scored((BLACK, 230, 255), (bright, 140, 200))[::-1])) == [True, False]
    assert not thread_in(*scored((BLACK, 140, 200), (BLACK, 150, 200))[::-1]).any()
