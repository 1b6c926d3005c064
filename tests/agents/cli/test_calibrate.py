"""`suturegrasp calibrate`: from images in folders, from a running camera, and as a check of what is there."""

import os
import re
import signal
from dataclasses import replace

import cv2
import numpy as np
import pytest

from agents.camera.agent import Camera, CameraConfig
from schemas.messages import ImageEncoding
from shared.calibration import read_calibration, write_calibration
from shared.calibration.estimation.board import Board
from shared.calibration.made import made_ns
from shared.clock import now_ns
from tests.rigs.boards import endoscope, rendered, standings

CAMERA = endoscope(640, 360)
BOARD = Board(8, 6, 4.0, 3.0)
SQUARES = ("--squares", 8, 6, "--marker", 3, "--square", 4)
VIEWS = 7


@pytest.fixture(scope="module")
def pairs():
    return [rendered(CAMERA, BOARD, T, k) for k, T in enumerate(standings(VIEWS, BOARD, 8, away=60.0))]


def written(folder, pairs):
    """The options that name the folders in which these pairs lie."""
    for eye, side in enumerate(("left", "right")):
        (folder / side).mkdir(parents=True)
        for k, pair in enumerate(pairs):
            cv2.imwrite(str(folder / side / f"{k}.png"), pair[eye])
    return "--left", folder / "left", "--right", folder / "right"


@pytest.fixture(scope="module")
def folders(pairs, tmp_path_factory):
    return written(tmp_path_factory.mktemp("views"), pairs)


@pytest.mark.slow
def test_folders_become_a_calibration_in_three_forms_with_a_report(suturegrasp, folders, tmp_path):
    began_ns, out = now_ns(), tmp_path / "out"
    ended = suturegrasp("calibrate", "stereo", *SQUARES, *folders, "--output", out)
    assert ended.status == 0, ended.err
    for paths, metres_per_unit in (
        ((out / "calibration.json",), 1e-3),
        ((out / "opencv.yaml",), 1e-3),
        ((out / "ros/left.yaml", out / "ros/right.yaml"), 1.0),
    ):
        found = read_calibration(paths, unit=None, image_size=(640, 360)).calibration
        assert found.metres_per_unit == metres_per_unit
        assert found.K_left[0, 0] == pytest.approx(CAMERA.K_left[0, 0], rel=0.03)
        baseline = np.linalg.norm(found.T_right_left[:3, 3])
        assert 1e3 * metres_per_unit * baseline == pytest.approx(5.6, rel=0.03)
        assert metres_per_unit == 1.0 or began_ns - 10**9 < (made_ns(paths) or 0) <= now_ns()
    page = (out / "report.html").read_text()
    drawn = [path.name for path in (out / "pictures").iterdir()]
    assert len(drawn) == VIEWS + 3 and all(f'src="pictures/{name}"' in page for name in drawn)
    (of_one,) = re.findall(r'<tr><td>4\.png</td><td class="figure">\d+</td>(.*?)</tr>', page)
    told = re.findall(r"<td[^>]*>(.*?)</td>", of_one)
    assert len(told) == 5 and all(told), "its residuals, and what was found by a calibration made without it"
    assert "on views held out: reprojection" in ended.out
    assert "more would make it surer" in ended.err


@pytest.mark.slow
def test_views_that_contradict_the_others_or_show_no_board_are_left_out(suturegrasp, pairs, tmp_path):
    left, right = pairs[2]
    views = [*pairs[:2], (left, np.roll(right, 9, axis=0)), *pairs[3:], (left, np.full_like(right, 90))]
    ended = suturegrasp("calibrate", "stereo", *SQUARES, *written(tmp_path, views), "--output", tmp_path / "out")
    assert ended.status == 0, ended.err
    assert re.search(r"2\.png contradicts the other views by [\d.]+ px and was left out", ended.err)
    assert "7.png: left out, the board was not found in the right image" in ended.out
    assert "6 views: focal lengths" in ended.out
    page = (tmp_path / "out/report.html").read_text()
    assert re.search(r"Left out, for it contradicts the others by [\d.]+ px: 2\.png", page)
    assert "Not used: 7.png: the board was not found in the right image" in page


@pytest.mark.slow
def test_rows_that_stay_apart_are_warned_of_and_exchanged_eyes_make_no_calibration(
    suturegrasp, pairs, folders, tmp_path
):
    # each right image was moved by an amount of its own, so that no camera fits them all
    shaken = [(left, np.roll(right, (-1) ** k * (1 + k % 2), axis=0)) for k, (left, right) in enumerate(pairs)]
    ended = suturegrasp("calibrate", "stereo", *SQUARES, *written(tmp_path, shaken), "--output", tmp_path / "out")
    assert ended.status == 0, ended.err
    assert "rows are off by more than 0.5 px on views held out" in ended.err
    exchanged = ("--left", folders[3], "--right", folders[1], "--output", tmp_path / "other")
    ended = suturegrasp("calibrate", "stereo", *SQUARES, *exchanged)
    assert ended.status == 3
    assert "left and right look exchanged; give them the other way round" in ended.err.splitlines()[-1]
    assert list((tmp_path / "other").iterdir()) == []


