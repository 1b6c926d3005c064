"""`suturegrasp evaluate grasping` with real agents on drawn fields: trials, resuming, recording and refusals."""

import json
from dataclasses import replace

import numpy as np
import pytest

from agents.cli.evaluate import trials
from agents.cli.evaluate.trials import Table, planner_config, rig_for
from agents.cli.main import main
from agents.evaluation.came import Came
from agents.evaluation.protocol import METHODS, Protocol, hand_eye_seed, injected_m, threads_of, trials_on
from agents.evaluation.trial import Told
from schemas.topics import SURFACE, THREAD

SMALL = ("--images", "light", "--config", "easy", "--background", "chicken", "--threads", "1", "--goals", "1")
FEW = (*SMALL, "--methods", "refined", "--policies", "direct")


def status_of(*arguments):
    with pytest.raises(SystemExit) as ended:
        main(["evaluate", "grasping", *map(str, arguments)])
    return ended.value.code


@pytest.mark.slow
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


@pytest.mark.slow
def test_after_a_grasp_the_thread_is_looked_at_again(table, trial):
    told = [output.topic for output in table.look("refined").said]
    assert (told.count(SURFACE), told[-1]) == (1, THREAD), "the planner is told of the tissue first"
    came = table.tried(trial).came
    assert came.said in ("HELD", "MISSED", "UNKNOWN")
    assert 1 <= came.attempts <= 2


def test_the_simulator_is_told_the_errors_of_a_trial_and_who_judges(table, trial, monkeypatch):
    told = {"hand_eye_mm": 1.5, "hand_eye_deg": 1.0, "judge": "contact"}
    monkeypatch.setattr(table, "protocol", table.protocol.model_copy(update=told))
    every = [table._simulated(trial.model_copy(update=one)) for one in ({}, {"goal": 2}, {"policy": "robust"})]
    first = every[0]
    assert (first.tool_error_mm, first.hand_eye_error_mm, first.hand_eye_error_deg) == (0.7, 1.5, 1.0)
    assert (first.physics, first.seed) == ("contact", table.scenery.simulated.seed)
    assert len({one.error_seed for one in every}) == 3, "a tool's error is drawn anew for each trial"
    assert {one.hand_eye_seed for one in every} == {hand_eye_seed(table.protocol, table.laid)}, "and registration's not"
    larger = table._simulated(trial.model_copy(update={"tool_error_mm": 3.0, "method": "paper"}))
    assert (larger.tool_error_mm, larger.error_seed) == (3.0, first.error_seed)


def test_the_planner_is_told_the_sizes_of_errors_and_the_policy_of_its_method(table, trial):
    ours, papers = (
        planner_config(table.protocol, trial.model_copy(update={"method": m})) for m in ("refined", "paper")
    )
    assert (ours.policy_model, papers.policy_model) == ("geometric", "paper")
    sized = trial.model_copy(update={"tool_error_mm": 3.0})
    asked = planner_config(table.protocol.model_copy(update={"hand_eye_mm": 1.2}), sized)
    assert (asked.tool_error_m, asked.hand_eye_error_m) == pytest.approx((3e-3, 1.2e-3))
    assert (asked.attempts, asked.least_probability) == (2, 0.0)
    sections = [rig_for(method).reconstruction for method in METHODS]
    assert [section.method for section in sections if section] == list(METHODS)


@pytest.mark.slow
def test_a_look_finds_the_thread_moved_where_that_is_asked_for(table, trial, monkeypatch):
    moving = table.protocol.model_copy(update={"injected_share": 1.0, "injected_mm": 10.0})
    monkeypatch.setattr(table, "protocol", moving)
    planned_on = []
    came = Came(trial=trial, outcome="declined", code="rejected", sentence="not tried here")
    monkeypatch.setattr(trials, "carried_out", lambda _t, _s, look, *_: planned_on.append(look) or Told(came, []))
    assert table.tried(trial).came.injected_m == pytest.approx(float(np.linalg.norm(injected_m(moving, trial))))
    by = planned_on[0].thread.control_points_camera - table.look("refined").thread.control_points_camera
    np.testing.assert_allclose(by, np.broadcast_to(injected_m(moving, trial), by.shape), atol=1e-12)


def test_a_thread_out_of_reach_and_an_empty_field_are_declined_with_a_reason(table, trial, monkeypatch):
    monkeypatch.setitem(table._looks, "refined", table.look("refined").moved(np.array([0.0, 0.0, 0.3])))
    far = table.tried(trial).came
    assert (far.outcome, far.code) == ("declined", "rejected")
    assert "unreachable" in far.sentence
    grey = np.full_like(table.scenery.images[0], 110)
    monkeypatch.setattr(table, "scenery", replace(table.scenery, images=(grey, grey)))
    monkeypatch.setattr(table, "_looks", {})
    empty = table.tried(trial).came
    assert (empty.outcome, empty.code, empty.sentence != "") == ("declined", "no_thread", True)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ("--jobs 0", "--jobs 0: give 1 or more"),
        ("--goals 0", "goals"),
        ("--tool-error -1", "tool_errors_mm"),
        ("--report", "there is nothing to tell"),
        ("--record easy/chicken/9/0/direct/refined", "is no trial of this evaluation; one is easy/chicken/1/0"),
    ],
)
def test_what_cannot_be_tried_ends_with_one_sentence(tmp_path, capsys, options, sentence):
    assert status_of("--output", tmp_path / "e", *FEW[:6], *options.split(), "--images", "light") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert sentence in line


def test_an_evaluation_with_other_options_needs_another_folder(tmp_path, capsys):
    folder = tmp_path / "e"
    folder.mkdir()
    (folder / "journal.jsonl").write_text("no journal\n")
    assert status_of("--output", folder, *FEW) == 2
    assert "is no journal of an evaluation" in capsys.readouterr().err
