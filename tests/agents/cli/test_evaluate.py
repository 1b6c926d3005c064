"""`suturegrasp evaluate grasping` with real agents on drawn fields: trials, resuming, recording and refusals."""

import json
from dataclasses import replace

import numpy as np
import pytest

from agents.cli.evaluate.scenes import first_state
from agents.cli.evaluate.trials import Table
from agents.cli.main import main
from agents.evaluation.protocol import Protocol, threads_of, trials_on
from schemas.messages import RobotMode, RobotState
from schemas.topics import SURFACE, THREAD

SMALL = ("--images", "light", "--config", "easy", "--background", "chicken", "--threads", "1", "--goals", "1")
FEW = (*SMALL, "--methods", "refined", "--policies", "direct")


def status_of(*arguments):
    with pytest.raises(SystemExit) as ended:
        main(["evaluate", "grasping", *map(str, arguments)])
    return ended.value.code


def test_a_goal_is_grasped_from_its_image_to_the_lift_and_is_not_tried_twice(tmp_path, capsys):
    folder = tmp_path / "e"
    assert status_of("--output", folder, *FEW) == 0
    told = json.loads((folder / "results.json").read_text())
    (results,) = told["results"]
    assert results["rates"]["refined, direct"]["total"]["tried"] == 1
    assert results["durations"]["refined, direct"]["ratio"] > 1
    lines = (folder / "journal.jsonl").read_text().splitlines()
    assert status_of("--output", folder, *FEW) == 0
    assert (folder / "journal.jsonl").read_text().splitlines() == lines
    assert "published, direct" in capsys.readouterr().out
    assert "data:image/jpeg" in (folder / "report.html").read_text()
    assert status_of("--output", folder, "--record", "easy/chicken/1/0/direct/refined") == 0
    assert (folder / "recorded" / "easy_chicken_1_0_direct_refined.mcap").stat().st_size > 100_000
    assert json.loads(lines[1])["sentence"] in capsys.readouterr().out


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """One thread on a field, goals on which may be tried twice."""
    told = {"scenarios": ("easy/chicken",), "seed": 1, "threads": 1, "goals": 3, "policies": ("direct",)}
    told |= {"methods": ("refined",), "images": "light", "judge": "geometric", "tool_errors_mm": (0.7,)}
    protocol = Protocol.model_validate(told | {"hand_eye_mm": 0, "hand_eye_deg": 0, "attempts": 2, "tissue": True})
    return Table(protocol, threads_of(protocol)[0], tmp_path_factory.mktemp("evaluated"))


@pytest.fixture
def trial(table):
    return list(trials_on(table.protocol, table.laid))[1]


def test_the_planner_is_told_of_the_tissue_where_that_is_asked_for(table):
    told = [output.topic for output in table.look("refined").said]
    assert told.count(SURFACE) == 1
    assert told[-1] is THREAD


def test_after_a_grasp_the_thread_is_looked_at_again(table, trial):
    came = table.tried(trial).came
    assert came.said in ("HELD", "MISSED", "UNKNOWN")
    assert 1 <= came.attempts <= 2


def test_looks_after_a_grasp_show_the_instrument_where_that_is_asked_for(table, trial, monkeypatch):
    shown = []
    monkeypatch.setattr(table, "protocol", table.protocol.model_copy(update={"instrument": True}))
    monkeypatch.setattr(table, "_seen", lambda images, *_: shown.append(images[0]) or table.look("refined"))
    state = first_state(table.scenery.simulated, table.scenery.field)
    T_camera_tool = np.diag([-1.0, -1.0, 1.0, 1.0])
    T_camera_tool[:3, 3] = state.control_points_camera.mean(axis=0)
    told = (np.zeros(6), 0.0, np.eye(4), "")
    arm = RobotState("psm1", 0, RobotMode.IDLE, T_camera_tool, *told)
    table._again(trial)(state, arm, 0)
    differs = np.abs(shown[0].astype(int) - table.view.pair(state, 1)[0]).max(axis=2) > 25
    assert differs.sum() > 1000, "pixels of an instrument of 8 mm"


def test_a_thread_out_of_reach_is_declined_with_a_reason(table, trial, monkeypatch):
    monkeypatch.setitem(table._looks, "refined", table.look("refined").moved(np.array([0.0, 0.0, 0.3])))
    came = table.tried(trial).came
    assert (came.outcome, came.code) == ("declined", "rejected")
    assert "unreachable" in came.sentence


def test_an_empty_field_is_declined_with_a_reason(table, trial, monkeypatch):
    grey = np.full_like(table.scenery.images[0], 110)
    monkeypatch.setattr(table, "scenery", replace(table.scenery, images=(grey, grey)))
    monkeypatch.setattr(table, "_looks", {})
    came = table.tried(trial).came
    assert (came.outcome, came.code) == ("declined", "no_thread")
    assert came.sentence


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--jobs", "0"), "--jobs 0: give 1 or more"),
        (("--goals", "0"), "goals"),
        (("--tool-error", "-1"), "tool_errors_mm"),
        (("--report",), "there is nothing to tell"),
        (("--record", "easy/chicken/9/0/direct/refined"), "is no trial of this evaluation; one is easy/chicken/1/0"),
    ],
)
def test_what_cannot_be_tried_ends_with_one_sentence(tmp_path, capsys, options, sentence):
    assert status_of("--output", tmp_path / "e", *FEW[:6], *options, "--images", "light") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert sentence in line


def test_an_evaluation_with_other_options_needs_another_folder(tmp_path, capsys):
    folder = tmp_path / "e"
    folder.mkdir()
    (folder / "journal.jsonl").write_text("no journal\n")
    assert status_of("--output", folder, *FEW) == 2
    assert "is no journal of an evaluation" in capsys.readouterr().err
