"""The order of trials, what a journal has left, and what its attempts come to."""

import json
from collections import Counter

import pytest

from agents.experiment.journal import Attempt, Journal, Protocol, order
from agents.experiment.results import document, results_of
from agents.experiment.table import page
from shared.published_rates import published_rate

PROTOCOL = Protocol(seed=7, goals=20, threads=("hard/chicken", "easy/paper"), arm="psm1", verdicts="operator")


def all_tried(outcome_of):
    journal = Journal(protocol=PROTOCOL)
    for thread in PROTOCOL.threads:
        for trial in order(PROTOCOL, thread):
            outcome = outcome_of(trial)
            cause = "missed" if outcome == "failed" else ""
            attempt = Attempt(trial=trial, outcome=outcome, cause=cause, execution_s=8.0)
            journal = journal.begin(trial).note(attempt)
    return journal


def test_each_goal_is_tried_with_both_policies_one_after_the_other_in_the_order_of_the_seed_and_the_thread():
    trials = order(PROTOCOL, "easy/paper")
    pairs = list(zip(trials[::2], trials[1::2], strict=True))
    assert all(first.goal == second.goal for first, second in pairs)
    assert {(first.policy, second.policy) for first, second in pairs} == {("direct", "robust"), ("robust", "direct")}
    assert sorted({trial.s for trial in trials}) == pytest.approx([(i + 0.5) / 20 for i in range(20)])
    assert order(PROTOCOL, "easy/paper") == trials
    others = order(PROTOCOL, "hard/chicken"), order(PROTOCOL.model_copy(update={"seed": 8}), "easy/paper")
    assert len({tuple(trial.goal for trial in one) for one in (trials, *others)}) == 3


def test_a_journal_that_was_written_goes_on_where_it_was():
    journal = Journal(protocol=PROTOCOL)
    for trial in journal.left("easy/paper")[:7]:
        journal = journal.begin(trial).note(Attempt(trial=trial, outcome="held"))
    following = journal.left("easy/paper")[0]
    read = Journal.model_validate_json(journal.begin(following).model_dump_json())
    assert read.left("easy/paper") == order(PROTOCOL, "easy/paper")[7:]
    again = read.begin(following).begin(following).note(Attempt(trial=following, outcome="held"))
    assert [attempt.repeats for attempt in again.attempts] == [0] * 7 + [2]
    assert again.begun is None


def test_the_rates_are_counts_of_what_was_tried():
    def outcome(trial):
        if trial.thread == "hard/chicken" and trial.policy == "direct":
            return "failed" if trial.goal < 4 else "declined" if trial.goal == 19 else "held"
        return "failed" if (trial.policy, trial.goal) == ("robust", 10) else "held"

    results = results_of(all_tried(outcome))
    assert results.kinds == (("hard", "chicken"), ("easy", "paper"))
    assert [(r.held, r.tried, r.declined) for r in results.rates["direct"]] == [(15, 19, 1), (20, 20, 0), (35, 39, 1)]
    assert [(r.held, r.tried) for r in results.rates["robust"]] == [(19, 20), (19, 20), (38, 40)]
    assert results.pairs == (33, 2, 4, 0)
    assert results.p_value == pytest.approx(2 * (1 + 6 + 15) / 2**6)
    assert results.difference == pytest.approx(38 / 40 - 35 / 39)
    assert "1 with direct and 0 with robust. Were they failures: 87.5 % (35/40) with direct" in page(results)
    assert results.causes == {"direct": {"missed": 4}, "robust": {"missed": 2}}


def test_the_page_has_the_papers_rows_and_the_document_every_attempt():
    journal = all_tried(lambda _: "held")
    results = results_of(journal)
    text = page(results)
    assert "| policy | hard chicken | easy paper | total | 95 % |" in text
    assert "| direct, published | 71.4 % | 95.2 % | 90.5 % | - |" in text
    assert "the policies never differed" in text
    told = json.loads(json.dumps(document(journal, results)))
    assert Counter(a["trial"]["policy"] for a in told["attempts"]) == {"direct": 40, "robust": 40}
    assert told["rates"]["robust"]["hard/chicken"]["published_percent"] == 100.0
    assert published_rate("robust", "easy", "plain") is None
