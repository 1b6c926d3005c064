"""The perception benchmark counts what is found, missed and false, and runs on a scene and on thread-free frames."""

import json
import os
import pathlib
import sys

import numpy as np
import pytest

from benchmarks import perception
from benchmarks.centreline_share import shares
from benchmarks.perception_empty import thread_free
from schemas.messages import Centrelines

DATA = pathlib.Path(__file__).parents[2] / "../shared/data"
ONE = np.ones


def line(points):
    count = len(points)
    return Centrelines(points, np.zeros(count, np.int64), 4 * ONE(count), 0.1 * ONE(count))


def straight(first, last, row):
    u = np.arange(first, last)
    return np.column_stack((u, np.full(len(u), float(row))))


TRUTH = np.column_stack((np.linspace(0, 100, 1001), np.full(1001, 50.0)))


def test_places_count_by_pixels_found_within_two_pixels_and_visible():
    visible = TRUTH[:, 0] < 60
    found = shares(line(np.concatenate((straight(0, 40, 51), straight(70, 80, 50)))), TRUTH, visible)
    # the last place that is found lies at 39, within 2 px of 40 and of what lies up to 40.7
    assert found.true == pytest.approx(60, abs=1)
    assert found.found == pytest.approx(41, abs=1)
    assert (found.right, found.given) == (40, 50)
    np.testing.assert_allclose(found.apart_px, 1.0)


def test_the_density_of_the_truth_does_not_weigh():
    crowded = np.sort(np.concatenate((np.linspace(0, 50, 5001), np.linspace(50, 100, 501))))
    truth = np.column_stack((crowded, np.full(len(crowded), 50.0)))
    found = shares(line(straight(0, 50, 50)), truth, ONE(len(truth), bool))
    assert found.found / found.true == pytest.approx(0.5, abs=0.03)


def test_nothing_found_is_no_recall_and_no_precision():
    none = Centrelines(np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    found = shares(none, TRUTH, ONE(len(TRUTH), bool))
    assert (found.found, found.right, found.given) == (0, 0, 0)
    assert found.true == pytest.approx(101, abs=1)


def test_thread_free_frames_differ_and_come_again():
    first, again = list(thread_free(6, 3)), list(thread_free(6, 3))
    assert len(first) == 6
    assert all((a[0] == b[0]).all() and (a[1] == b[1]).all() for a, b in zip(first, again, strict=True))
    assert (first[0][0] != first[1][0]).any()
    # another tissue, not only other noise
    assert (
        np.abs(first[0][0].astype(int) - first[5][0]).mean() > 3 * np.abs(first[0][0].astype(int) - first[1][0]).mean()
    )


def test_one_scene_is_run_with_its_goals(monkeypatch, tmp_path, capsys):
    if not DATA.is_dir() and "CI" not in os.environ:
        pytest.skip("the shared data folder is not beside this checkout")
    options = ["--data", DATA, "--only", "cfg_easy_paper", "--segmenters", "ridge", "--empty", "1"]
    options += ["--json", tmp_path / "figures.json", "--pictures", tmp_path]
    monkeypatch.setattr(sys, "argv", ["perception", *map(str, options)])
    perception.main()
    found = json.loads((tmp_path / "figures.json").read_text())["ridge"]
    (row,) = found["rows"]
    assert row["found"] / row["true"] > 0.9
    assert row["right"] / row["given"] > 0.9
    assert row["times_ms"]["near"] > 0
    assert found["thread-free"]["frames"] == 1
    assert "centreline within 2 px, recall, worst scene" in capsys.readouterr().out
    assert (tmp_path / "ridge cfg_easy_paper.png").is_file()
