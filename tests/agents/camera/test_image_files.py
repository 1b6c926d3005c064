"""Images in, 8-bit colour or one sentence out, whatever the file's depth, channels and format."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from agents.camera.image_files import ImageFileError, read_mask, read_pair, read_side_by_side

RANDOM = np.random.default_rng(7)
COLOUR = RANDOM.integers(0, 256, (20, 34, 3), dtype=np.uint8)
GREY = COLOUR[..., 0]


def write(path: Path, image: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


def read(path: Path) -> np.ndarray:
    return read_pair(path, path)[0]


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".ppm"])
def test_lossless_colour_comes_as_it_was_stored_and_grey_as_three_equal_channels(tmp_path, suffix):
    np.testing.assert_array_equal(read(write(tmp_path / f"a{suffix}", COLOUR)), COLOUR)
    grey = write(tmp_path / f"grey{suffix.replace('.ppm', '.pgm')}", GREY)
    np.testing.assert_array_equal(read(grey), np.dstack([GREY] * 3))


def test_transparency_is_dropped(tmp_path):
    alpha = RANDOM.integers(0, 256, GREY.shape, dtype=np.uint8)
    np.testing.assert_array_equal(read(write(tmp_path / "a.png", np.dstack((COLOUR, alpha)))), COLOUR)


@pytest.mark.parametrize(("bits", "suffix"), [(8, ".png"), (10, ".tif"), (12, ".png"), (14, ".tif"), (16, ".png")])
def test_deeper_images_are_scaled_from_the_bits_that_they_use(tmp_path, bits, suffix):
    full = 2**bits - 1
    image = COLOUR.copy()
    image[0, 0] = 255
    deep = np.rint(image * (full / 255)).astype(np.uint16)
    np.testing.assert_array_equal(read(write(tmp_path / f"a{suffix}", deep)), image)


def test_both_eyes_are_scaled_alike(tmp_path):
    bright, dark = COLOUR.astype(np.uint16) * 257, COLOUR.astype(np.uint16)
    left, right = read_pair(write(tmp_path / "l.png", bright), write(tmp_path / "r.png", dark))
    np.testing.assert_array_equal(left, COLOUR)
    assert right.max() <= 1


def test_the_first_frame_of_an_animation_is_taken(tmp_path):
    animation = cv2.Animation()
    animation.frames = [COLOUR, COLOUR[::-1].copy()]
    animation.durations = [40, 40]
    assert cv2.imwriteanimation(str(tmp_path / "a.png"), animation)
    np.testing.assert_array_equal(read(tmp_path / "a.png"), COLOUR)


def test_halves_of_a_side_by_side_image(tmp_path):
    left, right = read_side_by_side(write(tmp_path / "a.png", COLOUR))
    np.testing.assert_array_equal(np.hstack((left, right)), COLOUR)
    assert left.shape == right.shape
    assert left.flags.c_contiguous
    assert right.flags.c_contiguous


@pytest.mark.parametrize("deep", [False, True])
def test_the_brightest_channel_of_a_mask_is_its_coverage(tmp_path, deep):
    expected = np.zeros((20, 34), np.uint8)
    expected[3:9, 5:20] = np.arange(2, 17)
    expected[3, 5] = 255
    plane = expected.astype(np.uint16) * np.uint16(257) if deep else expected
    none, full = np.zeros_like(plane), np.full_like(plane, 65535 if deep else 255)
    for image in (
        plane,
        np.dstack((plane, none, none)),
        np.dstack((none, none, plane)),
        np.dstack([plane] * 3),
        np.dstack((plane, plane, plane, full)),
    ):
        path = write(tmp_path / "m.png", image)
        np.testing.assert_array_equal(read_mask(path, "the mask", 34, 20), expected)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_mask_of_zeros_and_ones_is_stretched(tmp_path, kind):
    ones = (GREY > 99).astype(kind)
    mask = read_mask(write(tmp_path / "m.png", ones), "the mask", 34, 20)
    assert mask.dtype == np.uint8
    np.testing.assert_array_equal(mask, ones * 255)


def test_an_error_names_the_file_and_what_it_was_to_be(tmp_path, monkeypatch):
    with pytest.raises(ImageFileError, match=r"^the left image .*none\.png does not exist; check the path$"):
        read_pair(tmp_path / "none.png", tmp_path / "none.png")
    with pytest.raises(ImageFileError, match=r"^my mask .*none\.png does not exist"):
        read_mask(tmp_path / "none.png", "my mask", 34, 20)
    monkeypatch.setattr("agents.camera.image_files.LARGEST_FILE_BYTES", 1 << 20)
    (tmp_path / "a.png").write_bytes(bytes((1 << 20) + 1))
    with pytest.raises(ImageFileError, match="larger than 1 MB"):
        read(tmp_path / "a.png")
