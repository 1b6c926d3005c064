"""`suturegrasp segment`: its files, and one line about whatever is wrong with the input."""

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.classes import Kind, highest, scores_of

HEIGHT, WIDTH = 90, 150


def picture():
    image = np.random.default_rng(4).normal((90, 110, 190), 6, (HEIGHT, WIDTH, 3))
    image = np.clip(cv2.GaussianBlur(image, (0, 0), 1.2), 0, 255).astype(np.uint8)
    cv2.line(image, (10, 15), (140, 80), (120, 40, 30), 5, cv2.LINE_AA)
    return image


@pytest.fixture
def image(tmp_path):
    path = tmp_path / "image.png"
    cv2.imwrite(str(path), picture())
    return path


def read(path):
    found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert found is not None
    return found


def refused(ended, said):
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (2, "", 1)
    assert ended.err.startswith("suturegrasp: ")
    assert said in ended.err


def test_classes_scores_and_a_picture_are_written(suturegrasp, image, tmp_path):
    classes, scores, drawn = tmp_path / "classes.png", tmp_path / "scores.png", tmp_path / "drawn.png"
    ended = suturegrasp("segment", "--image", image, "--output", classes, "--scores", scores, "--picture", drawn)
    assert (ended.status, ended.err) == (0, "")
    assert f"of {WIDTH}x{HEIGHT} pixels: {classes}, {scores}, {drawn}" in ended.out
    written, seen = read(classes), read(drawn)
    assert written.dtype == np.uint8
    np.testing.assert_array_equal(written, highest(scores_of(picture())))
    np.testing.assert_array_equal(read(scores), np.rint(255 * scores_of(picture())[..., 1:]))
    is_ground = written == Kind.GROUND
    np.testing.assert_array_equal(seen[is_ground], picture()[is_ground])
    assert (seen[~is_ground] != picture()[~is_ground]).any(axis=1).all()


def test_images_of_any_size_and_depth_are_taken(suturegrasp, tmp_path):
    image, classes = tmp_path / "image.png", tmp_path / "classes.png"
    wide = cv2.resize(picture(), (1400, 50))
    for stored, shown in (
        (picture()[:16, :16], picture()[:16, :16]),
        (wide, wide),
        (picture()[..., 1], np.repeat(picture()[..., 1:2], 3, axis=2)),
        (picture().astype(np.uint16) * 257, picture()),
    ):
        cv2.imwrite(str(image), stored)
        assert suturegrasp("segment", "--image", image, "--output", classes).status == 0
        np.testing.assert_array_equal(read(classes), highest(scores_of(shown)))


def test_a_bad_image_is_named_in_one_line(suturegrasp, tmp_path):
    path, output = tmp_path / "bad.png", tmp_path / "classes.png"
    for content, said in (
        (None, "does not exist; check the path"),
        (b"left image", "no image that can be decoded"),
        (cv2.imencode(".png", picture()[:9])[1].tobytes(), "has only 150x9 pixels"),
    ):
        if content is not None:
            path.write_bytes(content)
        ended = suturegrasp("segment", "--image", path, "--output", output)
        refused(ended, said)
        assert str(path) in ended.err
        assert not output.exists()


def test_outputs_that_cannot_or_must_not_be_written_are_refused(suturegrasp, image, tmp_path):
    before, other = image.read_bytes(), tmp_path / "classes.png"
    for arguments, said in (
        (("--output", tmp_path / "none" / "classes.png"), "does not exist; create it first"),
        (("--output", tmp_path), "is a folder"),
        (("--output", tmp_path / "classes.jpg"), "must end in .png"),
        (("--output", image), "would overwrite --image"),
        (("--output", other, "--scores", other), "would overwrite --output"),
        (("--output", other, "--picture", tmp_path / "drawn.gif"), "must end in .png or .jpg or .jpeg"),
    ):
        refused(suturegrasp("segment", "--image", image, *arguments), said)
    assert image.read_bytes() == before
    assert not other.exists()
