"""The accuracy benchmark runs on a data folder of each kind, and says what it should."""

import json
import os
import pathlib
import sys

import pytest

from benchmarks import accuracy
from benchmarks.board import LINES
from benchmarks.scenes import scenes
from benchmarks.tables import compare

DATA = pathlib.Path(__file__).parents[2] / "../shared/data"


@pytest.fixture
def data():
    if not DATA.is_dir() and "CI" not in os.environ:
        pytest.skip("the shared data folder is not beside this checkout")
    assert DATA.is_dir(), "CI needs the shared data folder beside the checkout"
    return DATA


def run(monkeypatch, *options):
    monkeypatch.setattr(sys, "argv", ["accuracy", *map(str, options)])
    accuracy.main()


def test_every_scene_of_the_data_folder_is_listed(data):
    found = list(scenes(data))
    groups = [group for _, group, _ in found]
    assert groups.count("ucsd sim") == len(list(data.glob("ucsd_thread/sim/*.npy")))
    assert groups.count("ucsd real") == 6
    renders = [groups.count(kind + " render") for kind in ("clear", "crossing", "occlusion", "hidden")]
    assert sum(renders[:3]) == len(list(data.glob("renders/*.json")))
    assert renders[3] == 20
    assert groups.count("board") == 2 * len(LINES)
    assert len(found) == len({name for name, _, _ in found})


def test_one_scene_is_run_with_and_without_masks_beside_its_published_figures(data, monkeypatch, tmp_path, capsys):
    run(monkeypatch, "--data", data, "--only", "sim 3_4", "--json", tmp_path / "figures.json")
    rows = json.loads((tmp_path / "figures.json").read_text())["rows"]
    assert [row["masks"] for row in rows] == ["none", "grey<200"]
    assert all(row["status"] == "ok" and 0 < row["mean"] <= row["95 %"] <= row["max"] <= row["frechet"] for row in rows)
    assert rows[0]["published"] == {"2023 mean": 0.0646, "2025 mean": 0.0547}
    printed = capsys.readouterr().out
    assert "mean error, median / worst" in printed
    assert "not met" in printed


def test_a_real_pair_has_reprojection_and_no_curve_error(data, monkeypatch, tmp_path):
    run(monkeypatch, "--data", data, "--only", "thread2_116", "--json", tmp_path / "figures.json")
    rows = json.loads((tmp_path / "figures.json").read_text())["rows"]
    assert [row["status"] for row in rows] == ["ok", "ok"]
    assert all(row["mean"] is None and row["left to mask"] > 0 for row in rows)


def test_hidden_scenes_are_the_same_each_time(data):
    first, again = (
        next(load() for name, _, load in scenes(data) if name == "hidden render sample_04_0") for _ in range(2)
    )
    assert all((a == b).all() for a, b in zip(first.images, again.images, strict=True))
    assert first.visible is not None
    assert 0.3 < 1 - first.visible[:, 0].mean() < 0.46


def test_an_edge_of_the_board_is_judged_by_its_straightness_and_length(data, monkeypatch, tmp_path):
    run(monkeypatch, "--data", data, "--only", "board 1 column 8", "--json", tmp_path / "figures.json")
    (row,) = json.loads((tmp_path / "figures.json").read_text())["rows"]
    assert (row["status"], row["masks"], row["parallel"]) == ("ok", "edge", False)
    assert 0 < row["straightness"] < 1
    assert abs(row["corners share"]) < 0.02


def test_a_change_against_the_baseline_is_printed(capsys):
    row = {"group": "g", "scene": "s", "masks": "none", "calibration": "", "status": "ok", "mean": 0.1}
    compare([row], [row | {"mean": 0.105}])
    assert capsys.readouterr().out == ""
    compare([row], [row | {"mean": 0.2}])
    compare([row], [row | {"status": "failed", "mean": None}])
    assert capsys.readouterr().out.count("changed") == 2


def test_no_scene_of_that_name_is_a_usage_error(data, monkeypatch, capsys):
    with pytest.raises(SystemExit) as stopped:
        run(monkeypatch, "--data", data, "--only", "nothing of that name")
    assert stopped.value.code == 2
    assert "no scene under" in capsys.readouterr().err
