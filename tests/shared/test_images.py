"""Images as messages; and JPEG of OpenCV and of FFmpeg, whole and damaged."""

import dataclasses
import itertools

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.messages import Image, ImageEncoding
from shared.images import ImageDataError, decode_image, encode_image
from shared.jpeg import jpeg_damage

COLOUR = np.random.default_rng(1).integers(0, 256, (37, 41, 3), dtype=np.uint8)
SMOOTH = np.add.outer(np.arange(37), np.arange(41)).astype(np.uint8)
RAW, PNG, JPEG = ImageEncoding.RAW, ImageEncoding.PNG, ImageEncoding.JPEG


def test_pixels_come_back_as_they_were_or_from_jpeg_nearly_so_despite_the_padding_of_a_capture_card():
    for pixels in (COLOUR, COLOUR[..., 0], COLOUR[5:20, 3:30:2]):
        for encoding in (RAW, PNG):
            found = decode_image(encode_image(pixels, encoding))
            assert found.dtype == pixels.dtype
            assert np.array_equal(found, pixels)
    for pixels in (SMOOTH, np.stack([SMOOTH] * 3, axis=2)):
        image = encode_image(pixels, JPEG)
        found = decode_image(dataclasses.replace(image, data=image.data + bytes(500)))
        assert found.shape == pixels.shape
        assert np.abs(found.astype(int) - pixels).max() <= 4


@pytest.mark.parametrize(("encoding", "other"), [(PNG, JPEG), (JPEG, PNG)])
def test_half_an_image_or_one_of_another_encoding_or_size_than_it_says_is_refused(encoding, other):
    whole = encode_image(COLOUR, encoding)
    for kept in (len(whole.data) - 1, len(whole.data) // 2, 1):
        with pytest.raises(ImageDataError, match=f"{kept} bytes of {encoding.name} are not whole"):
            decode_image(dataclasses.replace(whole, data=whole.data[:kept]))
    with pytest.raises(ImageDataError, match="decodes to 41x37, not to 82x37"):
        decode_image(dataclasses.replace(whole, width=82))
    with pytest.raises(ImageDataError, match="no such image"):
        decode_image(dataclasses.replace(whole, encoding=other))


@settings(max_examples=40, deadline=None)
@given(data=st.data(), encoding=st.sampled_from([PNG, JPEG]))
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


NOISE = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (75, 101, 3), dtype=np.uint8), (0, 0), 1.0)
SAMPLINGS = [getattr(cv2, f"IMWRITE_JPEG_SAMPLING_FACTOR_{blocks}") for blocks in (444, 422, 420, 440, 411)]
PLAIN, PROGRESSIVE, RESTARTS = (), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1), (cv2.IMWRITE_JPEG_RST_INTERVAL, 3)


def jpeg(pixels, *parameters):
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 95, *parameters])[1].tobytes()


WHOLE = {"plain": jpeg(NOISE), "progressive": jpeg(NOISE, *PROGRESSIVE), "restarts": jpeg(NOISE, *RESTARTS)}


def data_at(data):
    """Where the first entropy-coded data begin."""
    header = data.index(b"\xff\xda") + 2
    return header + int.from_bytes(data[header : header + 2], "big")


@pytest.mark.parametrize("options", [PLAIN, PROGRESSIVE, RESTARTS, (*PROGRESSIVE, *RESTARTS)], ids=str)
def test_what_opencv_writes_is_whole(options):
    for sampling in SAMPLINGS:
        for height, width in [(75, 101), (1, 1), (9, 100)]:
            for pixels in (NOISE[:height, :width], NOISE[:height, :width, 0]):
                assert jpeg_damage(jpeg(pixels, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling, *options)) == ""


