"""Files of a promptable network: what they say of themselves, what is wrong with them, and what comes out of them."""

import hashlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.perception.segmentation.promptable_crop import encoder_input, logits_of_crop, network_points
from agents.perception.segmentation.promptable_model import PromptableFileError, PromptableModel
from agents.perception.segmentation.promptable_signature import NotOnnxError, signature_of
from tests.agents.perception.tiny_promptable import decoder, encoder, write_tiny

GROUND, THREAD = (150, 165, 205), (60, 120, 60)


def crop_with_line(size, ends):
    """A crop with a line, and which pixels the line covers at least by half."""
    crop, cover = np.full((*size, 3), GROUND, np.uint8), np.zeros((*size, 3), np.uint8)
    for image, colour in ((crop, THREAD), (cover, (255, 255, 255))):
        cv2.line(image, ends[0], ends[1], colour, 3, cv2.LINE_AA)
    return crop, cover[:, :, 0] > 127


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
    crop, line = crop_with_line(size, ends)
    masks, scores = model.masks(model.embed(crop), np.mean(ends, axis=0)[None], np.ones(1, bool))
    assert masks.shape == (len(scores), *size)
    found = masks[0] > 0
    assert (found & line).sum() / (found | line).sum() > 0.8
    np.testing.assert_allclose(np.argwhere(found).mean(axis=0), np.argwhere(line).mean(axis=0), atol=0.5)


def test_colours_are_red_first_normalised_and_the_rest_of_the_square_is_zero():
    square = encoder_input(
        np.full((100, 200, 3), (103.53, 116.28, 123.675 + 58.395), np.float32).astype(np.uint8), True
    )
    assert square.shape == (1, 3, 1024, 1024)
    np.testing.assert_allclose(square[0, :, :512].mean(axis=(1, 2)), [1.0, 0.0, 0.0], atol=0.02)
    assert not square[0, :, 512:].any()
    assert encoder_input(np.zeros((100, 200, 3), np.uint8), False).shape == (512, 1024, 3)


@settings(max_examples=20)
@given(st.tuples(st.integers(1, 1500), st.integers(1, 1500)), st.floats(0, 1), st.floats(0, 1))
def test_points_and_logits_agree_about_where_a_pixel_lies(size, down, across):
    point = np.array([across * (size[1] - 1), down * (size[0] - 1)])
    points, labels = network_points(point[None], np.ones(1, bool), size)
    assert labels.tolist() == [[1.0, -1.0]]
    place = (points[0, 0] + 0.5) / 4 - 0.5
    columns = np.broadcast_to(np.arange(256, dtype=np.float32), (256, 256))
    inside = np.clip(place, 0, 255)
    for ramp, expected in ((columns, inside[0]), (columns.T, inside[1])):
        logits = logits_of_crop(np.ascontiguousarray(ramp), size)
        at = [np.array([[n]], np.float32) for n in point]
        found = cv2.remap(logits, at[0], at[1], cv2.INTER_LINEAR)[0, 0]
        assert found == pytest.approx(expected, abs=0.3)


def wrong(tmp_path, change):
    """What is said about the tiny files after a change."""
    files = write_tiny(tmp_path)
    changed = change(files) or files
    with pytest.raises(PromptableFileError) as caught:
        PromptableModel(changed)
    told = str(caught.value)
    assert "\n" not in told
    return told


@pytest.mark.parametrize(
    ("which", "content", "told"),
    [
        ("encoder", None, "cannot be read: No such file or directory"),
        ("decoder", b"", "it is empty; give an ONNX file"),
        ("decoder", b"hello, I am no network at all", "cannot be used: its bytes are no protobuf message"),
        ("encoder", decoder(), "should take one image of 1x3x1024x1024 or of height x width x 3"),
        ("encoder", encoder(), "it gives no interm_embeddings, which the decoder needs"),
        ("decoder", decoder(hq=True, without="low_res_masks"), "it gives no low_res_masks"),
        ("decoder", decoder(hq=True, without="has_mask_input"), "it takes no has_mask_input"),
        ("decoder", decoder(hq=True).replace(b"DepthToSpace", b"DepthToSpice"), "OpenCV"),
        ("decoder", decoder(hq=True)[:20000], "or it is cut off"),
    ],
)
def test_what_is_wrong_with_a_file_is_one_sentence_that_names_it(tmp_path, capfd, which, content, told):
    def change(files):
        path = getattr(files, which)
        path.unlink()
        if content is not None:
            path.write_bytes(content)

    said = wrong(tmp_path, change)
    assert f"promptable_{which} {tmp_path / f'tiny_{which}.onnx'} cannot be" in said
    assert told in said
    assert capfd.readouterr() == ("", "")


def test_a_file_with_another_hash_is_refused_and_one_with_its_own_is_taken(tmp_path):
    files = write_tiny(tmp_path)
    own = hashlib.sha256(files.encoder.read_bytes()).hexdigest()
    PromptableModel(replace(files, encoder_sha256=own.upper()))
    told = wrong(tmp_path, lambda files: replace(files, decoder_sha256=own))
    assert told.startswith(f"promptable_decoder {files.decoder} cannot be used: its SHA-256 is ")
    assert f"and should be {own}; get it again" in told


@given(st.binary(max_size=200))
def test_no_bytes_do_more_than_be_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any.onnx"
    path.write_bytes(content)
    try:
        signature = signature_of(path)
    except NotOnnxError:
        return
    assert isinstance(signature.inputs, dict)
