"""From files to a thread in 3D, in the forms that images and calibrations come in, against the truth."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

CURVE_FIELDS = ("knots", "control_points", "confidence", "unseen", "observations")


def read_image(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    assert image is not None
    return image


def result(path: Path) -> dict[str, Any]:
    document = json.loads(path.read_text())
    return {field: document[field] for field in CURVE_FIELDS}


def test_the_shipped_example_comes_near_its_truth(
    suturegrasp, pair, example, tmp_path, mean_error, true_points, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "thread.json"
    shown = ("--picture", tmp_path / "thread.png", "--rrd", tmp_path / "thread.rrd")
    ended = suturegrasp(*pair(example), "--output", out, *shown)
    assert (ended.status, ended.err) == (0, "")
    assert ended.out.count("\n") == 1
    assert mean_error(out, true_points(example)) < 1.5
    assert read_image(tmp_path / "thread.png").shape[1] == 1600
    assert (tmp_path / "thread.rrd").read_bytes()[:3] == b"RRF"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["thread.json", "thread.png", "thread.rrd"]


@pytest.mark.renders
def test_a_published_pair_side_by_side_comes_near_its_truth(suturegrasp, data, tmp_path, mean_error):
    folder = data / "ucsd_thread/sim"
    ended = suturegrasp(
        *("reconstruct", "--stereo", folder / "scene_1_1.jpg"),
        *("--calibration", folder / "calibration_scenes_1_3.yaml", "--output", tmp_path / "out.json"),
    )
    assert (ended.status, ended.complaints) == (0, [])
    assert "units (of unknown size" in ended.out
    control = np.load(folder / "scene_1_1.npy")
    knots = np.concatenate((np.zeros(3), np.linspace(0, 1, len(control) - 2), np.ones(3)))
    assert mean_error(tmp_path / "out.json", BSpline(knots, control, 3)(np.linspace(0, 1, 1000))) < 0.3


@pytest.mark.renders
def test_a_real_pair_gives_a_thread_that_projects_onto_itself(suturegrasp, data, tmp_path):
    folder = data / "ucsd_thread/real"
    left = folder / "thread2_59_left.png"
    ended = suturegrasp(
        *("reconstruct", "--left", left, "--right", folder / "thread2_59_right.png", "--unit", "mm"),
        *("--calibration", folder / "calibration.yaml", "--output", tmp_path / "out.json"),
    )
    assert (ended.status, ended.complaints) == (0, [])
    document = json.loads((tmp_path / "out.json").read_text())
    assert document["unit"] == "mm"
    camera, points = document["camera"], np.array(document["control_points"])
    x, y, z = BSpline(document["knots"], points, 3)(np.linspace(0, 1, 500)).T
    u, v = camera["fx_px"] * x / z + camera["cx_px"], camera["fy_px"] * y / z + camera["cy_px"]
    thread_px = np.argwhere(read_image(left).min(axis=2) < 250)[:, ::-1]
    assert np.mean(cKDTree(thread_px).query(np.column_stack((u, v)))[0]) < 1.5


@pytest.fixture
def expected(suturegrasp, pair, small):
    """What the small pair gives with its own files."""
    assert suturegrasp(*pair(small), "--output", small / "own.json").status == 0
    return result(small / "own.json")


@pytest.mark.slow
def test_calibrations_of_ros_and_of_text_matrices_give_the_same_thread(suturegrasp, small, expected):
    images = ("reconstruct", "--left", small / "left.png", "--right", small / "right.png")
    ros, matrices = small / "ros", small / "matrices"
    for folder in (ros, matrices):
        folder.mkdir()
    for side, shift in (("left", 0.0), ("right", -330.0 * 0.0055)):
        (ros / f"{side}.yaml").write_text(
            "image_width: 320\nimage_height: 180\ncamera_name: narrow\ndistortion_model: plumb_bob\n"
            "camera_matrix: {rows: 3, cols: 3, data: [330, 0, 159.5, 0, 330, 89.5, 0, 0, 1]}\n"
            "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
            "rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n"
            f"projection_matrix: {{rows: 3, cols: 4, data: [330, 0, 159.5, {shift}, 0, 330, 89.5, 0, 0, 0, 1, 0]}}\n"
        )
        (matrices / f"calib.{side}.intrinsics.txt").write_text("330 0 159.5\n0 330 89.5\n0 0 1\n0 0 0 0 0\n")
    (matrices / "calib.l2r.txt").write_text("1 0 0 -5.5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    for calibration in ((ros / "left.yaml", ros / "right.yaml"), (ros,)):
        ended = suturegrasp(*images, "--calibration", *calibration, "--output", small / "ros.json")
        assert (ended.status, ended.complaints) == (0, [])
        metres = result(small / "ros.json")["control_points"]
        np.testing.assert_allclose(1000 * np.array(metres), expected["control_points"], rtol=1e-3, atol=1e-2)
        assert json.loads((small / "ros.json").read_text())["unit"] == "m"
    ended = suturegrasp(*images, "--unit", "mm", "--calibration", matrices, "--output", small / "text.json")
    assert (ended.status, ended.complaints) == (0, [])
    assert result(small / "text.json") == expected


@pytest.mark.slow
def test_files_of_another_form_or_name_give_the_same_thread(suturegrasp, pair, small, expected):
    folder = Path(shutil.copytree(small, small.with_name("naht 縫合 (1)")))
    halves = [read_image(small / f"{side}.png") for side in ("left", "right")]
    for side, image in zip(("left", "right"), halves, strict=True):
        cv2.imwrite(str(folder / f"{side}.png"), image.astype(np.uint16) * np.uint16(257))
    ended = suturegrasp(*pair(folder), "--output", folder / "é.json", "--picture", folder / "ü.png")
    assert (ended.status, ended.complaints) == (0, [])
    assert (folder / "ü.png").is_file()
    assert result(folder / "é.json") == expected
    cv2.imwrite(str(small / "both.png"), np.hstack(halves))
    options = ("--calibration", small / "calibration.json", "--output", small / "out.json")
    assert suturegrasp("reconstruct", "--stereo", small / "both.png", *options).status == 0
    assert result(small / "out.json") == expected


def test_warnings_name_what_is_doubtful_and_stand_in_the_result(suturegrasp, pair, small):
    calibration = json.loads((small / "calibration.json").read_text())
    calibration["baseline_mm"] = 55.0
    (small / "calibration.json").write_text(json.dumps(calibration))
    ended = suturegrasp(*pair(small), "--output", small / "out.json")
    assert (ended.status, ended.complaints) == (0, [])
    assert "warning: The baseline of 55 mm is not one of an endoscope" in ended.err
    judgements = json.loads((small / "out.json").read_text())["judgements"]
    assert [judgement["code"] for judgement in judgements] == ["baseline_implausible"]


@pytest.mark.slow
def test_another_thread_is_told_with_where_to_point_and_pointing_there_means_it(suturegrasp, pair, small):
    height, width = read_image(small / "left.png").shape[:2]
    ends = np.array(((0.1 * width, 0.1 * height), (0.6 * width, 0.2 * height)))
    for name, disparity in (("left.png", 0.0), ("right.png", 0.05 * width)):
        image = read_image(small / name)
        start, end = np.rint(ends - (disparity, 0.0)).astype(int).tolist()
        cv2.line(image, start, end, (40, 120, 30), 4, cv2.LINE_AA)
        cv2.imwrite(str(small / name), image)
    ended = suturegrasp(*pair(small), "--output", small / "out.json")
    assert ended.status == 0
    told = re.search(r"1 further thread was seen; choose with --pixel (\d+ \d+) \(score 0\.\d\d\)", ended.out)
    assert told is not None, ended.out
    (other,) = json.loads((small / "out.json").read_text())["other_threads"]
    distance = cKDTree(np.linspace(ends[0], ends[1], 500)).query(np.array(other["left_px"]))[0]
    assert np.median(distance) < 1
    assert suturegrasp(*pair(small), "--pixel", *told[1].split(), "--output", small / "meant.json").status == 0
    meant = json.loads((small / "meant.json").read_text())
    assert meant["score"] == pytest.approx(other["score"], abs=0.1)
    assert all(
        np.linalg.norm(np.array(left["left_px"]).mean(axis=0) - ends.mean(axis=0)) > 9
        for left in meant["other_threads"]
    )


def test_pointing_outside_the_image_or_beside_all_thread_is_refused(suturegrasp, pair, small):
    for at in ("-1 5", "5 100000", "nan 5"):
        ended = suturegrasp(*pair(small), "--pixel", *at.split(), "--output", small / "out.json")
        assert ended.status == 2
        assert f"--pixel {at} lies outside the left image of " in ended.complaints[0]
    ended = suturegrasp(*pair(small), "--pixel", "1", "1", "--output", small / "out.json")
    assert ended.status == 3
    nothing = r"suturegrasp: nothing like thread lies within \d+ px of \(1, 1\) in the left image"
    assert re.fullmatch(nothing, ended.complaints[0])
