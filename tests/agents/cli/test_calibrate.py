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
MARKER = ("--marker", 3)
SQUARES = ("--squares", 8, 6, "--square", 4, *MARKER)
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
    began_ns = now_ns()
    ended = suturegrasp("calibrate", "stereo", *SQUARES, *folders, "--output", tmp_path / "out")
    assert ended.status == 0, ended.err
    out = tmp_path / "out"
    found = [
        read_calibration(paths, unit=None, image_size=(640, 360)).calibration
        for paths in (out / "calibration.json", out / "opencv.yaml", (out / "ros/left.yaml", out / "ros/right.yaml"))
    ]
    assert [c.metres_per_unit for c in found] == [1e-3, 1e-3, 1.0]
    for path in (out / "calibration.json", out / "opencv.yaml"):
        assert began_ns - 10**9 < (made_ns((path,)) or 0) <= now_ns()
    for calibration in found:
        assert calibration.K_left[0, 0] == pytest.approx(CAMERA.K_left[0, 0], rel=0.03)
        assert calibration.metres_per_unit is not None
        baseline_mm = 1e3 * calibration.metres_per_unit * np.linalg.norm(calibration.T_right_left[:3, 3])
        assert baseline_mm == pytest.approx(5.6, rel=0.03)
    page = (out / "report.html").read_text()
    pictures = sorted(path.name for path in (out / "pictures").iterdir())
    assert len(pictures) == VIEWS + 3 and all(f'src="pictures/{name}"' in page for name in pictures)
    assert "What the views lack" in page
    (of_one,) = re.findall(r"<tr><td>4\.png</td><td>\d+</td>(.*?)</tr>", page)
    told = re.findall(r"<td>(.*?)</td>", of_one)
    assert len(told) == 5 and all(told), "its residuals, and what was found by a calibration made without it"
    assert any("on views held out: reprojection" in line for line in ended.out.splitlines())
    assert "more would make it surer" in ended.err


@pytest.mark.slow
def test_views_that_contradict_the_others_or_show_no_board_are_left_out(suturegrasp, pairs, tmp_path):
    left, right = pairs[2]
    moved = left, np.roll(right, 9, axis=0)
    empty = left, np.full_like(right, 90)
    images = written(tmp_path, [*pairs[:2], moved, *pairs[3:], empty])
    ended = suturegrasp("calibrate", "stereo", *SQUARES, *images, "--output", tmp_path / "out")
    assert ended.status == 0, ended.err
    assert re.search(r"2\.png contradicts the other views by [\d.]+ px and was left out", ended.err)
    assert "7.png: left out, the board was not found in the right image" in ended.out
    assert "6 views: focal lengths" in ended.out
    page = (tmp_path / "out/report.html").read_text()
    assert re.search(r"Left out, for it contradicts the others by [\d.]+ px: 2\.png", page)
    assert "Not used: 7.png: the board was not found in the right image" in page


@pytest.mark.slow
def test_rows_that_stay_apart_on_views_held_out_are_warned_of(suturegrasp, pairs, tmp_path):
    """Each right image was moved by an amount of its own, so that no camera fits them all."""
    shaken = [(left, np.roll(right, (-1) ** k * (1 + k % 2), axis=0)) for k, (left, right) in enumerate(pairs)]
    ended = suturegrasp("calibrate", "stereo", *SQUARES, *written(tmp_path, shaken), "--output", tmp_path / "out")
    assert ended.status == 0, ended.err
    assert "rows are off by more than 0.5 px on views held out; take sharper and more varied views" in ended.err


@pytest.mark.slow
def test_exchanged_eyes_make_no_calibration_and_are_named(suturegrasp, folders, tmp_path):
    _, left, _, right = folders
    ended = suturegrasp("calibrate", "stereo", *SQUARES, "--left", right, "--right", left, "--output", tmp_path / "out")
    assert ended.status == 3
    assert "left and right look exchanged; give them the other way round" in ended.err.splitlines()[-1]
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.slow
def test_a_calibration_is_checked_against_views_in_folders_and_side_by_side(suturegrasp, folders, pairs, tmp_path):
    write_calibration(tmp_path / "right.json", CAMERA)
    (tmp_path / "both").mkdir()
    for k, pair in enumerate(pairs[:3]):
        cv2.imwrite(str(tmp_path / f"both/{k}.png"), np.hstack(pair))
    both = ("--stereo", tmp_path / "both")
    ended = suturegrasp("calibrate", "check", *SQUARES, *folders, "--calibration", tmp_path / "right.json")
    assert (ended.status, ended.err) == (0, "")
    assert "squares are right to 0." in ended.out.splitlines()[-1]
    larger = ("--squares", 8, 6, "--square", 4.2, *MARKER)
    ended = suturegrasp("calibrate", "check", *larger, *both, "--calibration", tmp_path / "right.json")
    assert ended.status == 1 and "squares are off by" in ended.err
    lower = CAMERA.K_right + np.array([[0, 0, 0], [0, 0, 3.0], [0, 0, 0]])
    write_calibration(tmp_path / "lower.json", replace(CAMERA, K_right=lower))
    ended = suturegrasp("calibrate", "check", *SQUARES, *both, "--calibration", tmp_path / "lower.json")
    assert ended.status == 1
    assert re.search(r"rows are [23]\.\d\d px apart", ended.err)


