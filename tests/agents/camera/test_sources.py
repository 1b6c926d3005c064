"""Sources on real files and pipes."""

import os
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from agents.camera.sources import BrokenOffError, ImageSource, PipeSource, SourceError
from tests.agents.camera.conftest import HEIGHT, WIDTH, levels, picture


def folder(path, values):
    path.mkdir(parents=True)
    for number, value in enumerate(values):
        assert cv2.imwrite(str(path / f"{number:03d}.png"), picture(value))
    return path


def read_all(source):
    found = []
    while (pair := source.read()) is not None:
        found.append(levels(pair))
    return found


def test_folders_pair_up_in_name_order_once_or_in_a_loop_and_one_of_both_eyes_is_cut_in_its_middle(tmp_path):
    left, right = folder(tmp_path / "l", [10, 20]), folder(tmp_path / "r", [11, 21])
    once, loop = (ImageSource(left, right, loop=loop) for loop in (False, True))
    assert read_all(once) == [[10, 11], [20, 21]]
    assert once.read() is None
    assert [levels(loop.read()) for _ in range(5)] == [[10, 11], [20, 21], [10, 11], [20, 21], [10, 11]]
    assert read_all(ImageSource(left / "000.png", right / "000.png", loop=False)) == [[10, 11]]
    cv2.imwrite(str(tmp_path / "both.png"), np.hstack([picture(40), picture(50)]))
    assert read_all(ImageSource(tmp_path / "both.png", None, loop=False)) == [[40, 50]]


def test_unequal_counts_and_folders_without_images_are_named(tmp_path):
    with pytest.raises(SourceError, match=r"l holds 2 images and .*r holds 1; give equally many"):
        ImageSource(folder(tmp_path / "l", [1, 2]), folder(tmp_path / "r", [1]), loop=False)
    with pytest.raises(SourceError, match=r"absent holds no images \(\.png, \.jpg"):
        ImageSource(tmp_path / "absent", None, loop=False)


def test_a_damaged_image_is_one_sentence_and_the_next_pair_follows(tmp_path):
    left = folder(tmp_path / "l", [1, 2])
    (left / "000.png").write_bytes(b"no image")
    source = ImageSource(left, folder(tmp_path / "r", [3, 4]), loop=False)
    with pytest.raises(SourceError, match=r"000\.png is damaged"):
        source.read()
    assert read_all(source) == [[2, 4]]


@pytest.fixture
def pipe():
    """A pipe: what its writer puts in, and the source at its other end."""
    read, write = os.pipe()
    with os.fdopen(read, "rb") as stream, os.fdopen(write, "wb", buffering=0) as writer:
        source = PipeSource(stream, 2 * WIDTH, HEIGHT)
        yield writer, source
        closing = threading.Thread(target=source.close, daemon=True)
        closing.start()
        closing.join(60.0)
        assert not closing.is_alive(), "a silent pipe can be closed"


def raw(value):
    return np.hstack([picture(value), picture(value + 1)]).tobytes()


def test_frames_on_a_pipe_are_each_read_once_when_they_are_whole(pipe, until):
    writer, source = pipe
    for value in (10, 20):
        writer.write(raw(value))
        assert levels(until(source.read)) == [value, value + 1]
    assert source.read() is None
    data = raw(33)
    for piece in (data[:1000], data[1000:-1]):
        writer.write(piece)
        assert source.read() is None
    writer.write(data[-1:] + raw(44)[:10])
    assert levels(until(source.read)) == [33, 34]


def test_a_slow_reader_gets_the_newest_and_never_holds_up_the_writer(pipe, until):
    writer, source = pipe
    sent = threading.Thread(target=lambda: [writer.write(raw(value)) for value in range(200)], daemon=True)
    sent.start()
    # far more than a pipe holds
    sent.join(60.0)
    assert not sent.is_alive()
    until(lambda: (pair := source.read()) is not None and levels(pair) == [199, 200])
    assert source.read() is None


@pytest.mark.parametrize(("left_over", "said"), [(0, "has ended; start"), (100, r"100 of 18432 bytes; check width")])
def test_the_end_of_a_pipe_is_a_fault_once_the_last_frame_was_read(pipe, left_over, said, until):
    writer, source = pipe
    writer.write(raw(7) + bytes(left_over))
    writer.close()
    assert levels(until(source.read)) == [7, 8]
    for _ in range(2):
        with pytest.raises(BrokenOffError, match=said):
            until(lambda: source.read() is not None)


def test_a_frame_without_two_halves_is_refused():
    with Path(os.devnull).open("rb") as stream, pytest.raises(SourceError, match="63 pixels"):
        PipeSource(stream, 63, HEIGHT)
