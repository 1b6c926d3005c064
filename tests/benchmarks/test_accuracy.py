"""The accuracy benchmark runs on a data folder of each kind, and says what it should."""

import json
import os
import pathlib
import sys

import pytest

from benchmarks import accuracy
from benchmarks.scenes import scenes

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
    names = [name for name, _ in scenes(data)]
    assert len([name for name in names if name.startswith("ucsd sim")]) == len(list(data.glob("ucsd_thread/sim/*.npy")))
    assert len([name for name in names if name.startswith("ucsd real")]) == 6
    assert len([name for name in names if name.startswith("renders")]) == len(list(data.glob("renders/*.json")))
    assert len(names) == len(set(names))


def test_one_scene_is_run_with_and_without_masks_beside_its_published_figures(data, monkeypatch, tmp_path, capsys):
    run(monkeypatch, "--data", data, "--only", "sim 3_4", "--json", tmp_path / "figures.json")
    rows = json.loads((tmp_path / "figures.json").read_text())["rows"]
    assert [row["masks"] for row in rows] == ["none", "grey<200"]
    assert all(row["status"] == "ok" and 0 < row["mean"] <= row["95 %"] <= row["max"] <= row["frechet"] for row in rows)
    assert rows[0]["published"] == {"2023 mean": 0.0646, "2025 mean": 0.0547}
    assert "median" in capsys.readouterr().out


def test_a_real_pair_has_reprojection_and_no_curve_error(data, monkeypatch, tmp_path):
    run(monkeypatch, "--data", data, "--only", "thread2_116", "--json", tmp_path / "figures.json")
    rows = json.loads((tmp_path / "figures.json").read_text())["rows"]
    assert [row["status"] for row in rows] == ["ok", "ok"]
    assert all(row["mean"] is None and row["left to mask"] > 0 for row in rows)


def test_a_change_against_the_baseline_is_printed(capsys):
    row = {"group": "g", "scene": "s", "masks": "none", "status": "ok", "mean": 0.1}
    accuracy.compare([row], [row | {"mean": 0.105}])
    assert capsys.readouterr().out == ""
    accuracy.compare([row], [row | {"mean": 0.2}])
    accuracy.compare([row], [row | {"status": "failed", "mean": None}])
    assert capsys.readouterr().out.count("changed") == 2


def test_no_scene_of_that_name_is_a_usage_error(data, monkeypatch, capsys):
    with pytest.raises(SystemExit) as stopped:
        run(monkeypatch, "--data", data, "--only", "nothing of that name")
    assert stopped.value.code == 2
    assert "no scene under" in capsys.readouterr().err
