"""Sources on real files, videos and pipes."""

import os
import threading

import cv2
import numpy as np
import pytest

from agents.camera.sources import BrokenOffError, ImageSource, PipeSource, SourceError

HEIGHT, WIDTH = 48, 64


def picture(value, width=WIDTH):
    """Plain grey that tells its number."""
    return np.full((HEIGHT, width, 3), value, np.uint8)


def folder(path, values, width=WIDTH):
    path.mkdir(parents=True)
    for number, value in enumerate(values):
        assert cv2.imwrite(str(path / f"{number:03d}.png"), picture(value, width))
    return path


def levels(pair):
    """The mean grey of both images, which survives JPEG."""
    return [round(float(image.mean())) for image in pair]


def all_of(source):
    found = []
    while (pair := source.read()) is not None:
        found.append(pair)
    source.close()
    return found


def test_separate_folders_pair_up_in_name_order(tmp_path):
    source = ImageSource(folder(tmp_path / "l", [10, 20, 30]), folder(tmp_path / "r", [11, 21, 31]), loop=False)
    assert [levels(pair) for pair in all_of(source)] == [[10, 11], [20, 21], [30, 31]]
    assert source.read() is None


def test_side_by_side_images_are_cut_in_their_middle(tmp_path):
    path = tmp_path / "both"
    path.mkdir()
    cv2.imwrite(str(path / "a.png"), np.hstack([picture(40), picture(50)]))
    (left, right), *rest = all_of(ImageSource(path, None, loop=False))
    assert (left.shape, right.shape, rest) == ((HEIGHT, WIDTH, 3), (HEIGHT, WIDTH, 3), [])
    assert ((left == 40).all(), (right == 50).all()) == (True, True)


def test_a_loop_begins_again_and_single_files_are_one_pair(tmp_path):
    left, right = folder(tmp_path / "l", [1, 2]), folder(tmp_path / "r", [3, 4])
    source = ImageSource(left, right, loop=True)
    pairs = [source.read() for _ in range(5)]
    assert [levels(pair) for pair in pairs if pair] == [[1, 3], [2, 4], [1, 3], [2, 4], [1, 3]]
    single = ImageSource(left / "000.png", right / "000.png", loop=False)
    assert [levels(pair) for pair in all_of(single)] == [[1, 3]]


def test_unequal_counts_and_folders_without_images_are_named(tmp_path):
    with pytest.raises(SourceError, match=r"l holds 2 images and .*r holds 1; give equally many"):
        ImageSource(folder(tmp_path / "l", [1, 2]), folder(tmp_path / "r", [1]), loop=False)
    (tmp_path / "empty").mkdir()
    for name in ("empty", "absent"):
        with pytest.raises(SourceError, match=rf"{name} holds no images \(\.png, \.jpg"):
            ImageSource(tmp_path / name, None, loop=False)


def test_a_damaged_image_is_one_sentence_and_the_next_pair_follows(tmp_path):
    left = folder(tmp_path / "l", [1, 2])
    (left / "000.png").write_bytes(b"no image")
    source = ImageSource(left, folder(tmp_path / "r", [3, 4]), loop=False)
    with pytest.raises(SourceError, match=r"000\.png is damaged"):
        source.read()
    assert [levels(pair) for pair in all_of(source)] == [[2, 4]]


@pytest.fixture
def pipe():
    """A pipe: what its writer puts in, and the source at its other end."""
    read, write = os.pipe()
    with os.fdopen(read, "rb") as stream, os.fdopen(write, "wb", buffering=0) as writer:
        source = PipeSource(stream, 2 * WIDTH, HEIGHT)
        yield writer, source
        source.close()


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
def test_the_end_of_a_pipe_is_a_fault_once_the_last_frame_was_read(left_over, said, until):
    read, write = os.pipe()
    with os.fdopen(read, "rb") as stream:
        source = PipeSource(stream, 2 * WIDTH, HEIGHT)
        with os.fdopen(write, "wb", buffering=0) as writer:
            writer.write(raw(7) + bytes(left_over))

        assert levels(until(source.read)) == [7, 8]
        with pytest.raises(BrokenOffError, match=said):
            until(lambda: source.read() is not None)
        with pytest.raises(BrokenOffError, match=said):
            source.read()
        source.close()


def test_a_silent_pipe_can_be_closed_and_a_frame_without_two_halves_is_refused():
    read, write = os.pipe()
    with os.fdopen(write, "wb"), os.fdopen(read, "rb") as stream:
        with pytest.raises(SourceError, match="63 pixels"):
            PipeSource(stream, 63, HEIGHT)
        source = PipeSource(stream, 2 * WIDTH, HEIGHT)
        closing = threading.Thread(target=source.close, daemon=True)
        closing.start()
        closing.join(60.0)
        assert not closing.is_alive()
