import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.messages import ImageEncoding
from shared.images import ImageDataError, decode_image, encode_image

RNG = np.random.default_rng(1)
COLOUR = RNG.integers(0, 256, (37, 41, 3), dtype=np.uint8)
GREY = RNG.integers(0, 256, (37, 41), dtype=np.uint8)
SMOOTH = np.add.outer(np.arange(37), np.arange(41)).astype(np.uint8)
compressed = pytest.mark.parametrize("encoding", [ImageEncoding.PNG, ImageEncoding.JPEG])


@pytest.mark.parametrize("encoding", [ImageEncoding.RAW, ImageEncoding.PNG])
@pytest.mark.parametrize("pixels", [COLOUR, GREY, COLOUR[5:20, 3:30:2]], ids=["colour", "grey", "a window"])
def test_pixels_come_back_as_they_were(encoding, pixels):
    found = decode_image(encode_image(pixels, encoding))
    assert (found.dtype, found.shape) == (pixels.dtype, pixels.shape)
    assert (found == pixels).all()


@pytest.mark.parametrize("pixels", [np.stack([SMOOTH] * 3, axis=2), SMOOTH], ids=["colour", "grey"])
def test_jpeg_is_close_and_the_padding_of_a_capture_card_does_no_harm(pixels):
    whole = encode_image(pixels, ImageEncoding.JPEG)
    found = decode_image(dataclasses.replace(whole, data=whole.data + bytes(500)))
    assert found.shape == pixels.shape
    assert np.abs(found.astype(int) - pixels).max() <= 4


@compressed
def test_half_an_image_is_refused(encoding):
    whole = encode_image(COLOUR, encoding)
    for kept in (len(whole.data) - 1, len(whole.data) // 2, 20, 1):
        with pytest.raises(ImageDataError, match=f"{kept} bytes of {encoding.name} are not whole"):
            decode_image(dataclasses.replace(whole, data=whole.data[:kept]))


@compressed
def test_an_image_of_another_encoding_or_size_than_it_says_is_refused(encoding):
    whole = encode_image(COLOUR, encoding)
    with pytest.raises(ImageDataError, match="decodes to 41x37, not to 82x37"):
        decode_image(dataclasses.replace(whole, width=82))
    other = ImageEncoding.JPEG if encoding is ImageEncoding.PNG else ImageEncoding.PNG
    with pytest.raises(ImageDataError, match="no such image"):
        decode_image(dataclasses.replace(whole, encoding=other))


@settings(max_examples=40, deadline=None)
@given(data=st.data(), encoding=st.sampled_from([ImageEncoding.PNG, ImageEncoding.JPEG]))
def test_damaged_bytes_are_pixels_of_that_size_or_an_image_data_error(data, encoding):
    whole = encode_image(SMOOTH, encoding)
    damaged = bytearray(whole.data)
    for _ in range(data.draw(st.integers(1, 4))):
        # past the size in the header: a claim of more pixels is the business of OpenCV's limit
        damaged[data.draw(st.integers(30, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    try:
        assert decode_image(dataclasses.replace(whole, data=bytes(damaged))).shape == SMOOTH.shape
    except ImageDataError as error:
        assert "\n" not in str(error)
