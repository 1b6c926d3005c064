"""An experiment as a person meets it: mistakes, what is asked, and that a killed one goes on where it was."""

import dataclasses
import json
import subprocess
import sys
import threading

import pytest

from agents.cli.experiment import trial
from agents.cli.experiment.command import JOURNAL, write
from agents.cli.experiment.terminal import Nobody
from agents.cli.experiment.trial import ExperimentError, Rig, declines
from agents.experiment.journal import Attempt, Journal, Protocol
from agents.operator.operator import Stood
from agents.robot_bridge.refusals import Code
from schemas.messages import CommandAnswer, Outcome
from shared.runtime.session import free_local_endpoint
from tests.agents.robot_bridge.drive import plan

SPEAKS_AGAINST_A_PLAN = (
    *("rejected_plan", "not_finite", "not_a_pose", "workspace", "unreachable", "remote_centre"),
    *("singular", "tissue", "wrist_flip", "jaw_limit", "too_long"),
)
"""What docs/robot_bridge.md has as reasons to choose another goal, or to see to the planner."""
THREADS = ("easy/paper", "hard/chicken")


@pytest.fixture
def tried(tmp_path):
    """The folder of an experiment of which five trials are done."""
    protocol = Protocol(seed=3, goals=4, threads=THREADS, arm="psm1", verdicts="operator")
    journal = Journal(protocol=protocol)
    for each in journal.left(THREADS[0])[:5]:
        journal = journal.begin(each).note(Attempt(trial=each, outcome="held"))
    write(tmp_path, journal)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("", "give a folder"),
        ("{new}", "give --threads, each once"),
        ("{new} --threads easy", "--threads easy must read CONFIGURATION/BACKGROUND"),
        ("{new} --threads easy/paper easy/paper", "each once"),
        ("{new} --threads easy/paper --goals 0", "goals = 0"),
        ("{new} --threads easy/paper --arm psm7", "no arm 'psm7'; its arms: psm1"),
        ("{new} --threads easy/chicken --start", "background = 'chicken'"),
        ("{new} --report", "nothing to report"),
        ("{tried} --seed 4", "has seed 3, not 4"),
        ("{torn}", "is no JSON"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_remedy(suturegrasp, tried, tmp_path_factory, arguments, told):
    other = tmp_path_factory.mktemp("other")
    (other / JOURNAL).write_text((tried / JOURNAL).read_text()[:100])
    ended = suturegrasp("experiment", *arguments.format(tried=tried, torn=other, new=other / "new").split())
    assert (ended.status, len(ended.complaints)) == (2, 1)
    assert told in ended.err


def test_a_refusal_counts_against_a_trial_only_where_it_speaks_against_the_plan():
    for code in (*Code, "late", "no_answer", "far_deadline", "unknown_id"):
        refused = CommandAnswer("c", Outcome.REFUSED, code, "why")
        assert declines(refused) == (code in SPEAKS_AGAINST_A_PLAN), code
        assert not declines(dataclasses.replace(refused, outcome=Outcome.UNKNOWN))


def test_an_experiment_ends_where_plan_after_plan_is_refused_for_the_moment(tried, monkeypatch):
    """On a machine that is too slow every plan is too old when it is armed."""
    refused = CommandAnswer("c", Outcome.REFUSED, "old_plan", "the plan is from a thread seen 4000 ms ago")
    monkeypatch.setattr(trial, "_plan", lambda *_: plan())
    monkeypatch.setattr(trial, "arm_and_stand_by", lambda *_: Stood(refused, None, ""))
    monkeypatch.setattr(Nobody, "stuck", lambda *_: None)
    stopped = threading.Event()
    rig = Rig(None, "psm1", Nobody(stopped), False, stopped, lambda: None)  # pyright: ignore[reportArgumentType] - nothing is sent
    left = Journal.model_validate_json((tried / JOURNAL).read_text()).left(THREADS[0])
    with pytest.raises(ExperimentError, match=r"20 times in a row psm1 did not carry a plan out: .*4000 ms ago"):
        trial.carried_out(left[0], len(left), rig)


def test_what_was_tried_so_far_can_be_reported_at_any_time(suturegrasp, tried):
    ended = suturegrasp("experiment", tried, "--report")
    assert ended.status == 3
    assert "11 trials are left" in ended.out
    assert json.loads((tried / "results.json").read_text())["attempts"][4]["outcome"] == "held"
    assert "easy paper" in (tried / "results.md").read_text()


@pytest.mark.slow
def test_an_experiment_that_was_killed_goes_on_where_it_was_and_ends_where_nobody_answers(tried, settings):
    config = tried / "rig.toml"
    router = f'[router]\nendpoint = "{settings.endpoint}"\nstart = false\n'
    config.write_text(f'rig = "{settings.rig}"\n{router}[robot.psm1]\n')
    command = [sys.executable, "-m", "agents.cli", "experiment", str(tried), "--config", str(config), "--no-record"]
    before = Journal.model_validate_json((tried / JOURNAL).read_text())
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0) as process:
        assert process.stdout is not None
        said = b""
        while b"Enter goes on" not in said:
            said += (more := process.stdout.read(1000))
            assert more, said
        process.kill()
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1].endswith(
        f"nobody answers; to go on: suturegrasp experiment {tried} --config {config}"
    )
    after = Journal.model_validate_json((tried / JOURNAL).read_text())
    assert after.attempts == before.attempts
    assert after.begun == (before.left(THREADS[0])[0], 1)


def test_without_a_router_nothing_is_begun(suturegrasp, tmp_path, monkeypatch):
    config = tmp_path / "rig.toml"
    config.write_text(f'[router]\nendpoint = "{free_local_endpoint()}"\nstart = false\n[robot.psm1]\n')
    monkeypatch.setattr("agents.cli.experiment.rig.ROUTER_WAIT_S", 0.2)
    ended = suturegrasp("experiment", tmp_path / "new", "--threads", "easy/paper", "--config", config)
    assert ended.status == 3
    assert "no router answers" in ended.err
