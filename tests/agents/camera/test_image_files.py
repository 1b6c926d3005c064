"""Images in, 8-bit colour or one sentence out, whatever the file's depth, channels, format and damage."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.camera import decoding
from agents.camera.decoding import DecodingError, decode_colour
from agents.camera.image_files import read_mask, read_pair

RANDOM = np.random.default_rng(7)
COLOUR = RANDOM.integers(0, 256, (20, 34, 3), dtype=np.uint8)
GREY = COLOUR[..., 0]
ENCODED = {suffix: cv2.imencode(suffix, COLOUR)[1].tobytes() for suffix in (".png", ".jpg", ".tif", ".bmp", ".webp")}


def write(path: Path, image: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


def read(path: Path) -> np.ndarray:
    return read_pair(path, path)[0]


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_colour_comes_as_it_was_stored_grey_as_three_channels_and_transparency_is_dropped(tmp_path, suffix):
    stored = ((COLOUR, COLOUR), (GREY, np.dstack([GREY] * 3)), (np.dstack((COLOUR, GREY)), COLOUR))
    for image, expected in stored:
        np.testing.assert_array_equal(read(write(tmp_path / f"a{suffix}", image)), expected)


@pytest.mark.parametrize(("bits", "suffix"), [(8, ".png"), (10, ".tif"), (12, ".png"), (14, ".tif"), (16, ".png")])
def test_deeper_images_are_scaled_from_the_bits_that_they_use(tmp_path, bits, suffix):
    image = COLOUR.copy()
    image[0, 0] = 255
    deep = np.rint(image * ((2**bits - 1) / 255)).astype(np.uint16)
    np.testing.assert_array_equal(read(write(tmp_path / f"a{suffix}", deep)), image)


def test_both_eyes_are_scaled_alike(tmp_path):
    bright, dark = COLOUR.astype(np.uint16) * 257, COLOUR.astype(np.uint16)
    left, right = read_pair(write(tmp_path / "l.png", bright), write(tmp_path / "r.png", dark))
    np.testing.assert_array_equal(left, COLOUR)
    assert right.max() <= 1


def test_the_brightest_channel_of_a_mask_is_its_coverage_and_zeros_and_ones_are_stretched(tmp_path):
    none = np.zeros_like(GREY)
    ones = (GREY > 99).astype(np.uint8)
    for image, expected in (
        (GREY, GREY),
        (np.dstack((none, none, GREY)), GREY),
        (GREY.astype(np.uint16) * 257, GREY),
        (ones, ones * 255),
        (ones.astype(np.uint16), ones * 255),
    ):
        mask = read_mask(write(tmp_path / "m.png", image), "the mask", 34, 20)
        assert mask.dtype == np.uint8
        np.testing.assert_array_equal(mask, expected)


@pytest.mark.parametrize("suffix", ENCODED)
def test_the_beginning_of_an_image_is_no_image_and_standard_error_is_kept_from_the_decoder_alone(suffix, capfd):
    data = ENCODED[suffix]
    assert decode_colour(data).shape == COLOUR.shape
    descriptors = len(list(Path("/proc/self/fd").iterdir()))
    for share in (0.1, 0.5, 0.9):
        with pytest.raises(DecodingError, match="damaged"):
            decode_colour(data[: int(share * len(data))])
    os.write(2, b"ours\n")
    assert capfd.readouterr() == ("", "ours\n")
    assert len(list(Path("/proc/self/fd").iterdir())) == descriptors


@pytest.mark.parametrize(("suffix", "damage"), [(".png", b"\x5a"), (".jpg", b"\x5a" * 30)])
def test_an_image_that_decodes_with_a_tear_is_found_out(suffix, damage):
    data = ENCODED[suffix]
    middle = len(data) // 2
    with pytest.raises(DecodingError, match="damaged"):
        decode_colour(data[:middle] + damage + data[middle + len(damage) :])


def test_an_image_with_too_many_pixels_is_refused(monkeypatch):
    monkeypatch.setattr(decoding, "LARGEST_IMAGE_PIXELS", 20 * 34)
    decode_colour(ENCODED[".png"])
    monkeypatch.setattr(decoding, "LARGEST_IMAGE_PIXELS", 20 * 34 - 1)
    with pytest.raises(DecodingError, match="million pixels"):
        decode_colour(ENCODED[".png"])


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
        assert decode_colour(data).shape[2:] == (3,)
    except DecodingError as error:
        assert str(error).isprintable()