@pytest.mark.slow
def test_a_calibration_is_checked_against_views_in_folders_and_side_by_side(suturegrasp, folders, pairs, tmp_path):
    write_calibration(tmp_path / "right.json", CAMERA)
    lower = CAMERA.K_right + np.array([[0, 0, 0], [0, 0, 3.0], [0, 0, 0]])
    write_calibration(tmp_path / "lower.json", replace(CAMERA, K_right=lower))
    (tmp_path / "both").mkdir()
    for k, pair in enumerate(pairs[:3]):
        cv2.imwrite(str(tmp_path / f"both/{k}.png"), np.hstack(pair))

    def check(name, *images, square=4.0):
        squares = (*SQUARES[:-1], square)
        return suturegrasp("calibrate", "check", *squares, *images, "--calibration", tmp_path / f"{name}.json")

    ended = check("right", *folders)
    assert (ended.status, ended.err) == (0, "")
    assert "squares are right to 0." in ended.out.splitlines()[-1]
    ended = check("right", "--stereo", tmp_path / "both", square=4.2)
    assert ended.status == 1 and "squares are off by" in ended.err
    ended = check("lower", "--stereo", tmp_path / "both")
    assert ended.status == 1
    assert re.search(r"rows are [23]\.\d\d px apart", ended.err)


@pytest.mark.renders
def test_the_laparoscope_is_as_good_as_its_makers_say(suturegrasp, data, tmp_path):
    folder = data / "storz_calibration"
    for eye in ("left", "right"):
        (tmp_path / eye).mkdir()
        for path in folder.glob(f"calib.{eye}.images.*.png"):
            (tmp_path / eye / path.name).symlink_to(path)
    images = "--left", tmp_path / "left", "--right", tmp_path / "right"
    ended = suturegrasp("calibrate", "check", "--squares", 14, 9, "--square", 3, *images, "--calibration", folder)
    assert (ended.status, ended.err) == (0, "")
    told = ended.out.splitlines()[-1].split()
    assert float(told[2]) <= 0.25, "rows, in px"
    assert float(told[-1].rstrip("%")) <= 1, "squares"


class Held:
    """A camera before which a board is held still, and then elsewhere; its user may press Ctrl-C at some frame."""

    taken_ns = 0, 0

    def __init__(self, pairs, let_go=-1):
        self._pairs, self._frame, self._let_go = pairs, 0, let_go

    def read(self):
        if self._frame == self._let_go:
            os.kill(os.getpid(), signal.SIGINT)
        self._frame += 1
        left, right = self._pairs[self._frame // 8 % len(self._pairs)]
        return cv2.cvtColor(left, cv2.COLOR_GRAY2BGR), cv2.cvtColor(right, cv2.COLOR_GRAY2BGR)

    def close(self):
        pass


@pytest.fixture
def live(suturegrasp, settings, in_threads, rig_file, tmp_path):
    """Calibrates live, before a source of frames, into the folder `out`."""

    def run(source, views):
        camera = Camera(source, CAMERA, CameraConfig(rate_hz=15.0, encoding=ImageEncoding.PNG))
        out = "--output", tmp_path / "out", "--config", rig_file()
        with in_threads(settings, camera):
            return suturegrasp("calibrate", "stereo", *SQUARES, "--live", "--views", views, *out)

    return run


@pytest.mark.slow
def test_live_frames_become_a_calibration(live, pairs, tmp_path):
    ended, out = live(Held(pairs), 6), tmp_path / "out"
    assert ended.status == 0, ended.err
    assert len({path.read_bytes() for path in (out / "left").iterdir()}) == 6, "each way the board stood once"
    assert len(list((out / "right").iterdir())) == 6
    assert "view00 is kept; " in ended.out
    assert (out / "calibration.json").exists() and (out / "report.html").exists()


@pytest.mark.slow
def test_live_ctrl_c_ends_it_with_what_there_is(live, pairs, tmp_path):
    assert live(Held(pairs, let_go=3 * 8), 30).status == 3
    assert not (tmp_path / "out/calibration.json").exists()


@pytest.mark.parametrize(
    ("arguments", "status", "told"),
    [
        ("stereo", 2, "give --output"),
        ("stereo --output {tmp}/new", 2, "give --left and --right, or --stereo, or --live"),
        ("stereo --output {tmp}", 2, "holds something already"),
        ("stereo --output {tmp}/new --marker 9", 2, "a marker must be smaller"),
        ("stereo --output {tmp}/new --stereo {tmp}/none", 2, "is no folder"),
        ("stereo --output {tmp}/new --calibration c", 2, "say calibrate check"),
        ("stereo --output {tmp}/new --stereo {tmp}/plain", 3, "no pair shows the board to both eyes"),
        ("stereo --output {tmp}/new --stereo {tmp}/sizes", 2, "320x90 (0.png) and 160x90 (1.png)"),
        ("stereo --output {tmp}/new --left {tmp}/plain --right {tmp}/sizes", 2, "sizes holds 2; give equally many"),
        ("stereo --output {tmp}/plain/0.png --stereo {tmp}/plain", 2, "0.png is a file; give a folder that is new"),
        ("stereo --output {tmp}/new --live --views 4", 2, "--views 4: give 5 or more"),
        ("check --stereo {tmp}/plain", 2, "give the --calibration"),
        ("check --live", 2, "leave --live and --output out"),
    ],
)
def test_what_cannot_be_carried_out_is_said_in_one_line(suturegrasp, tmp_path, arguments, status, told):
    for name, width in (("plain/0", 640), ("sizes/0", 640), ("sizes/1", 320)):
        path = (tmp_path / name).with_suffix(".png")
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), np.full((90, width), 120, np.uint8))
    command, *others = arguments.format(tmp=tmp_path).split()
    ended = suturegrasp("calibrate", command, *SQUARES, *others)
    assert ended.status == status
    assert told in ended.err.splitlines()[-1]
