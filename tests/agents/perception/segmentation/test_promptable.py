"""Thread by a promptable network: along crops, in both eyes, from a click, from ridges and from the frame before."""

import functools

import cv2
import numpy as np
import pytest

from agents.perception.prompt import meant_as_before, meant_at, meant_like
from agents.perception.search import near_thread
from agents.perception.segmentation.near import Meant, Near
from agents.perception.segmentation.promptable import (
    PromptableSegmenter,
    crop_side,
    next_centre,
    thread_in,
)
from agents.perception.segmentation.promptable_model import Embedded, PromptableModel
from agents.perception.segmentation.promptable_prompts import in_rows_of, middle_of
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_without_a_click_ridges_are_the_prompts_and_near_the_last_thread_it_is_found_again(segment):
    pair = scene()
    whole = segment(pair.left_bgr)
    assert min(recall_and_precision(whole, pair.coverage_left)) > 0.95
    # coverage is nothing or more than one half
    assert whole[whole > 0].min() >= 128
    moved = np.roll(pair.left_bgr, (4, 6), axis=(0, 1))
    near = Near(near_thread(whole), is_bright=False)
    found = segment(moved, near, meant_as_before(whole, alone=True))
    assert min(recall_and_precision(found, np.roll(pair.coverage_left, (4, 6), axis=(0, 1)))) > 0.95


def test_a_click_on_tissue_finds_no_thread_and_an_image_without_anything_nothing(segment):
    pair = scene()
    away = cv2.distanceTransform((pair.coverage_left == 0).astype(np.uint8), cv2.DIST_L2, 3)
    v, u = np.unravel_index(int(np.argmax(away)), away.shape)
    found = segment(pair.left_bgr, None, meant_at(np.array([u, v], float), pair.left_bgr.shape))
    assert not (found[pair.coverage_left > 127] > 0).any()
    plain = np.full((120, 160, 3), 128, np.uint8)
    assert not segment(plain).any()
    assert not segment(plain, None, Meant(np.zeros((120, 160), np.float32), alone=True)).any()


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
    network, plain = Given(masks), np.full((64, 64, 3), 120, np.uint8)
    assert rows_of(network, (5, 20)) == [20, 22]
    found = PromptableSegmenter(network)(plain, None, meant_at(np.array([5.0, 20.0]), (64, 64)))
    assert np.flatnonzero(found.any(axis=1)).tolist() == [20]
    # where no ridge is left, the crest of the last mask is prompted
    before = np.zeros((64, 64), np.uint8)
    before[22] = 255
    near = Near(near_thread(before), is_bright=False)
    found = PromptableSegmenter(network)(plain, near, meant_as_before(before, alone=True))
    assert np.flatnonzero(found.any(axis=1)).tolist() == [22]


def test_crops_grow_with_the_image_and_are_laid_where_most_waits():
    sides = [crop_side((round(width * 0.5625), width, 3)) for width in (100, 640, 960, 1920)]
    assert sides == [100, 256, 288, 576]
    pending = np.zeros((400, 400), bool)
    pending[10, 10], pending[300, 200:260] = True, True
    centre = next_centre(pending, 200)
    assert centre is not None
    assert centre[0] == 300
    assert next_centre(np.zeros((4, 4), bool), 200) is None


def test_in_the_rows_of_the_other_eye_the_whole_thread_tells_which_of_two_alike_is_meant():
    """A slanting thread, whose disparity grows from 28 to 36, and as much of the same colour elsewhere in its rows."""
    rows = np.arange(60, 300)
    left, true, alike = (np.zeros((360, 640), kind) for kind in (np.uint8, bool, np.float32))
    column = (200 + 0.4 * (rows - 60)).astype(int)
    disparity = np.round(np.linspace(28, 36, len(rows))).astype(int)
    for wide in (-1, 0, 1):
        left[rows, column + wide] = 255
        alike[rows, column - disparity + wide] = 1.0
        true[rows, column - disparity + wide] = True
        alike[rows[:150], 340 + wide] = 1.0
    found = in_rows_of(left, alike)
    # of a slanting line of three pixels, not every row has one that is deeper than all around it
    assert np.convolve(np.any(found[60:300], axis=1), np.ones(5), "valid").min() > 0
    assert (found & true).sum() / found.sum() > 0.95
