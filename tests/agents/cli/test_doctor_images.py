"""The doctor on a pair from files, and on the frames of a camera that runs on a real router."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from agents.camera.agent import Camera, CameraConfig
from agents.camera.image_files import read_pair
from agents.cli.doctor.image_answers import about_size, answers_about
from agents.cli.doctor.images import examine_frames
from schemas.messages import ImageEncoding, Severity, StereoCalibration
from shared.calibration import read_calibration
from shared.runtime.connection import connected


def calibration(width=960, height=540):
    K = np.array([[1000.0, 0, 479.5], [0, 1000.0, 269.5], [0, 0, 1]])
    T = np.eye(4)
    T[0, 3] = -5.5
    return StereoCalibration(width, height, K, K, np.zeros(0), np.zeros(0), T, 1e-3)


@pytest.fixture
def render(data):
    folder = data / "renders"
    return tuple(folder / f"sample_05{ending}" for ending in ("_left.png", "_right.png", ".json"))


def told(suturegrasp, left, right, calibration, *more):
    ended = suturegrasp("doctor", "--left", left, "--right", right, "--calibration", calibration, *more)
    return ended, [line for line in ended.out.splitlines() if line.startswith("WRONG")]


def test_a_whole_pair_is_well(suturegrasp, render):
    ended, wrong = told(suturegrasp, *render)
    assert (ended.status, ended.err, wrong) == (0, "", [])
    assert any("rows: what corresponds lies 0." in line for line in ended.out.splitlines())


def test_exchanged_images_are_named_with_their_remedy(suturegrasp, render):
    left, right, about = render
    ended, wrong = told(suturegrasp, right, left, about)
    assert ended.status == 1
    assert any("exchange --left and --right" in line for line in wrong)


def test_the_laparoscope_tells_its_eyes_apart_by_their_lenses(data):
    folder = data / "storz_calibration"
    images = read_pair(*(folder / f"calib.{eye}.images.0.png" for eye in ("left", "right")))
    read = read_calibration(folder, unit="mm", image_size=(1920, 1080)).calibration
    assert [a.question for a in answers_about(images, read) if a.wrong] == []
    (wrong,) = [a.wrong for a in answers_about((images[1], images[0]), read) if a.wrong]
    assert (wrong.code, wrong.remedy) == ("left_right_swapped", "exchange --left and --right")


def test_eyes_that_are_both_mirrored_are_told_by_their_lenses(data):
    folder = data / "storz_calibration"
    left, right = read_pair(*(folder / f"calib.{eye}.images.0.png" for eye in ("left", "right")))
    read = read_calibration(folder, unit="mm", image_size=(1920, 1080)).calibration
    (wrong,) = [a.wrong for a in answers_about((left[:, ::-1].copy(), right[:, ::-1].copy()), read) if a.wrong]
    assert wrong.remedy == "turn off mirroring"


def test_a_calibration_that_cannot_be_rectified_is_a_fault_with_its_remedy(render):
    forward = np.eye(4)
    forward[2, 3] = 5.5
    answers = answers_about(read_pair(*render[:2]), replace(calibration(), T_right_left=forward))
    (wrong,) = [a.wrong for a in answers if a.wrong]
    assert (wrong.code, wrong.severity) == ("not_rectifiable", Severity.FAULT)
    assert wrong.remedy == "use the calibration of this camera, or calibrate again"


def test_json_tells_the_same(suturegrasp, render):
    ended, _ = told(suturegrasp, *render, "--json")
    document = json.loads(ended.out)
    assert document["well"] is True and document.keys() == {"well", "findings"}
    assert {finding["state"] for finding in document["findings"]} <= {"ok", "unknown"}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--left", "a.png"), "give the --calibration"),
        (("--left", "a.png", "--calibration", "c.json"), "give either both --left and --right"),
        (("--calibration", "c.json"), "give either both --left and --right"),
        (("--stereo", "s.png", "--left", "a.png", "--calibration", "c.json"), "give either both"),
    ],
)
def test_options_that_name_no_pair_are_refused(suturegrasp, arguments, sentence):
    ended = suturegrasp("doctor", *arguments)
    assert (ended.status, ended.out) == (2, "")
    assert sentence in ended.err and len(ended.err.splitlines()) == 1


def test_images_and_calibrations_that_cannot_be_read_are_findings(suturegrasp, render, tmp_path):
    left, right, about = render
    ended, wrong = told(suturegrasp, tmp_path / "none.png", right, about)
    assert ended.status == 1 and "does not exist" in wrong[0]
    assert wrong[0].count("; ") == 1
    ended, wrong = told(suturegrasp, left, right, tmp_path / "none.json")
    assert ended.status == 1 and "calibration" in wrong[0]


def test_a_unit_that_nobody_knows_and_one_file_given_twice_are_said_as_what_they_are(suturegrasp, render):
    for more, said in (
        (("--unit", "parsec"), "unknown unit 'parsec'; choose from m, cm, mm, um"),
        ((render[2],), "both paths are one file; name it once"),
    ):
        ended, (wrong,) = told(suturegrasp, *render, *more)
        assert ended.status == 1 and said in wrong


def test_images_that_were_scaled_or_cropped_are_said_to_be_beside_what_the_calibration_is_for(
    suturegrasp, render, tmp_path
):
    left, right = read_pair(*render[:2])
    for name, change, said in (
        ("scaled", lambda image: cv2.resize(image, (480, 270)), "scaled to 50%"),
        ("cropped", lambda image: image[:400], "960x540: cropped; turn cropping off"),
    ):
        files = [tmp_path / f"{name}_{eye}.png" for eye in ("left", "right")]
        for file, image in zip(files, (left, right), strict=True):
            cv2.imwrite(str(file), change(image))
        ended, (wrong,) = told(suturegrasp, *files, render[2])
        assert ended.status == 1
        assert said in wrong and wrong.endswith("(fault size)")


@pytest.mark.parametrize(
    ("size", "words"),
    [((480, 270), "scaled to 50%, or cropped"), ((960, 480), "cropped"), ((1920, 1200), "the images are 1920x1200")],
)
def test_images_of_another_size_are_a_fault(size, words):
    answer = about_size(size[0], size[1], calibration())
    assert answer.wrong is not None and answer.wrong.code == "size"
    assert words in answer.found


class Swaying:
    """A camera above a render that sways, whose right eye may stand still."""

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


@pytest.mark.parametrize("stands_still", [False, True])
def test_frames_of_a_camera_that_runs_are_judged(render, settings, in_threads, stands_still):
    images = read_pair(*render[:2])
    config = CameraConfig(encoding=ImageEncoding.JPEG)
    with (
        in_threads(settings, Camera(Swaying(images, stands_still), calibration(), config)),
        connected(settings, 60.0) as connection,
    ):
        found = {finding.what: finding for finding in examine_frames(connection)}
    frozen = found["images, frozen"]
    if stands_still:
        assert "the right eye shows the very same picture" in frozen.found and "(fault frozen)" in frozen.remedy
    else:
        assert frozen.state == "ok"
        assert found["images, both eyes at one moment"].remedy == ""
        assert [f.what for f in found.values() if f.remedy] == []


def test_no_camera_is_no_fault(settings):
    with connected(settings, 60.0) as connection:
        (finding,) = examine_frames(connection)
    assert finding.state == "?"
