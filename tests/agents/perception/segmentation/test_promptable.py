"""Thread by a promptable network: along crops, in both eyes, from a click, from ridges and from the frame before."""

import functools

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.perception.prompt import meant_as_before, meant_at, meant_like
from agents.perception.search import near_thread
from agents.perception.segmentation.near import Meant, Near
from agents.perception.segmentation.promptable import (
    LARGEST_LOGIT,
    PromptableSegmenter,
    along_thread,
    boxes,
    crop_side,
    next_centre,
    thread_in,
)
from agents.perception.segmentation.promptable_model import Embedded, PromptableModel
from agents.perception.segmentation.promptable_prompts import in_rows_of, middle_of, pointed_at, spread_points
from shared.scene.__main__ import make_scene
from shared.scene.render import render
from tests.agents.perception.tiny_promptable import write_tiny

CONFIG, BACKGROUND, SEED = "crossing", "tissue", 2


@functools.cache
def scene():
    return render(make_scene(CONFIG, BACKGROUND, SEED))


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    return PromptableModel(write_tiny(tmp_path_factory.mktemp("tiny"), hq=False, several=True))


@pytest.fixture(scope="module")
def segment(network):
    return PromptableSegmenter(network)


def recall_and_precision(coverage, true):
    """Of the clear pixels of the thread, and of what was found within a pixel of it."""
    found, thread = coverage > 0, true > 127
    wide = cv2.dilate((true > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return (found & thread).sum() / thread.sum(), (found & wide).sum() / max(1, found.sum())


def clicked(pair):
    """A pixel on the thread, about halfway through its pixels."""
    v, u = np.nonzero(middle_of(pair.coverage_left > 200))
    return np.array([u[len(u) // 2], v[len(v) // 2]], float)


def test_one_click_finds_the_whole_thread_over_several_crops_and_the_right_eye_finds_its_own(segment):
    pair = scene()
    left = segment(pair.left_bgr, None, meant_at(clicked(pair), pair.left_bgr.shape))
    recall, precision = recall_and_precision(left, pair.coverage_left)
    assert recall > 0.97
    assert precision > 0.97
    right = segment(pair.right_bgr, None, meant_like(pair.left_bgr, left, pair.right_bgr))
    recall, precision = recall_and_precision(right, pair.coverage_right)
    assert recall > 0.97
    assert precision > 0.9


def test_without_a_click_ridges_are_the_prompts_and_near_the_last_thread_it_is_found_again(segment):
    pair = scene()
    whole = segment(pair.left_bgr)
    assert min(recall_and_precision(whole, pair.coverage_left)) > 0.95
    moved = np.roll(pair.left_bgr, (4, 6), axis=(0, 1))
    near = Near(near_thread(whole), is_bright=False)
    found = segment(moved, near, meant_as_before(whole, alone=True))
    assert min(recall_and_precision(found, np.roll(pair.coverage_left, (4, 6), axis=(0, 1)))) > 0.95


def test_a_click_on_tissue_finds_nothing_that_passes_for_the_thread(segment):
    pair = scene()
    away = cv2.distanceTransform((pair.coverage_left == 0).astype(np.uint8), cv2.DIST_L2, 3)
    v, u = np.unravel_index(int(np.argmax(away)), away.shape)
    found = segment(pair.left_bgr, None, meant_at(np.array([u, v], float), pair.left_bgr.shape))
    assert not (found[pair.coverage_left > 127] > 0).any()


@pytest.mark.parametrize("value", [0, 128, 255])
def test_an_image_without_anything_gives_nothing(segment, value):
    image = np.full((120, 160, 3), value, np.uint8)
    assert not segment(image).any()
    assert not segment(image, None, Meant(np.zeros((120, 160), np.float32), alone=True)).any()


def test_coverage_is_nothing_or_more_than_one_half(segment):
    values = np.unique(segment(scene().left_bgr))
    assert values[0] == 0
    assert values[1] >= 128


class Given:
    """A network whose masks of every crop are given; it keeps what it was asked."""

    def __init__(self, masks, scores=(1.0,)):
        self._masks, self._scores = np.asarray(masks, np.float32), np.array(scores, np.float32)
        self.asked = []

    def embed(self, crop):
        return Embedded({}, crop.shape[:2])

    def masks(self, embedded, point_px, is_thread):
        assert is_thread.all()
        self.asked.append(point_px)
        return np.broadcast_to(self._masks, (len(self._scores), *embedded.size)), self._scores


def rows_of(network, *points):
    """In which rows of an empty crop such a network finds what is meant by points."""
    thread = thread_in(np.zeros((64, 64, 3), np.uint8), np.array(points, float), network) > 0
    return np.flatnonzero(thread.any(axis=1)).tolist()


def test_a_mask_of_everything_is_no_thread_and_ends_the_search():
    network = Given(np.full((1, 1, 1), 5.0))
    known = np.zeros((300, 400), bool)
    known[150, 200] = True
    logits = along_thread(np.zeros((300, 400, 3), np.uint8), known, network)
    assert (logits == -LARGEST_LOGIT).all()
    (points,) = network.asked
    assert points.tolist() == [[128, 128]]


def test_of_several_masks_the_first_answers_many_prompts_and_the_best_other_one():
    masks = np.full((4, 64, 64), -1.0, np.float32)
    for number in range(4):
        masks[number, 30 - number : 35] = 1.0
    network = Given(masks, (0.2, 0.5, 0.9, 0.4))
    assert rows_of(network, (10, 32), (40, 32)) == list(range(30, 35))
    assert rows_of(network, (10, 32)) == list(range(28, 35))


def test_a_piece_of_the_mask_without_a_prompt_is_left_out():
    masks = np.full((1, 64, 64), -1.0, np.float32)
    masks[0, [20, 40]] = 1.0
    assert rows_of(Given(masks), (5, 21)) == [20]
    assert rows_of(Given(masks), (5, 21), (50, 40)) == [20, 40]
    assert rows_of(Given(masks), (5, 30)) == []
    assert rows_of(Given(masks), (5, 21), (5, 30)) == [20]
    assert rows_of(Given(masks), (5, 21), (5, 30), (60, 30)) == []


def test_of_two_pieces_beside_one_prompt_that_which_is_meant_alone_is_kept():
    masks = np.full((1, 64, 64), -1.0, np.float32)
    masks[0, [20, 22]] = 1.0
    assert rows_of(Given(masks), (5, 20)) == [20, 22]
    found = PromptableSegmenter(Given(masks))(
        np.zeros((64, 64, 3), np.uint8), None, meant_at(np.array([5.0, 20.0]), (64, 64))
    )
    assert np.flatnonzero(found.any(axis=1)).tolist() == [20]


def test_where_no_ridge_is_left_the_crest_of_the_last_mask_is_prompted():
    masks = np.full((1, 64, 64), -1.0, np.float32)
    masks[0, 30] = 1.0
    before = np.zeros((64, 64), np.uint8)
    before[29] = 255
    plain = np.full((64, 64, 3), 120, np.uint8)
    near = Near(near_thread(before), is_bright=False)
    found = PromptableSegmenter(Given(masks))(plain, near, meant_as_before(before, alone=True))
    assert np.flatnonzero(found.any(axis=1)).tolist() == [30]


class WrongAtItsBorder:
    """A network that finds a thread along row 150, but not within 30 px of the sides of a crop."""

    def embed(self, crop):
        return Embedded({}, crop.shape[:2])

    def masks(self, embedded, point_px, is_thread):
        assert is_thread.all()
        logits = np.full((1, *embedded.size), -5.0, np.float32)
        logits[0, round(point_px[0, 1]), 30:-30] = 5.0
        return logits, np.ones(1, np.float32)


def test_a_crop_counts_little_near_its_own_border_where_another_one_tells_better():
    known = np.zeros((300, 900), bool)
    known[150] = True
    logits = along_thread(np.zeros((300, 900, 3), np.uint8), known, WrongAtItsBorder())
    assert (logits[150, 60:-60] > 0).mean() > 0.9


@given(st.integers(1, 500), st.integers(1, 500), st.data())
def test_a_crop_lies_in_the_image_and_its_middle_counts_as_looked_at(height, width, data):
    centre = np.array([data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))])
    side = crop_side((height, width))
    box, inner = boxes(centre, side, (height, width))
    for at, outer, looked, length in zip(centre, box, inner, (height, width), strict=True):
        assert 0 <= outer.start <= looked.start <= at < looked.stop <= outer.stop <= length
        assert outer.stop - outer.start == min(side, length)


@pytest.mark.parametrize(("width", "side"), [(640, 256), (960, 288), (1920, 576), (100, 100)])
def test_crops_grow_with_the_image_and_are_no_smaller_than_a_mask(width, side):
    assert crop_side((round(width * 0.5625), width, 3)) == side


def test_crops_are_laid_where_most_waits():
    pending = np.zeros((400, 400), bool)
    pending[10, 10], pending[300, 200:260] = True, True
    centre = next_centre(pending, 200)
    assert centre is not None
    assert centre[0] == 300
    assert next_centre(np.zeros((4, 4), bool), 200) is None


@settings(max_examples=50)
@given(st.lists(st.tuples(st.integers(0, 99), st.integers(0, 99)), min_size=1, max_size=60, unique=True))
def test_points_are_some_of_the_pixels_each_once(pixels):
    points = spread_points(np.array(pixels), np.array([50.0, 50.0]))
    given_pixels = {(u, v) for v, u in pixels}
    chosen = [tuple(point) for point in points.astype(int).tolist()]
    assert len(set(chosen)) == len(chosen) == min(8, len(given_pixels))
    assert set(chosen) <= given_pixels


@pytest.mark.parametrize("decoy", [90, -160])
def test_in_the_rows_of_the_other_eye_the_whole_thread_tells_which_of_two_alike_is_meant(decoy):
    """A slanting thread, whose disparity grows from 28 to 36, and as much of the same colour elsewhere in its rows."""
    height, width = 360, 640
    rows = np.arange(60, 300)
    left, true = np.zeros((height, width), np.uint8), np.zeros((height, width), bool)
    alike = np.zeros((height, width), np.float32)
    column = (200 + 0.4 * (rows - 60)).astype(int)
    disparity = np.round(np.linspace(28, 36, len(rows))).astype(int)
    for wide in (-1, 0, 1):
        left[rows, column + wide] = 255
        alike[rows, column - disparity + wide] = 1.0
        true[rows, column - disparity + wide] = True
        alike[rows[:150], 250 + decoy + wide] = 1.0
    found = in_rows_of(left, alike)
    # of a slanting line of three pixels, not every row has one that is deeper than all around it
    assert np.convolve(np.any(found[60:300], axis=1), np.ones(5), "valid").min() > 0
    assert (found & true).sum() / found.sum() > 0.95


def test_what_looks_exactly_like_one_stretch_elsewhere_in_its_rows_is_not_it():
    height, width = 360, 640
    rows = np.arange(60, 300)
    left, alike = np.zeros((height, width), np.uint8), np.zeros((height, width), np.float32)
    column = (200 + 0.4 * (rows - 60)).astype(int)
    disparity = np.round(np.linspace(28, 36, len(rows))).astype(int)
    for wide in (-1, 0, 1):
        left[rows, column + wide] = 255
        alike[rows, column - disparity + wide] = 1.0
        alike[rows[:40], column[:40] - 5 + wide] = 1.0
    found = in_rows_of(left, alike)
    v, u = np.nonzero(found)
    away = u - (200 + 0.4 * (v - 60) - np.interp(v, rows, disparity))
    assert (np.abs(away) < 3).mean() > 0.95


def test_in_the_eye_in_which_nobody_pointed_prompts_lie_on_the_thread_in_its_rows_and_on_no_other_of_its_colour():
    left, right = (np.full((240, 480, 3), (150, 165, 205), np.uint8) for _ in range(2))
    coverage = np.zeros((240, 480), np.uint8)
    for image, shift, others in ((left, 0, False), (right, 20, True)):
        cv2.line(image, (200 - shift, 40), (260 - shift, 120), (60, 120, 60), 5, cv2.LINE_AA)
        if others:
            cv2.line(image, (300, 150), (400, 230), (60, 120, 60), 5, cv2.LINE_AA)
    cv2.line(coverage, (200, 40), (260, 120), 255, 5, cv2.LINE_AA)
    (known,) = pointed_at(right, None, meant_like(left, coverage, right))
    v, u = np.nonzero(known)
    assert len(v) > 10
    assert v.max() < 130
    assert np.abs(u - (180 + 0.75 * (v - 40))).max() < 5
