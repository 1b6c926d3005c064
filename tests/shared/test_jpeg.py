"""JPEG of OpenCV and of FFmpeg, whole and damaged."""

import itertools

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.messages import Image, ImageEncoding
from shared.images import ImageDataError, decode_image
from shared.jpeg import jpeg_damage

NOISE = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (75, 101, 3), dtype=np.uint8), (0, 0), 1.0)
SAMPLINGS = (
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_440,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411,
)
PLAIN, PROGRESSIVE, RESTARTS = (), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1), (cv2.IMWRITE_JPEG_RST_INTERVAL, 3)


def jpeg(pixels, *parameters):
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 95, *parameters])[1].tobytes()


WHOLE = {"plain": jpeg(NOISE), "progressive": jpeg(NOISE, *PROGRESSIVE), "restarts": jpeg(NOISE, *RESTARTS)}
each_kind = pytest.mark.parametrize("kind", WHOLE)


def data_at(data):
    """Where the first entropy-coded data begin."""
    header = data.index(b"\xff\xda") + 2
    return header + int.from_bytes(data[header : header + 2], "big")


def restarts_of(data):
    return [i for i in range(data_at(data), len(data) - 1) if data[i] == 0xFF and 0xD0 <= data[i + 1] <= 0xD7]


@pytest.mark.parametrize("options", [PLAIN, PROGRESSIVE, RESTARTS, (*PROGRESSIVE, *RESTARTS)], ids=str)
def test_what_opencv_writes_is_whole(options):
    for sampling in SAMPLINGS:
        for height, width in [(75, 101), (1, 1), (9, 100)]:
            for pixels in (NOISE[:height, :width], NOISE[:height, :width, 0]):
                data = jpeg(pixels, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling, *options)
                assert jpeg_damage(data) == ""


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
    assert [packet[:2] for packet in packets] == 4 * [b"\xff\xd8"]
    assert [jpeg_damage(packet) for packet in packets] == 4 * [""]


@each_kind
def test_the_padding_of_a_capture_card_and_fill_bytes_are_no_damage(kind):
    data = WHOLE[kind]
    assert jpeg_damage(data + bytes(300)) == ""
    assert jpeg_damage(data[:-2] + b"\xff\xff\xff" + data[-2:]) == ""
    assert jpeg_damage(data[:2] + b"\xff" + data[2:]) == ""


@each_kind
def test_what_is_cut_off_is_told_wherever_it_is_cut(kind):
    data = WHOLE[kind]
    header = data_at(data)
    places = [*range(0, header, 7), *range(header, len(data), 211), *range(len(data) - 20, len(data))]
    assert all(jpeg_damage(data[:length]) for length in places)


def test_an_end_that_comes_too_early_is_told_where_there_are_restarts():
    data = WHOLE["restarts"]
    # what is missing behind the last one cannot be told
    for place in restarts_of(data)[:-1:5]:
        assert "so it is not whole" in jpeg_damage(data[: place + 5] + b"\xff\xd9")


def test_any_marker_amid_the_image_data_of_a_camera_is_told():
    data = WHOLE["plain"]
    middle = (data_at(data) + len(data)) // 2
    for marker in (*range(1, 0xD9), *range(0xDA, 0xFF)):
        assert jpeg_damage(data[:middle] + bytes([0xFF, marker]) + data[middle + 2 :]), hex(marker)


def test_a_restart_marker_that_is_missing_doubled_or_exchanged_is_told():
    data = WHOLE["restarts"]
    places = restarts_of(data)
    assert len(places) > 8
    for one, next_one in itertools.pairwise(places):
        assert "out of order" in jpeg_damage(data[:one] + data[next_one:])
        assert "out of order" in jpeg_damage(data[:next_one] + data[one:])
        assert jpeg_damage(data[:one] + b"\0\0" + data[one + 2 :])
    # eight missing at once leave the order as it was, and are told by their number
    assert "8 fewer" in jpeg_damage(data[: places[0]] + data[places[8] :]).replace(
        f"has {len(places) - 8} restart markers in place of {len(places)}", "8 fewer"
    )


def test_a_part_of_another_image_behind_this_one_is_told():
    data = WHOLE["plain"]
    assert "follow its end" in jpeg_damage(data + data)
    assert jpeg_damage(data[:-2] + data[data_at(data) - 14 :])


def decoded(data):
    height, width = NOISE.shape[:2]
    return decode_image(Image(ImageEncoding.JPEG, width, height, 3, data))


@settings(max_examples=40, deadline=None)
@given(kind=st.sampled_from(list(WHOLE)), chance=st.data())
def test_damaged_bytes_are_an_image_or_one_sentence(kind, chance):
    damaged = bytearray(WHOLE[kind])
    for _ in range(chance.draw(st.integers(1, 4))):
        begin = chance.draw(st.integers(0, len(damaged) - 1))
        match chance.draw(st.sampled_from(["flip", "zero", "cut", "double"])):
            case "flip":
                damaged[begin] = chance.draw(st.integers(0, 255))
            case "zero":
                length = min(chance.draw(st.integers(1, 300)), len(damaged) - begin)
                damaged[begin : begin + length] = bytes(length)
            case "cut":
                del damaged[begin : min(begin + chance.draw(st.integers(1, 300)), len(damaged) - 1)]
            case _:
                damaged[begin:begin] = damaged[begin : begin + chance.draw(st.integers(1, 300))]
    said = jpeg_damage(bytes(damaged))
    assert "\n" not in said
    if said:
        with pytest.raises(ImageDataError):
            decoded(bytes(damaged))


@given(st.binary(max_size=200))
def test_any_bytes_get_an_answer(data):
    assert jpeg_damage(data)
    assert isinstance(jpeg_damage(WHOLE["plain"][:200] + data), str)


def test_many_empty_scans_take_no_longer_than_they_are_long():
    header = data_at(WHOLE["progressive"])
    assert jpeg_damage(WHOLE["progressive"][:header] + b"\0\xff\xd0" * 200_000)
