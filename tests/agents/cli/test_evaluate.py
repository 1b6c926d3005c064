"""`suturegrasp evaluate grasping` with real agents on drawn fields: trials, resuming, recording and refusals."""

import json

import numpy as np
import pytest

from agents.cli.evaluate import trials
from agents.cli.evaluate.trials import Table, planner_config
from agents.simulated_trials.look import Came
from agents.simulated_trials.protocol import Protocol, hand_eye_seed, injected_m, threads_of, trials_on
from agents.simulated_trials.trial import Told
from tests.agents.cli.conftest import refused

FIELD = ("--images", "light", "--config", "easy", "--background", "chicken", "--threads", "1")
FEW = (*FIELD, "--goals", "1", "--methods", "refined", "--policies", "direct", "--attempts", "2", "--tissue")


@pytest.mark.slow
def test_a_goal_is_grasped_from_its_image_to_the_lift_and_is_not_tried_twice(suturegrasp, tmp_path):
    to = ("evaluate", "grasping", "--output", tmp_path)
    assert suturegrasp(*to, *FEW).status == 0
    (results,) = json.loads((tmp_path / "results.json").read_text())["results"]
    assert results["rates"]["refined, direct"]["total"]["tried"] == 1
    assert results["durations"]["refined, direct"]["ratio"] > 1
    lines = (tmp_path / "journal.jsonl").read_text().splitlines()
    ended = suturegrasp(*to, *FEW)
    assert (ended.status, "published, direct" in ended.out) == (0, True)
    assert (tmp_path / "journal.jsonl").read_text().splitlines() == lines
    assert json.loads(lines[1])["said"] in ("HELD", "MISSED", "UNKNOWN"), "as another look at the thread tells"
    assert "data:image/jpeg" in (tmp_path / "report.html").read_text()
    ended = suturegrasp(*to, "--record", "easy/chicken/1/0/direct/refined")
    assert (ended.status, json.loads(lines[1])["sentence"] in ended.out) == (0, True)
    assert (tmp_path / "recorded" / "easy_chicken_1_0_direct_refined.mcap").stat().st_size > 100_000


def test_simulator_and_planner_are_told_the_errors_of_a_trial_and_the_thread_is_moved_by_as_much_as_was_asked(
    tmp_path, monkeypatch
):
    told = {"scenarios": ("easy/chicken",), "seed": 1, "threads": 1, "goals": 3, "policies": ("direct",)}
    told |= {"methods": ("refined",), "images": "light", "judge": "geometric", "tool_errors_mm": (0.7,)}
    told |= {"hand_eye_mm": 1.5, "hand_eye_deg": 1.0, "attempts": 2, "injected_share": 1.0, "injected_mm": 10.0}
    protocol = Protocol.model_validate(told)
    table = Table(protocol, threads_of(protocol)[0], tmp_path)
    trial = list(trials_on(table.protocol, table.laid))[1]
    every = [table._simulated(trial.model_copy(update=one)) for one in ({}, {"goal": 2}, {"policy": "robust"})]
    first = every[0]
    assert (first.tool_error_mm, first.hand_eye_error_mm, first.hand_eye_error_deg) == (0.7, 1.5, 1.0)
    assert (first.physics, first.seed) == ("geometric", table.scenery.simulated.seed)
    by_contact = Table(protocol.model_copy(update={"judge": "contact"}), table.laid, tmp_path)
    assert by_contact._simulated(trial).physics == "contact"
    assert len({one.error_seed for one in every}) == 3, "a tool's error is drawn anew for each trial"
    assert {one.hand_eye_seed for one in every} == {hand_eye_seed(table.protocol, table.laid)}, "and registration's not"
    for method, model in (("refined", "geometric"), ("paper", "paper")):
        larger = trial.model_copy(update={"tool_error_mm": 3.0, "method": method})
        assert (table._simulated(larger).tool_error_mm, table._simulated(larger).error_seed) == (3.0, first.error_seed)
        asked = planner_config(table.protocol, larger)
        assert (asked.policy_model, asked.attempts, asked.least_probability) == (model, 2, 0.0)
        assert (asked.tool_error_m, asked.hand_eye_error_m) == pytest.approx((3e-3, 1.5e-3))
    planned_on = []
    came = Came(trial=trial, outcome="declined", code="rejected", sentence="not tried here")
    monkeypatch.setattr(trials, "carried_out", lambda _t, _s, look, *_: planned_on.append(look) or Told(came, []))
    by_m = injected_m(protocol, trial)
    assert table.tried(trial).came.injected_m == pytest.approx(float(np.linalg.norm(by_m)))
    moved = planned_on[0].thread.control_points_camera - table.look("refined").thread.control_points_camera
    np.testing.assert_allclose(moved, np.broadcast_to(by_m, moved.shape), atol=1e-12)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("--jobs 0", "--jobs 0: give 1 or more"),
        ("--goals 0", "goals"),
        ("--tool-error -1", "tool_errors_mm"),
        ("--report", "there is nothing to tell"),
        ("--record easy/chicken/9/0/direct/refined", "is no trial of this evaluation; one is easy/chicken/1/0"),
        ("--output {torn}", "is no journal of an evaluation"),
    ],
)
def test_what_cannot_be_tried_ends_with_one_sentence(suturegrasp, tmp_path, options, told):
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "journal.jsonl").write_text("no journal\n")
    others = options.format(torn=tmp_path / "torn").split()
    output = () if "--output" in others else ("--output", tmp_path / "e")
    refused(suturegrasp("evaluate", "grasping", *output, *FIELD, *others), told)
