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


@pytest.fixture
def wrong(suturegrasp):
    """What the doctor finds wrong with a pair."""

    def told(left, right, calibration, *more):
        ended = suturegrasp("doctor", "--left", left, "--right", right, "--calibration", calibration, *more)
        assert ended.status == 1
        return [line for line in ended.out.splitlines() if line.startswith("WRONG")]

    return told


def test_a_whole_pair_is_well_and_exchanged_images_are_named_with_their_remedy(suturegrasp, files, wrong):
    left, right, about = files
    ended = suturegrasp("doctor", "--left", left, "--right", right, "--calibration", about, "--json")
    document = json.loads(ended.out)
    assert (ended.status, ended.err, document.keys(), document["well"]) == (0, "", {"well", "findings"}, True)
    assert {finding["state"] for finding in document["findings"]} <= {"ok", "unknown"}
    (rows,) = [finding["found"] for finding in document["findings"] if finding["what"] == "images, rows"]
    assert rows.startswith("what corresponds lies 0.")
    assert any("exchange --left and --right" in line for line in wrong(right, left, about))


def test_files_that_cannot_be_used_are_findings_each_with_one_remedy(files, images, tmp_path, wrong):
    left, right, about = files
    cropped = [tmp_path / f"{eye}.png" for eye in ("left", "right")]
    for file, image in zip(cropped, images, strict=True):
        cv2.imwrite(str(file), image[:400])
    for named, said in (
        ((tmp_path / "none.png", right, about), "does not exist"),
        ((left, right, tmp_path / "none.json"), "calibration"),
        ((*files, "--unit", "parsec"), "unknown unit 'parsec'; choose from m, cm, mm, um"),
        ((*files, about), "both paths are one file; name it once"),
        ((*cropped, about), "960x540: cropped; turn cropping off"),
    ):
        (line,) = wrong(*named)
        assert said in line
        assert line.count("; ") == 1, "what was found, and one remedy"


def test_a_calibration_of_images_of_another_size_or_that_cannot_be_rectified_is_a_fault(images):
    for width, height, words in (
        (480, 270, "scaled to 50%, or cropped"),
        (1920, 1200, "the images are 1920x1200"),
        (480, 540, "half as wide, as where an image of one eye is taken for both side by side"),
        (480, 1080, "as where the eyes lie one above the other"),
    ):
        answer = about_size(width, height, CALIBRATION)
        assert answer.wrong is not None and answer.wrong.code == "size"
        assert words in answer.found
    forward = np.eye(4)
    forward[2, 3] = 5.5
    (fault,) = [a.wrong for a in answers_about(images, replace(CALIBRATION, T_right_left=forward)) if a.wrong]
    assert (fault.code, fault.severity) == ("not_rectifiable", Severity.FAULT)
    assert fault.remedy == "use the calibration of this camera, or calibrate again"


class Swaying:
    """A camera above a scene that sways, whose right eye may stand still."""

    taken_ns = 0, 0

    def __init__(self, images, stands_still):
        self._images, self._stands_still, self._frame = images, stands_still, 0

    def read(self):
        self._frame += 1
        left, right = (np.roll(image, round(20 * abs(np.sin(self._frame / 3))), axis=0) for image in self._images)
        return left, self._images[1] if self._stands_still else right

    def close(self):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("stands_still", [False, True])
def test_frames_of_a_camera_that_runs_are_judged_and_no_camera_is_no_fault(images, settings, in_threads, stands_still):
    camera = Camera(Swaying(images, stands_still), CALIBRATION, CameraConfig(encoding=ImageEncoding.JPEG))
    with connected(settings, 60.0) as connection:
        assert [finding.state for finding in examine_frames(connection)] == ["?"]
        with in_threads(settings, camera):
            found = {finding.what: finding for finding in examine_frames(connection)}
    frozen = found["images, frozen"]
    if stands_still:
        assert "the right eye shows the very same picture" in frozen.found and "(fault frozen)" in frozen.remedy
    else:
        assert [f.what for f in found.values() if f.remedy] == []
        assert frozen.state == "ok"
