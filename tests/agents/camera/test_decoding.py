"""Decoding says what is wrong with an image in its error, and nothing on standard error."""

import os

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.camera import LARGEST_IMAGE_PIXELS, decoding
from agents.camera.decoding import DecodingError, decode_colour

IMAGE = np.random.default_rng(5).integers(0, 256, (40, 60, 3), dtype=np.uint8)
ENCODED = {suffix: cv2.imencode(suffix, IMAGE)[1].tobytes() for suffix in (".png", ".jpg", ".tif", ".bmp", ".webp")}


@pytest.mark.parametrize("suffix", ENCODED)
def test_whole_images_are_decoded_and_the_beginning_of_one_is_no_image(suffix, capfd):
    data = ENCODED[suffix]
    assert decode_colour(data).shape == IMAGE.shape
    for share in (0.1, 0.5, 0.9):
        with pytest.raises(DecodingError, match="damaged"):
            decode_colour(data[: int(share * len(data))])
    assert capfd.readouterr() == ("", "")


def test_a_changed_byte_of_a_png_is_found_out():
    data = bytearray(ENCODED[".png"])
    data[len(data) // 2] ^= 1
    with pytest.raises(DecodingError, match="damaged"):
        decode_colour(bytes(data))


def test_a_jpeg_that_decodes_with_a_tear_is_found_out(capfd):
    data = bytearray(ENCODED[".jpg"])
    data[len(data) // 2 : len(data) // 2 + 30] = b"\x5a" * 30
    with pytest.raises(DecodingError, match="damaged: parts of it cannot be decoded"):
        decode_colour(bytes(data))
    assert capfd.readouterr() == ("", "")


def test_an_image_with_too_many_pixels_is_refused(monkeypatch):
    assert LARGEST_IMAGE_PIXELS > 15360 * 4320
    monkeypatch.setattr(decoding, "LARGEST_IMAGE_PIXELS", 40 * 60 - 1)
    with pytest.raises(DecodingError, match="million pixels"):
        decode_colour(ENCODED[".png"])


def test_standard_error_works_as_before_afterwards_and_no_descriptor_is_left_open(capfd):
    def open_descriptors() -> int:
        return len(os.listdir("/proc/self/fd"))  # noqa: PTH208

    decode_colour(ENCODED[".png"])
    before = open_descriptors()
    for data in (ENCODED[".png"], b"nothing"):
        try:
            decode_colour(data)
        except DecodingError:
            os.write(2, b"refused\n")
    assert capfd.readouterr().err == "refused\n"
    assert open_descriptors() == before


@settings(max_examples=40, deadline=None)
@given(
    suffix=st.sampled_from(sorted(ENCODED)),
    edits=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 60), st.binary(max_size=8)), max_size=4),
)
def test_any_bytes_are_an_image_or_a_sentence(suffix, edits):
    data = ENCODED[suffix]
    for place, removed, inserted in edits:
        start = int(place * len(data))
        data = data[:start] + inserted + data[start + removed :]
    try:
        image = decode_colour(data)
    except DecodingError as error:
        assert str(error).isprintable()
    else:
        assert image.ndim == 3
        assert image.shape[2] == 3