def test_images_that_do_not_pair_up_or_differ_in_size_are_refused(suturegrasp, pairs, tmp_path):
    of_two_sizes = written(tmp_path / "sizes", [pairs[0], tuple(image[::2, ::2] for image in pairs[1])])
    ended = suturegrasp("calibrate", "stereo", *SQUARES, *of_two_sizes, "--output", tmp_path / "out")
    assert ended.status == 2
    assert "different sizes: 640x360 (0.png) and 320x180 (1.png)" in ended.err
    unlike = written(tmp_path / "counts", pairs[:2])
    unlike[3].joinpath("1.png").unlink()
    ended = suturegrasp("calibrate", "stereo", *SQUARES, *unlike, "--output", tmp_path / "other")
    assert ended.status == 2
    assert re.search(r"left holds 2 images and .*right holds 1; give equally many", ended.err)


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
    rows_px, squares = float(told[2]), float(told[-1].rstrip("%")) / 100
    assert rows_px <= 0.25
    assert squares <= 0.01


class Held:
    """A camera before which a board is held still, and then elsewhere."""

    taken_ns = 0, 0

    def __init__(self, pairs):
        self._pairs, self._frame = pairs, 0

    def read(self):
        self._frame += 1
        left, right = self._pairs[self._frame // 8 % len(self._pairs)]
        return cv2.cvtColor(left, cv2.COLOR_GRAY2BGR), cv2.cvtColor(right, cv2.COLOR_GRAY2BGR)

    def close(self):
        pass


@pytest.fixture
def live(suturegrasp, settings, in_threads, tmp_path):
    """Calibrates live, before a source of frames, into the folder `out`."""
    config = tmp_path / "rig.toml"
    config.write_text(f'rig = "test"\n[router]\nendpoint = "{settings.endpoint}"\nstart = false\n')

    def run(source, views):
        camera = Camera(source, CAMERA, CameraConfig(rate_hz=15.0, encoding=ImageEncoding.PNG))
        out = "--output", tmp_path / "out", "--config", config
        with in_threads(settings, camera):
            return suturegrasp("calibrate", "stereo", *SQUARES, "--live", "--views", views, *out)

    return run


@pytest.mark.slow
def test_live_frames_become_a_calibration(live, pairs, tmp_path):
    ended, out = live(Held(pairs), 6), tmp_path / "out"
    assert ended.status == 0, ended.err
    assert len(list((out / "left").iterdir())) == len(list((out / "right").iterdir())) == 6
    assert len({path.read_bytes() for path in (out / "left").iterdir()}) == 6, "each way the board stood once"
    assert any("is kept; " in line for line in ended.out.splitlines())
    assert (out / "calibration.json").exists() and (out / "report.html").exists()


@pytest.mark.slow
def test_live_it_ends_as_soon_as_nothing_is_missing(live, pairs, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "agents.cli.calibrate.views.lacking", lambda seen: [] if len(seen.apparent) == 2 else ["show it elsewhere"]
    )
    ended = live(Held(pairs), 30)
    assert len(list((tmp_path / "out/left").iterdir())) == 2
    assert "view00 is kept; show it elsewhere" in ended.out
    assert "view01 is kept; nothing is missing" in ended.out
    assert (ended.status, "2 views are too few" in ended.err) == (3, True)


class LetGo(Held):
    """A camera whose user presses Ctrl-C when the board has been held in three ways."""

    def read(self):
        if self._frame == 3 * 8:
            os.kill(os.getpid(), signal.SIGINT)
        return super().read()


@pytest.mark.slow
def test_live_ctrl_c_ends_it_with_what_there_is(live, pairs, tmp_path):
    ended = live(LetGo(pairs), 30)
    kept = sorted((tmp_path / "out").glob("*/view*.png"))
    assert ended.status == 3
    assert f"{len(kept) // 2} view" in ended.err.splitlines()[-1] or "no pair shows the board" in ended.err
    assert not (tmp_path / "out/calibration.json").exists()


@pytest.mark.parametrize(
    ("arguments", "status", "sentence"),
    [
        ("stereo", 2, "give --output"),
        ("stereo --output {tmp}/new", 2, "give --left and --right, or --stereo, or --live"),
        ("stereo --output {tmp}", 2, "is not empty"),
        ("stereo --output {tmp}/new --unit ell", 2, "--unit ell is unknown"),
        ("stereo --output {tmp}/new --marker 9", 2, "a marker must be smaller"),
        ("stereo --output {tmp}/new --stereo {tmp}/none", 2, "is no folder"),
        ("stereo --output {tmp}/new --calibration c", 2, "say calibrate check"),
        ("stereo --output {tmp}/new --stereo {tmp}/plain", 3, "no pair shows the board to both eyes"),
        ("stereo --output {tmp}/plain/0.png --stereo {tmp}/plain", 2, "0.png is a file; give a new folder"),
        ("stereo --output {tmp}/new --live --views 4", 2, "--views 4: give 5 or more"),
        ("stereo --output {tmp}/new --dictionary Board", 2, "no dictionary Board"),
        ("check --stereo {tmp}/plain", 2, "give the --calibration"),
        ("check --live", 2, "leave --live and --output out"),
    ],
)
def test_what_cannot_be_carried_out_is_said_in_one_line(suturegrasp, tmp_path, arguments, status, sentence):
    (tmp_path / "plain").mkdir()
    cv2.imwrite(str(tmp_path / "plain/0.png"), np.full((90, 320), 120, np.uint8))
    command, *told = arguments.format(tmp=tmp_path).split()
    ended = suturegrasp("calibrate", command, *SQUARES, *told)
    assert ended.status == status
    assert sentence in ended.err.splitlines()[-1]
