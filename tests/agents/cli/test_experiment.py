"""An experiment as a person meets it: mistakes, what is asked, and that a killed one goes on where it was."""

import contextlib
import dataclasses
import json
import subprocess
import threading

import pytest

from agents.cli.experiment import trial
from agents.cli.experiment.command import JOURNAL, write
from agents.cli.experiment.terminal import Nobody
from agents.cli.experiment.trial import ExperimentError, Rig, declines
from agents.cli.page.trials import trials_of
from agents.experiment.journal import Attempt, Journal, Protocol
from agents.operator.operator import Stood
from agents.robot_bridge.plans import Code
from schemas.messages import CommandAnswer, Outcome
from shared.runtime.config import ConfigError
from shared.runtime.session import free_local_endpoint
from tests.agents.cli.conftest import SCRIPT, refused
from tests.agents.robot_bridge.drive import plan

SPEAKS_AGAINST_A_PLAN = (
    *("rejected_plan", "not_finite", "not_a_pose", "workspace", "unreachable", "remote_centre"),
    *("singular", "tissue", "wrist_flip", "jaw_limit", "too_long"),
)
"""What docs/robot_bridge.md has as reasons to choose another goal, or to see to the planner."""
THREADS = ("easy/paper", "hard/chicken")


def journal_of(folder):
    return Journal.model_validate_json((folder / JOURNAL).read_text())


@pytest.fixture
def tried(tmp_path):
    """The folder of an experiment of which five trials are done."""
    journal = Journal(protocol=Protocol(seed=3, goals=4, threads=THREADS, arm="psm1", verdicts="operator"))
    for each in journal.left(THREADS[0])[:5]:
        journal = journal.begin(each).note(Attempt(trial=each, outcome="held"))
    write(tmp_path, journal)
    return tmp_path


def test_a_journal_is_kept_and_reported_at_any_time(suturegrasp, tried):
    refused(suturegrasp("experiment", tried, "--seed", "4"), "has seed 3, not 4")
    ended = suturegrasp("experiment", tried, "--report")
    assert (ended.status, "11 trials are left" in ended.out) == (3, True)
    assert json.loads((tried / "results.json").read_text())["attempts"][4]["outcome"] == "held"
    assert "easy paper" in (tried / "results.md").read_text()
    (tried / JOURNAL).write_text((tried / JOURNAL).read_text()[:100])
    refused(suturegrasp("experiment", tried), "is no JSON")


def test_without_a_router_nothing_is_begun(suturegrasp, tmp_path, monkeypatch):
    config = tmp_path / "rig.toml"
    config.write_text(f'[router]\nendpoint = "{free_local_endpoint()}"\nstart = false\n[robot.psm1]\n')
    monkeypatch.setattr("agents.cli.experiment.recorded.ROUTER_WAIT_S", 0.2)
    ended = suturegrasp("experiment", tmp_path / "new", "--threads", "easy/paper", "--config", config)
    assert (ended.status, "no router answers" in ended.err) == (3, True)


def test_a_refusal_counts_against_a_trial_only_where_it_speaks_against_the_plan():
    for code in (*Code, "late", "no_answer", "far_deadline", "unknown_id"):
        answer = CommandAnswer("c", Outcome.REFUSED, code, "why")
        assert declines(answer) == (code in SPEAKS_AGAINST_A_PLAN), code
        assert not declines(dataclasses.replace(answer, outcome=Outcome.UNKNOWN))


def test_an_experiment_ends_where_plan_after_plan_is_refused_for_the_moment(tried, monkeypatch):
    """On a machine that is too slow every plan is too old when it is armed."""
    answer = CommandAnswer("c", Outcome.REFUSED, "old_plan", "the plan is from a thread seen 4000 ms ago")
    monkeypatch.setattr(trial, "_plan", lambda *_: plan())
    monkeypatch.setattr(trial, "arm_and_stand_by", lambda *_: Stood(answer, None, ""))
    monkeypatch.setattr(trial, "events_of", lambda *_: contextlib.nullcontext(None))
    monkeypatch.setattr(Nobody, "stuck", lambda *_: None)
    stopped = threading.Event()
    rig = Rig(None, "psm1", Nobody(stopped), False, stopped, lambda: None)  # pyright: ignore[reportArgumentType] - nothing is sent
    left = journal_of(tried).left(THREADS[0])
    with pytest.raises(ExperimentError, match=r"20 times in a row psm1 did not carry a plan out: .*4000 ms ago"):
        trial.carried_out(left[0], len(left), rig)


@pytest.mark.slow
def test_an_experiment_that_was_killed_goes_on_where_it_was_and_ends_where_nobody_answers(tried, rig_file):
    config, before = rig_file("[robot.psm1]"), journal_of(tried)
    command = [SCRIPT, "experiment", str(tried), "--config", str(config), "--no-record"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0) as process:
        assert process.stdout is not None
        said = b""
        while b"Enter goes on" not in said:
            said += (more := process.stdout.read(1000))
            assert more, said
        process.kill()
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert f"nobody answers; to go on: suturegrasp experiment {tried} --config {config}\n" in done.stderr
    after = journal_of(tried)
    assert after.attempts == before.attempts
    assert after.begun == (before.left(THREADS[0])[0], 1)


def test_the_page_walks_through_goals_and_each_verdict_is_in_the_journal(tmp_path):
    told = {"id": "plan-1", "probability": 0.8, "slide_mm": 4.0}
    with pytest.raises(ConfigError, match="suturegrasp experiment"):
        trials_of(tmp_path)
    protocol = Protocol(seed=1, goals=1, threads=("easy/paper",), arm="psm1", verdicts="operator")
    write(tmp_path, Journal(protocol=protocol))
    trials = trials_of(tmp_path)
    assert "0 tried, 2 left" in trials.told()["text"]
    with pytest.raises(RuntimeError, match="no goal of the list was begun"):
        trials.judged(told, True, "", "", None)
    s, policy = trials.begin()
    with pytest.raises(RuntimeError, match="say why it failed"):
        trials.judged(told, False, "", "", None)
    assert "held" in trials.judged(told, True, "", "", 7.5)
    other = trials.begin()
    assert (s, policy) != other
    assert other[0] == s
    trials.judged(told, False, "slipped", "it was wet", None)
    assert "All 2 trials are done" in trials_of(tmp_path).told()["text"]
    with pytest.raises(RuntimeError, match="all trials of this experiment are done"):
        trials.begin()
    assert [(a.outcome, a.cause, a.note, a.execution_s, a.slide_m) for a in journal_of(tmp_path).attempts] == [
        ("held", "", "", 7.5, 4e-3),
        ("failed", "slipped", "it was wet", None, 4e-3),
    ]
