"""The doctor on a pair from files, and on the frames of a camera that runs on a real router."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from agents.camera.agent import Camera, CameraConfig
from agents.camera.image_files import read_pair
from agents.diagnostics.doctor.image_answers import about_size, answers_about
from agents.diagnostics.doctor.images import examine_frames
from schemas.messages import ImageEncoding, Severity, StereoCalibration
from shared.calibration import read_calibration
from shared.runtime.connection import connected

K = np.array([[1000.0, 0, 479.5], [0, 1000.0, 269.5], [0, 0, 1]])
T_RIGHT_LEFT = np.eye(4)
T_RIGHT_LEFT[0, 3] = -5.5
CALIBRATION = StereoCalibration(960, 540, K, K, np.zeros(0), np.zeros(0), T_RIGHT_LEFT, 1e-3)
"""That of the shipped example."""


@pytest.fixture(scope="module")
def files(example):
    """The shipped pair and its calibration."""
    return example / "left.png", example / "right.png", example / "calibration.json"


@pytest.fixture(scope="module")
def images(files):
    return read_pair(*files[:2])


def told(suturegrasp, left, right, calibration, *more):
    ended = suturegrasp("doctor", "--left", left, "--right", right, "--calibration", calibration, *more)
    return ended, [line for line in ended.out.splitlines() if line.startswith("WRONG")]


def test_a_whole_pair_is_well(suturegrasp, files):
    ended, _ = told(suturegrasp, *files, "--json")
    document = json.loads(ended.out)
    assert (ended.status, ended.err, document.keys(), document["well"]) == (0, "", {"well", "findings"}, True)
    assert {finding["state"] for finding in document["findings"]} <= {"ok", "unknown"}
    (rows,) = [finding["found"] for finding in document["findings"] if finding["what"] == "images, rows"]
    assert rows.startswith("what corresponds lies 0.")


def test_exchanged_images_are_named_with_their_remedy(suturegrasp, files):
    left, right, about = files
    ended, wrong = told(suturegrasp, right, left, about)
    assert ended.status == 1
    assert any("exchange --left and --right" in line for line in wrong)


@pytest.mark.renders
def test_the_laparoscopes_lenses_tell_exchanged_and_mirrored_eyes(data):
    folder = data / "storz_calibration"
    left, right = read_pair(*(folder / f"calib.{eye}.images.0.png" for eye in ("left", "right")))
    read = read_calibration(folder, unit="mm", image_size=(1920, 1080)).calibration
    mirrored = left[:, ::-1].copy(), right[:, ::-1].copy()
    assert [a.question for a in answers_about((left, right), read) if a.wrong] == []
    for pair, remedy in (((right, left), "exchange --left and --right"), (mirrored, "turn off mirroring")):
        (wrong,) = [a.wrong for a in answers_about(pair, read) if a.wrong]
        assert wrong.remedy == remedy


def test_a_calibration_that_cannot_be_rectified_is_a_fault_with_its_remedy(images):
    forward = np.eye(4)
    forward[2, 3] = 5.5
    (wrong,) = [a.wrong for a in answers_about(images, replace(CALIBRATION, T_right_left=forward)) if a.wrong]
    assert (wrong.code, wrong.severity) == ("not_rectifiable", Severity.FAULT)
    assert wrong.remedy == "use the calibration of this camera, or calibrate again"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("--left a.png", "give the --calibration"),
        ("--left a.png --calibration c.json", "give either both --left and --right"),
        ("--calibration c.json", "give either both --left and --right"),
        ("--stereo s.png --left a.png --calibration c.json", "give either both"),
    ],
)
def test_options_that_name_no_pair_are_refused(suturegrasp, arguments, sentence):
    ended = suturegrasp("doctor", *arguments.split())
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (2, "", 1)
    assert sentence in ended.err


def test_files_that_cannot_be_read_are_findings(suturegrasp, files, tmp_path):
    left, right, about = files
    for named, said in (
        ((tmp_path / "none.png", right, about), "does not exist"),
        ((left, right, tmp_path / "none.json"), "calibration"),
        ((*files, "--unit", "parsec"), "unknown unit 'parsec'; choose from m, cm, mm, um"),
        ((*files, about), "both paths are one file; name it once"),
    ):
        ended, (wrong,) = told(suturegrasp, *named)
        assert ended.status == 1 and said in wrong
        assert wrong.count("; ") == 1, "what was found, and one remedy"


@pytest.mark.parametrize(
    ("size", "words"),
    [
        ((480, 270), "scaled to 50%, or cropped"),
        ((960, 480), "cropped"),
        ((1920, 1200), "the images are 1920x1200"),
        ((480, 540), "half as wide, as where an image of one eye is taken for both side by side"),
        ((480, 1080), "as where the eyes lie one above the other"),
    ],
)
def test_images_of_another_size_are_a_fault(size, words):
    answer = about_size(size[0], size[1], CALIBRATION)
    assert answer.wrong is not None and answer.wrong.code == "size"
    assert words in answer.found


def test_cropped_images_are_said_to_be_beside_what_the_calibration_is_for(suturegrasp, files, images, tmp_path):
    cropped = [tmp_path / f"{eye}.png" for eye in ("left", "right")]
    for file, image in zip(cropped, images, strict=True):
        cv2.imwrite(str(file), image[:400])
    ended, (wrong,) = told(suturegrasp, *cropped, files[2])
    assert ended.status == 1
    assert "960x540: cropped; turn cropping off" in wrong and wrong.endswith("(fault size)")


class Swaying:
    """A camera above a scene that sways, whose right eye may stand still."""

    taken_ns = 0, 0

    def __init__(self, images, stands_still):
        self._images, self._stands_still, self._frame = images, stands_still, 0

    def read(self):
        self._frame += 1
        moved = round(20 * abs(np.sin(self._frame / 3)))
        left = np.roll(self._images[0], moved, axis=0)
        return left, self._images[1] if self._stands_still else np.roll(self._images[1], moved, axis=0)

    def close(self):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("stands_still", [False, True])
def test_frames_of_a_camera_that_runs_are_judged(images, settings, in_threads, stands_still):
    camera = Camera(Swaying(images, stands_still), CALIBRATION, CameraConfig(encoding=ImageEncoding.JPEG))
    with in_threads(settings, camera), connected(settings, 60.0) as connection:
        found = {finding.what: finding for finding in examine_frames(connection)}
    frozen = found["images, frozen"]
    if stands_still:
        assert "the right eye shows the very same picture" in frozen.found and "(fault frozen)" in frozen.remedy
    else:
        assert frozen.state == "ok"
        assert [f.what for f in found.values() if f.remedy] == []


@pytest.mark.slow
def test_no_camera_is_no_fault(settings):
    with connected(settings, 60.0) as connection:
        (finding,) = examine_frames(connection)
    assert finding.state == "?"