def test_what_ffmpeg_writes_is_whole(tmp_path):
    path = str(tmp_path / "film.avi")
    writer = cv2.VideoWriter(path, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (96, 64))
    for shift in range(4):
        writer.write(np.roll(NOISE[:64, :96], shift, axis=1))
    writer.release()
    capture = cv2.VideoCapture(path, cv2.CAP_FFMPEG)
    # packets as FFmpeg's own encoder wrote them
    assert capture.set(cv2.CAP_PROP_FORMAT, -1)
    packets = [packet.tobytes() for found, packet in iter(capture.read, (False, None)) if found]
    assert [(packet[:2], jpeg_damage(packet)) for packet in packets] == 4 * [(b"\xff\xd8", "")]


@pytest.mark.parametrize("data", WHOLE.values(), ids=WHOLE)
def test_padding_and_fill_bytes_are_no_damage_and_what_is_cut_off_is_told_wherever_it_is_cut(data):
    assert jpeg_damage(data + bytes(300)) == ""
    assert jpeg_damage(data[:-2] + b"\xff\xff\xff" + data[-2:]) == ""
    assert jpeg_damage(data[:2] + b"\xff" + data[2:]) == ""
    header = data_at(data)
    places = [*range(0, header, 7), *range(header, len(data), 211), *range(len(data) - 20, len(data))]
    assert all(jpeg_damage(data[:length]) for length in places)


def test_any_marker_amid_the_image_data_of_a_camera_and_a_part_of_another_image_behind_it_are_told():
    data = WHOLE["plain"]
    middle = (data_at(data) + len(data)) // 2
    for marker in (*range(1, 0xD9), *range(0xDA, 0xFF)):
        assert jpeg_damage(data[:middle] + bytes([0xFF, marker]) + data[middle + 2 :]), hex(marker)
    assert "follow its end" in jpeg_damage(data + data)
    assert jpeg_damage(data[:-2] + data[data_at(data) - 14 :])


def test_a_restart_marker_that_is_missing_doubled_or_exchanged_and_an_end_that_comes_too_early_are_told():
    data = WHOLE["restarts"]
    places = [i for i in range(data_at(data), len(data) - 1) if data[i] == 0xFF and 0xD0 <= data[i + 1] <= 0xD7]
    assert len(places) > 8
    for one, next_one in itertools.pairwise(places):
        assert "out of order" in jpeg_damage(data[:one] + data[next_one:])
        assert "out of order" in jpeg_damage(data[:next_one] + data[one:])
        assert jpeg_damage(data[:one] + b"\0\0" + data[one + 2 :])
        # what is missing behind the last one cannot be told
        assert "so it is not whole" in jpeg_damage(data[: one + 5] + b"\xff\xd9")
    # eight missing at once leave the order as it was, and are told by their number
    told = jpeg_damage(data[: places[0]] + data[places[8] :])
    assert f"{len(places) - 8} restart markers in place of {len(places)}" in told


@settings(max_examples=40, deadline=None)
@given(kind=st.sampled_from(list(WHOLE)), chance=st.data())
def test_damaged_bytes_are_an_image_or_one_sentence(kind, chance):
    damaged = bytearray(WHOLE[kind])
    for _ in range(chance.draw(st.integers(1, 4))):
        begin, length = chance.draw(st.integers(0, len(damaged) - 1)), chance.draw(st.integers(1, 300))
        part = damaged[begin : begin + length]
        instead = (bytes([length % 256, *part[1:]]), bytes(len(part)), b"", part + part)
        damaged[begin : begin + length] = chance.draw(st.sampled_from(instead))
    said = jpeg_damage(bytes(damaged))
    assert "\n" not in said
    if said:
        with pytest.raises(ImageDataError):
            decode_image(Image(ImageEncoding.JPEG, 101, 75, 3, bytes(damaged)))


def test_many_empty_scans_take_no_longer_than_they_are_long():
    header = data_at(WHOLE["progressive"])
    assert jpeg_damage(WHOLE["progressive"][:header] + b"\0\xff\xd0" * 200_000)
