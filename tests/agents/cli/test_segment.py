"""`suturegrasp segment`: its files, and one line about whatever is wrong with the input."""

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.classes import Kind, highest, scores_of
from tests.agents.cli.conftest import refused

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
    grey = np.repeat(picture()[:16, :, 1:2], 3, axis=2)
    cv2.imwrite(str(image), grey[..., 0])
    assert suturegrasp("segment", "--image", image, "--output", classes).status == 0
    np.testing.assert_array_equal(read(classes), highest(scores_of(grey)))


def test_what_cannot_be_read_or_must_not_be_written_is_refused(suturegrasp, image, tmp_path):
    before, other, bad = image.read_bytes(), tmp_path / "classes.png", tmp_path / "bad.png"
    bad.write_bytes(cv2.imencode(".png", picture()[:9])[1].tobytes())
    for named, arguments, told in (
        (bad, ("--output", other), "has only 150x9 pixels"),
        (tmp_path / "none.png", ("--output", other), "none.png does not exist; check the path"),
        (image, ("--output", tmp_path / "none" / "classes.png"), "does not exist; create it first"),
        (image, ("--output", tmp_path / "classes.jpg"), "must end in .png"),
        (image, ("--output", image), "would overwrite --image"),
        (image, ("--output", other, "--scores", other), "would overwrite --output"),
        (image, ("--output", other, "--picture", tmp_path / "drawn.gif"), "must end in .png or .jpg or .jpeg"),
    ):
        refused(suturegrasp("segment", "--image", named, *arguments), told)
    assert image.read_bytes() == before
    assert not other.exists()
