"""An evaluation: what it draws, what its journal survives, and what its figures are, against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.simulated_trials.journal import Journal
from agents.simulated_trials.look import Came
from agents.simulated_trials.protocol import Protocol, hand_eye_seed, injected_m, threads_of, tool_seed, trials_on
from agents.simulated_trials.report import as_html, report
from agents.simulated_trials.results import reliability, results_of
from agents.simulated_trials.table import SpeedLimits, falls_at, least_time_s, overview, sweeps
from shared.runtime.config import ConfigError

TOLD = {
    "seed": 1,
    "scenarios": ("easy/paper", "hard/chicken"),
    "threads": 2,
    "goals": 4,
    "images": "light",
    "policies": ("direct", "robust"),
    "methods": ("paper", "refined"),
    "judge": "geometric",
    "tool_errors_mm": (0.7,),
    "hand_eye_mm": 1.5,
    "hand_eye_deg": 1.0,
}


def protocol_with(**others):
    return Protocol.model_validate(TOLD | others)


def all_trials(protocol):
    return [trial for laid in threads_of(protocol) for trial in trials_on(protocol, laid)]


def came_of(trial, outcome, probability=None):
    return Came(trial=trial, outcome=outcome, code="X", sentence="as told", probability=probability)


def test_every_goal_is_tried_with_both_policies_and_methods_under_the_same_errors_for_both_methods():
    protocol = protocol_with(injected_share=0.5, injected_mm=10.0)
    trials = all_trials(protocol)
    assert len({trial.name for trial in trials}) == len(trials) == 2 * 2 * 4 * 2 * 2
    # all scenarios come first
    assert [laid.name for laid in threads_of(protocol)][:2] == ["easy/paper/1", "hard/chicken/1"]
    assert trials[-1].name == "hard/chicken/2/3/robust/refined"
    seeds, of_arm = {}, {}
    for trial in trials:
        place = trial.laid.name, trial.goal, trial.policy
        assert seeds.setdefault(place, tool_seed(protocol, trial)) == tool_seed(protocol, trial)
        of_arm.setdefault(trial.laid.scenario, set()).add(hand_eye_seed(protocol, trial.laid))
    # the tool's are others for each policy, and registration is wrong alike throughout a scenario
    assert len(set(seeds.values())) == len(seeds)
    assert [len(one) for one in of_arm.values()] == [1, 1]
    other = protocol_with(seed=2)
    assert len({*set.union(*of_arm.values()), hand_eye_seed(other, threads_of(other)[0])}) == 3


def test_as_many_threads_are_moved_as_was_asked_for_none_further_and_each_look_anew():
    protocol = protocol_with(goals=200, injected_share=0.1, injected_mm=10.0, methods=("refined",))
    moved = np.array([np.linalg.norm(injected_m(protocol, trial)) for trial in all_trials(protocol)])
    assert 0.05 < (moved > 0).mean() < 0.15
    assert moved.max() <= 0.010
    always = protocol_with(injected_share=1.0, injected_mm=10.0)
    trial = all_trials(always)[0]
    looks = np.array([injected_m(always, trial, look) for look in range(5)])
    assert len(np.unique(looks, axis=0)) == 5
    np.testing.assert_array_equal(looks[0], injected_m(always, trial))


def test_a_journal_goes_on_where_it_was_cut_off(tmp_path):
    protocol, path = protocol_with(), tmp_path / "journal.jsonl"
    first, second, *_ = all_trials(protocol)
    journal = Journal(path, protocol)
    journal.note(came_of(first, "held", probability=0.5))
    journal.note(came_of(second, "failed"))
    path.write_bytes(path.read_bytes()[:-20])
    again = Journal(path, protocol)
    assert [one.trial for one in again.came] == [first]
    assert again.left([first, second]) == [second]
    again.note(came_of(second, "declined"))
    assert [one.outcome for one in Journal(path, None).came] == ["held", "declined"]


def test_a_journal_of_another_protocol_says_what_differs(tmp_path):
    Journal(tmp_path / "j", protocol_with())
    with pytest.raises(ConfigError, match=r"goals 4, not 5; give another folder"):
        Journal(tmp_path / "j", protocol_with(goals=5))
    with pytest.raises(ConfigError, match="nothing to tell"):
        Journal(tmp_path / "none", None)
    (tmp_path / "other").write_text("some other file\n")
    with pytest.raises(ConfigError, match="no journal"):
        Journal(tmp_path / "other", None)


def test_the_least_time_of_a_straight_way_is_its_length_over_the_speed():
    T = np.tile(np.eye(4), (3, 1, 1))
    T[1, 0, 3], T[2, 0, 3] = 0.1, 0.12
    limits = SpeedLimits(speed=0.05, angular_speed=1.0, jaw_speed=2.0, contact_share=0.4)
    jaw = np.array([0.0, 0.0, 1.2])
    assert least_time_s(T, jaw, np.array([False, False, True]), limits) == pytest.approx(2.0 + 0.6 / 0.4)


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=60))
def test_bins_hold_every_trial_once_and_the_score_is_that_of_its_definition(told):
    trial = all_trials(protocol_with())[0]
    found = reliability([came_of(trial, "held" if held else "failed", probability=p) for p, held in told])
    assert found is not None
    promised, held = np.array([p for p, _ in told]), np.array([h for _, h in told], float)
    assert sum(b.trials for b in found.bins) == len(told)
    assert found.brier == pytest.approx(np.mean((promised - held) ** 2))
    assert sum(b.trials * b.off for b in found.bins) == pytest.approx(np.sum(held - promised), abs=1e-9)
    assert found.base == pytest.approx(held.mean() * (1 - held.mean()))
    assert reliability([came_of(trial, "declined")]) is None


def test_promises_that_hold_have_skill_and_the_base_rate_has_none():
    trial = all_trials(protocol_with())[0]
    for promises, skill in (((1.0, 0.0), 1.0), ((0.5, 0.5), 0.0)):
        came = [came_of(trial, *one) for one in zip(("held", "failed"), promises, strict=True)]
        assert getattr(reliability(came), "skill", None) == skill


def test_where_a_curve_falls_to_a_share_lies_on_the_line_between_two_sizes():
    assert falls_at([(0.0, 1.0), (1.0, 1.0), (2.0, 0.9)], 0.95) == pytest.approx(1.5)
    assert falls_at([(0.0, 1.0), (1.0, 0.99)], 0.95) is None
    assert falls_at([(0.0, 0.9), (1.0, 0.8)], 0.95) is None


def test_the_page_tells_rates_pairs_and_what_was_declined_and_its_html_escapes():
    protocol = protocol_with(tool_errors_mm=(0.5, 1.0), methods=("refined",))
    outcomes = {(0, "direct"): "declined", (0, "robust"): "declined", (1, "direct"): "failed"}
    told = {"code": "<b>", "probability": 0.9, "took_s": 4.0, "least_s": 2.0}
    came = [
        came_of(trial, outcomes.get((trial.goal, trial.policy), "held")).model_copy(update=told)
        for trial in all_trials(protocol)
    ]
    every = [results_of(protocol, came, error) for error in protocol.tool_errors_mm]
    whole = results_of(protocol, came)
    direct, robust = every[0].rates.values()
    assert (direct[-1].held, direct[-1].tried, direct[-1].declined) == (8, 12, 4)
    assert (robust[-1].held, robust[-1].tried) == (12, 12)
    (compared,) = every[0].compared
    assert compared.pairs == (8, 0, 4, 0)
    assert compared.difference == pytest.approx(1 / 3)
    assert [sweep.falls_at_mm for sweep in sweeps(every)] == [None, None]
    text = overview(protocol, every, whole)
    assert "| refined, direct | 66.7 % (4/6) | 66.7 % (4/6) | 66.7 % (8/12) |" in text
    assert "| published, robust | 100 % | 100 % | 97 % | - |" in text
    assert "were they failures, 50.0 % held" in text
    html = report(protocol, came, every, whole, [])
    assert "<b>" not in html
    assert as_html("# a\n- `2`") == "<h1>a</h1>\n<ul><li><code>2</code></ul>"
