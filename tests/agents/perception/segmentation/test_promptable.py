"""Thread by a promptable network: along crops, in both eyes, from a click, from ridges and from the frame before."""

import hashlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.perception.prompt import meant_as_before, meant_at, meant_like
from agents.perception.search import near_thread
from agents.perception.segmentation.boxes import Meant, Near
from agents.perception.segmentation.promptable import PromptableSegmenter, thread_in
from agents.perception.segmentation.promptable_model import (
    Embedded,
    NotOnnxError,
    PromptableFileError,
    PromptableModel,
    signature_of,
)
from agents.perception.segmentation.promptable_prompts import in_rows_of, middle_of
from tests.agents.perception.pictures import recall_and_precision, rendered
from tests.agents.perception.tiny_promptable import decoder, encoder, write_tiny

SCENE = "crossing", 2


@pytest.fixture(scope="module")
def segment(tmp_path_factory):
    return PromptableSegmenter(PromptableModel(write_tiny(tmp_path_factory.mktemp("tiny"), hq=False, several=True)))


@pytest.mark.slow
def test_one_click_finds_the_whole_thread_over_several_crops_and_the_right_eye_finds_its_own(segment):
    pair = rendered(*SCENE)[1]
    v, u = np.nonzero(middle_of(pair.coverage_left > 200))
    clicked = np.array([u[len(u) // 2], v[len(v) // 2]], float)
    left = segment(pair.left_bgr, None, meant_at(clicked, pair.left_bgr.shape))
    assert min(recall_and_precision(left, pair.coverage_left)) > 0.97
    right = segment(pair.right_bgr, None, meant_like(pair.left_bgr, left, pair.right_bgr))
    assert min(recall_and_precision(right, pair.coverage_right)) > 0.92


@pytest.mark.slow
def test_without_a_click_ridges_are_the_prompts_and_near_the_last_thread_it_is_found_again(segment):
    pair = rendered(*SCENE)[1]
    whole = segment(pair.left_bgr)
    assert min(recall_and_precision(whole, pair.coverage_left)) > 0.97
    # coverage is nothing or more than one half
    assert whole[whole > 0].min() >= 128
    image, coverage = (np.roll(part, (4, 6), axis=(0, 1)) for part in (pair.left_bgr, pair.coverage_left))
    found = segment(image, Near(near_thread(whole), is_bright=False), meant_as_before(whole, alone=True))
    assert min(recall_and_precision(found, coverage)) > 0.97


def test_a_click_on_tissue_finds_no_thread_and_an_image_without_anything_nothing(segment):
    pair = rendered(*SCENE)[1]
    away = cv2.distanceTransform((pair.coverage_left == 0).astype(np.uint8), cv2.DIST_L2, 3)
    v, u = np.unravel_index(int(np.argmax(away)), away.shape)
    found = segment(pair.left_bgr, None, meant_at(np.array([u, v], float), pair.left_bgr.shape))
    assert not (found[pair.coverage_left > 127] > 0).any()
    plain = np.full((120, 160, 3), 128, np.uint8)
    assert not segment(plain).any()
    assert not segment(plain, None, Meant(np.zeros((120, 160), np.float32), alone=True)).any()


class Given:
    """A network whose masks of every crop of 64 x 64 pixels show these rows."""

    def __init__(self, *rows, scores=(1.0,)):
        self._masks, self._scores = np.full((len(rows), 64, 64), -1.0, np.float32), np.array(scores, np.float32)
        for mask, shown in zip(self._masks, rows, strict=True):
            mask[shown] = 1.0

    def embed(self, crop):
        return Embedded({}, crop.shape[:2])

    def masks(self, embedded, point_px, is_thread):
        assert is_thread.all()
        return self._masks, self._scores


def rows_of(found):
    return np.flatnonzero((found > 0).any(axis=1)).tolist()


def rows_for(network, *points):
    """In which rows of an empty crop such a network finds what is meant by points."""
    return rows_of(thread_in(np.zeros((64, 64, 3), np.uint8), np.array(points, float), network))


def test_of_several_masks_the_first_answers_many_prompts_and_the_best_other_one():
    network = Given(*(slice(30 - number, 35) for number in range(4)), scores=(0.2, 0.5, 0.9, 0.4))
    assert rows_for(network, (10, 32), (40, 32)) == list(range(30, 35))
    assert rows_for(network, (10, 32)) == list(range(28, 35))


def test_a_piece_of_the_mask_without_a_prompt_is_left_out():
    network = Given([20, 40])
    assert rows_for(network, (5, 21)) == [20]
    assert rows_for(network, (5, 21), (50, 40)) == [20, 40]
    assert rows_for(network, (5, 30)) == []
    assert rows_for(network, (5, 21), (5, 30)) == [20]
    assert rows_for(network, (5, 21), (5, 30), (60, 30)) == []


def test_of_two_pieces_beside_one_prompt_that_which_is_meant_alone_is_kept():
    network, plain = Given([20, 22]), np.full((64, 64, 3), 120, np.uint8)
    assert rows_for(network, (5, 20)) == [20, 22]
    segment = PromptableSegmenter(network)
    assert rows_of(segment(plain, None, meant_at(np.array([5.0, 20.0]), (64, 64)))) == [20]
    # where no ridge is left, the crest of the last mask is prompted
    before = np.zeros((64, 64), np.uint8)
    before[22] = 255
    near = Near(near_thread(before), is_bright=False)
    assert rows_of(segment(plain, near, meant_as_before(before, alone=True))) == [22]


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "size", "ends"),
    [
        ({"hq": True}, (256, 256), ((20, 30), (240, 150))),
        ({"hq": True, "first_alone": True}, (150, 256), ((30, 10), (200, 140))),
        ({"hq": False, "several": True}, (256, 120), ((20, 20), (100, 240))),
        ({"hq": False, "whole": True}, (150, 256), ((30, 10), (200, 140))),
    ],
)
def test_the_line_at_the_point_comes_out_where_it_is_whatever_shape_the_crop_has(tmp_path, kind, size, ends):
    model = PromptableModel(write_tiny(tmp_path, **kind))
    crop, cover = np.full((*size, 3), (150, 165, 205), np.uint8), np.zeros(size, np.uint8)
    cv2.line(crop, ends[0], ends[1], (60, 120, 60), 3, cv2.LINE_AA)
    cv2.line(cover, ends[0], ends[1], 255, 3, cv2.LINE_AA)
    masks, scores = model.masks(model.embed(crop), np.mean(ends, axis=0)[None], np.ones(1, bool))
    assert masks.shape == (len(scores), *size)
    found, line = masks[0] > 0, cover > 127
    assert (found & line).sum() / (found | line).sum() > 0.8
    np.testing.assert_allclose(np.argwhere(found).mean(axis=0), np.argwhere(line).mean(axis=0), atol=0.5)


@pytest.mark.parametrize(
    ("which", "content", "told"),
    [
        ("encoder", None, "cannot be read: No such file or directory"),
        ("decoder", b"", "it is empty"),
        ("decoder", b"hello, I am no network at all", "no protobuf message"),
        ("encoder", decoder(), "should take one image of 1x3x1024x1024 or of height x width x 3"),
        ("encoder", encoder(), "it gives no interm_embeddings, which the decoder needs"),
        ("decoder", decoder(hq=True, without="low_res_masks"), "it gives no low_res_masks"),
        ("decoder", decoder(hq=True, without="has_mask_input"), "it takes no has_mask_input"),
        ("decoder", decoder(hq=True).replace(b"DepthToSpace", b"DepthToSpice"), "OpenCV"),
        ("decoder", decoder(hq=True)[:20000], "or it is cut off"),
    ],
)
def test_what_is_wrong_with_a_file_is_one_sentence_that_names_it(tmp_path, capfd, which, content, told):
    files = write_tiny(tmp_path)
    path = getattr(files, which)
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PromptableFileError) as caught:
        PromptableModel(files)
    said = str(caught.value)
    assert f"promptable_{which} {path} cannot be" in said
    assert told in said
    assert "\n" not in said
    assert capfd.readouterr() == ("", "")


def test_a_file_with_another_hash_is_refused_and_one_with_its_own_is_taken(tmp_path):
    files = write_tiny(tmp_path)
    own = hashlib.sha256(files.encoder.read_bytes()).hexdigest()
    PromptableModel(replace(files, encoder_sha256=own.upper()))
    with pytest.raises(PromptableFileError, match=f"promptable_decoder {files.decoder} .* and should be {own}"):
        PromptableModel(replace(files, decoder_sha256=own))


@given(st.binary(max_size=200))
def test_no_bytes_do_more_than_be_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any.onnx"
    path.write_bytes(content)
    try:
        signature = signature_of(path)
    except NotOnnxError:
        return
    assert isinstance(signature.inputs, dict)
