"""The list of an experiment as the page walks through it."""

import pytest

from agents.cli.experiment.command import JOURNAL
from agents.cli.page.trials import trials_of
from agents.experiment.journal import Journal, Protocol
from shared.runtime.config import ConfigError, parse_config

PLAN = {"id": "plan-1", "probability": 0.8, "slide_mm": 4.0}


@pytest.fixture
def folder(tmp_path):
    protocol = Protocol(seed=1, goals=1, threads=("easy/paper",), arm="psm1", verdicts="operator")
    (tmp_path / JOURNAL).write_text(Journal(protocol=protocol).model_dump_json())
    return tmp_path


def test_goals_are_walked_through_and_each_verdict_is_in_the_journal(folder):
    trials = trials_of(folder)
    assert "0 tried, 2 left" in trials.told()["text"]
    s, policy = trials.begin()
    assert "held" in trials.judged(PLAN, True, "", "", 7.5)
    other = trials.begin()
    assert (s, policy) != other
    assert other[0] == s
    trials.judged(PLAN, False, "slipped", "it was wet", None)
    assert "All 2 trials are done" in trials_of(folder).told()["text"]
    journal = parse_config((folder / JOURNAL).read_text(), Journal, "journal.json")
    assert [(a.outcome, a.cause, a.note, a.execution_s) for a in journal.attempts] == [
        ("held", "", "", 7.5),
        ("failed", "slipped", "it was wet", None),
    ]


def test_nothing_is_judged_that_was_not_begun_and_no_failure_without_a_cause(folder):
    trials = trials_of(folder)
    with pytest.raises(RuntimeError, match="no goal of the list was begun"):
        trials.judged(PLAN, True, "", "", None)
    trials.begin()
    with pytest.raises(RuntimeError, match="say why it failed"):
        trials.judged(PLAN, False, "", "", None)


def test_a_folder_without_a_journal_is_refused_with_what_to_do(tmp_path):
    with pytest.raises(ConfigError, match="suturegrasp experiment"):
        trials_of(tmp_path)
