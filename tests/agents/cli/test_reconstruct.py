"""`suturegrasp reconstruct`: from images and calibrations in their forms to a thread, its JSON, and its page."""

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

from tests.agents.cli.conftest import REPOSITORY, of_pair, refused

PAGE = (REPOSITORY / "docs" / "reconstruct.md").read_text(encoding="utf-8")


def read_image(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    assert image is not None
    return image


def written(path: Path) -> dict[str, Any]:
    def refuse(constant: str) -> float:
        raise AssertionError(f"{constant} is no JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def along(curve: dict[str, Any], count: int = 1000) -> np.ndarray:
    """Points along a curve, by its knots, control points and degree."""
    spline = BSpline(curve["knots"], np.array(curve["control_points"]), curve["degree"])
    return spline(np.linspace(curve["knots"][0], curve["knots"][-1], count))


def apart(curve: np.ndarray, other: np.ndarray) -> float:
    """The mean distance between two curves, over both directions."""
    return 0.5 * float(np.mean(cKDTree(other).query(curve)[0]) + np.mean(cKDTree(curve).query(other)[0]))


def in_form(document: dict[str, Any]) -> dict[str, Any]:
    """The document without its times, once it is as docs/reconstruct.md promises."""
    timings_ms = document.pop("timings_ms")
    assert set(timings_ms) == {"rectify", "segment", "match", "reconstruct"}
    assert all(ms >= 0 for ms in timings_ms.values())
    assert (timings_ms["segment"] == 0) == (document["segmenter"] == "mask")
    assert (document["reason"] is None) == (document["status"] == "ok")
    assert (document["frame"], document["degree"]) == ("left rectified camera", 3)
    s, value = np.array(document["confidence"]["s"]), np.array(document["confidence"]["value"])
    assert ((s >= 0) & (s <= 1) & (value >= 0) & (value <= 1)).all()
    assert all(0 <= begin <= end <= 1 for begin, end in document["unseen"])
    if document["status"] == "failed":
        assert document["knots"] == document["control_points"] == document["unseen"] == document["crossings"] == []
        assert document["confidence"] == {"s": [], "value": []}
        assert document["posterior"] is document["length"] is None
        return document
    s, covariance = np.array(document["posterior"]["s"]), np.array(document["posterior"]["covariance"])
    np.testing.assert_allclose(s, np.linspace(0, 1, max(100, len(s))), atol=1e-12)
    assert (np.linalg.eigvalsh(covariance) >= -1e-12 * np.abs(covariance).max()).all()
    knots, points, s = document["knots"], document["control_points"], document["confidence"]["s"]
    assert len(knots) == len(points) + 4
    assert len(set(knots[:4])) == len(set(knots[-4:])) == 1
    assert (np.diff(knots) >= 0).all() and (np.diff(s) > 0).all()
    assert (s[0], s[-1]) == (0, 1)
    steps = np.linalg.norm(np.diff(along(document, 5000), axis=0), axis=1)
    assert steps.sum() == pytest.approx(document["length"], rel=1e-4)
    return document


@pytest.fixture
def expected(suturegrasp, small):
    """What the small pair gives with its own files, and in the form that is promised."""
    assert suturegrasp(*of_pair(small), "--output", small / "own.json").status == 0
    return in_form(written(small / "own.json"))


def test_a_thread_is_written_as_the_page_says_and_alike_each_time(suturegrasp, small, expected):
    assert suturegrasp(*of_pair(small), "--output", small / "again.json").status == 0
    assert in_form(written(small / "again.json")) == expected
    assert (expected["status"], expected["unit"]) == ("ok", "mm")
    assert expected["observations"] >= 4
    options = set(re.findall(r"--[a-z0-9-]+", suturegrasp("reconstruct", "--help").out)) - {"--help"}
    nested = (field for part in ("confidence", "camera") for field in expected[part])
    assert len(options) >= 12
    for name in (*options, *expected, *nested):
        assert f"`{name}`" in PAGE, name


def test_the_pages_numpy_example_runs(suturegrasp, small, monkeypatch):
    (small / "out").mkdir()
    assert suturegrasp(*of_pair(small), "--output", small / "out" / "thread.json").status == 0
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    monkeypatch.chdir(small)
    names: dict[str, Any] = {}
    exec(code, names)  # noqa: S102
    steps = np.linalg.norm(np.diff(names["even"], axis=0), axis=1)
    np.testing.assert_allclose(steps, steps.mean(), rtol=0.02)
    assert steps.sum() == pytest.approx(written(small / "out/thread.json")["length"], rel=0.01)
    assert ((names["u"] > 0) & (names["u"] < 320) & (names["v"] > 0) & (names["v"] < 180)).all()
    assert names["confidence"].shape == (50,)


def test_a_failure_is_written_as_promised_with_its_picture_and_recording(suturegrasp, small):
    for name in ("left.png", "right.png"):
        cv2.imwrite(str(small / name), np.full((180, 320, 3), 206, np.uint8))
    shown = ("--picture", small / "out.jpg", "--rrd", small / "out.rrd")
    ended = suturegrasp(*of_pair(small), "--output", small / "out.json", *shown)
    document = in_form(written(small / "out.json"))
    assert document["status"] == "failed"
    refused(ended, document["reason"], status=3)
    assert (small / "out.jpg").stat().st_size > 0
    assert (small / "out.rrd").read_bytes()[:3] == b"RRF"


def test_masks_of_either_form_are_taken_as_they_are(suturegrasp, small):
    masks, found = [small / f"mask_{side}.png" for side in ("left", "right")], []
    whole = [read_image(path)[..., 0] >= 128 for path in masks]
    for white in (np.uint8(255), np.uint16(1)):
        for path, mask in zip(masks, whole, strict=True):
            cv2.imwrite(str(path), mask * white)
        options = ("--left-mask", masks[0], "--right-mask", masks[1], "--output", small / "out.json")
        assert suturegrasp(*of_pair(small), *options).status == 0
        found.append(in_form(written(small / "out.json")))
    assert found[0]["segmenter"] == "mask"
    assert found[0]["control_points"] == found[1]["control_points"]


def test_what_is_doubtful_of_a_calibration_is_warned_of_and_stands_in_the_result(suturegrasp, small):
    path, out = small / "calibration.json", small / "out.json"
    calibration = json.loads(path.read_text())
    told = calibration | {"baseline_mm": 55.0}
    path.write_text(json.dumps(told))
    ended = suturegrasp(*of_pair(small), "--output", out)
    assert (ended.status, ended.complaints) == (0, [])
    assert "warning: The baseline of 55 mm is not one of an endoscope" in ended.err
    assert [judgement["code"] for judgement in written(out)["judgements"]] == ["baseline_implausible"]
    calibration["baseline"] = calibration.pop("baseline_mm")
    path.write_text(json.dumps(calibration))
    assert suturegrasp(*of_pair(small), "--output", out).status == 0
    assert written(out)["unit"] is None
    assert "unit_unknown" in [judgement["code"] for judgement in written(out)["judgements"]]
    assert suturegrasp(*of_pair(small), "--unit", "cm", "--output", out).status == 0
    assert written(out)["unit"] == "cm"


def test_the_shipped_example_comes_near_its_truth(suturegrasp, example, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "thread.json"
    shown = ("--picture", tmp_path / "thread.png", "--rrd", tmp_path / "thread.rrd")
    ended = suturegrasp(*of_pair(example), "--output", out, *shown)
    assert (ended.status, ended.err) == (0, "")
    assert ended.out.count("\n") == 1
    truth = json.loads((example / "truth.json").read_text())
    assert apart(along(written(out)), along(truth)) < 1.5
    assert read_image(tmp_path / "thread.png").shape[1] == 1600
    assert (tmp_path / "thread.rrd").read_bytes()[:3] == b"RRF"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["thread.json", "thread.png", "thread.rrd"]


@pytest.mark.renders
def test_published_pairs_give_their_true_thread_or_one_that_projects_onto_itself(suturegrasp, data, tmp_path):
    folder, out = data / "ucsd_thread/sim", tmp_path / "out.json"
    calibration = ("--calibration", folder / "calibration_scenes_1_3.yaml")
    ended = suturegrasp("reconstruct", "--stereo", folder / "scene_1_1.jpg", *calibration, "--output", out)
    assert (ended.status, ended.complaints) == (0, [])
    assert "units (of unknown size" in ended.out
    control = np.load(folder / "scene_1_1.npy")
    knots = np.concatenate((np.zeros(3), np.linspace(0, 1, len(control) - 2), np.ones(3)))
    truth = along({"knots": knots, "control_points": control, "degree": 3})
    assert apart(along(written(out)), truth) < 0.3
    folder = data / "ucsd_thread/real"
    left, right = (folder / f"thread2_59_{side}.png" for side in ("left", "right"))
    calibration = ("--unit", "mm", "--calibration", folder / "calibration.yaml")
    ended = suturegrasp("reconstruct", "--left", left, "--right", right, *calibration, "--output", out)
    assert (ended.status, ended.complaints) == (0, [])
    document = written(out)
    assert document["unit"] == "mm"
    camera, (x, y, z) = document["camera"], along(document).T
    u, v = camera["fx_px"] * x / z + camera["cx_px"], camera["fy_px"] * y / z + camera["cy_px"]
    thread_px = np.argwhere(read_image(left).min(axis=2) < 250)[:, ::-1]
    assert np.mean(cKDTree(thread_px).query(np.column_stack((u, v)))[0]) < 1.5


@pytest.mark.slow
def test_files_of_any_name_and_images_side_by_side_give_the_same_thread(suturegrasp, small, expected):
    folder = Path(shutil.copytree(small, small.with_name("naht 縫合 (1)")))
    ended = suturegrasp(*of_pair(folder), "--output", folder / "é.json", "--picture", folder / "ü.png")
    assert (ended.status, ended.complaints) == (0, [])
    assert (folder / "ü.png").is_file()
    assert in_form(written(folder / "é.json")) == expected
    cv2.imwrite(str(small / "both.png"), np.hstack([read_image(small / f"{side}.png") for side in ("left", "right")]))
    options = ("--calibration", small / "calibration.json", "--output", small / "out.json")
    assert suturegrasp("reconstruct", "--stereo", small / "both.png", *options).status == 0
    assert in_form(written(small / "out.json")) == expected


@pytest.mark.slow
def test_another_thread_is_told_with_where_to_point_and_pointing_there_means_it(suturegrasp, small):
    height, width = read_image(small / "left.png").shape[:2]
    ends = np.array(((0.1 * width, 0.1 * height), (0.6 * width, 0.2 * height)))
    for name, disparity in (("left.png", 0.0), ("right.png", 0.05 * width)):
        image = read_image(small / name)
        start, end = np.rint(ends - (disparity, 0.0)).astype(int).tolist()
        cv2.line(image, start, end, (40, 120, 30), 4, cv2.LINE_AA)
        cv2.imwrite(str(small / name), image)
    ended = suturegrasp(*of_pair(small), "--output", small / "out.json")
    assert ended.status == 0
    told = re.search(r"1 further thread was seen; choose with --pixel (\d+ \d+) \(score 0\.\d\d\)", ended.out)
    assert told is not None, ended.out
    (other,) = written(small / "out.json")["other_threads"]
    distance = cKDTree(np.linspace(ends[0], ends[1], 500)).query(np.array(other["left_px"]))[0]
    assert np.median(distance) < 1
    assert suturegrasp(*of_pair(small), "--pixel", *told[1].split(), "--output", small / "meant.json").status == 0
    meant = written(small / "meant.json")
    assert meant["score"] == pytest.approx(other["score"], abs=0.1)
    for left in meant["other_threads"]:
        assert np.linalg.norm(np.array(left["left_px"]).mean(axis=0) - ends.mean(axis=0)) > 9


def test_pointing_outside_the_image_or_beside_all_thread_is_refused(suturegrasp, small):
    out = ("--output", small / "out.json")
    for at in ("-1 5", "5 100000", "nan 5"):
        ended = suturegrasp(*of_pair(small), "--pixel", *at.split(), *out)
        refused(ended, f"--pixel {at} lies outside the left image of 320x180 pixels")
    ended = suturegrasp(*of_pair(small), "--pixel", "1", "1", *out)
    refused(ended, "nothing like thread lies within ", " px of (1, 1) in the left image", status=3)
