"""Where to capture, against brute force."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planner.policy import (
    BETTER_ELSEWHERE,
    Against,
    alternatives,
    candidates,
    capture_probability,
    counted_reasons,
    first_against,
    grasp_probability,
    least_on_the_way,
    most_likely,
)

SHARE = st.floats(0, 1)
SHARES = st.lists(SHARE, min_size=2, max_size=30).map(np.array)


@given(SHARE, st.integers(2, 100))
def test_candidates_are_evenly_spaced_but_for_the_one_moved_onto_the_goal(s_goal, count):
    s, goal = candidates(s_goal, count)
    assert s[goal] == s_goal
    assert len(s) == count
    assert (np.diff(s) > 0).all()
    np.testing.assert_array_equal(np.delete(s, goal), np.delete(np.linspace(0, 1, count), goal))
    assert abs(s_goal - goal / (count - 1)) <= 0.5 / (count - 1) + 1e-12


@given(SHARES, st.data())
def test_the_capture_is_the_best_of_all_by_brute_force(captured, data):
    n = len(captured)
    goal = data.draw(st.integers(0, n - 1))
    allowed = np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    best, best_p = None, -1.0
    for i in range(n):
        p = captured[i]
        for _ in range(abs(i - goal)):
            p *= 0.99
        if allowed[i] and p > best_p * (1 + 1e-12):
            best, best_p = i, p
    chosen = most_likely(grasp_probability(captured, goal, 0.99), allowed, goal)
    if best is None:
        assert chosen is None
    else:
        assert chosen is not None
        assert grasp_probability(captured, goal, 0.99)[chosen] == pytest.approx(best_p, rel=1e-9)


@given(SHARES, st.data())
def test_the_least_on_the_way_is_that_of_the_samples_between(captured, data):
    goal = data.draw(st.integers(0, len(captured) - 1))
    expected = [captured[min(i, goal) : max(i, goal) + 1].min() for i in range(len(captured))]
    np.testing.assert_array_equal(least_on_the_way(captured, goal), expected)


def test_of_equals_the_nearest_to_the_goal_is_taken():
    every = np.ones(9, bool)
    assert most_likely(np.zeros(9), every, 6) == 6
    assert most_likely(np.array([1.0, 0, 0, 0, 0, 0, 0, 1, 0]), every, 6) == 7
    assert most_likely(np.zeros(9), ~every, 6) is None


def test_confidence_is_interpolated_along_the_thread_and_none_means_no_trust(bench):
    thread = bench.straight(confidence=[0.0, 1.0, 0.5])
    np.testing.assert_allclose(capture_probability(thread, np.array([0, 0.25, 0.5, 0.75, 1])), [0, 0.5, 1, 0.75, 0.5])
    shuffled = dataclasses.replace(thread, confidence_s=np.array([1, 0.0, 0.5]), confidence=np.array([0.5, 0, 1.0]))
    assert capture_probability(shuffled, np.array([0.75]))[0] == pytest.approx(0.75)
    silent = dataclasses.replace(thread, confidence_s=np.zeros(0), confidence=np.zeros(0))
    assert capture_probability(silent, np.array([0.5]))[0] == 0


def test_the_first_reason_that_applies_is_given_and_reasons_are_counted():
    n = 6
    found = {reason: np.zeros(n, bool) for reason in Against}
    found[Against.UNREACHABLE][:5] = True
    found[Against.UNSEEN][3:] = True
    codes = first_against(found)
    assert counted_reasons(codes) == "3 unseen, 3 unreachable"
    found[Against.UNSEEN][3] = False
    assert counted_reasons(first_against(found)) == "4 unreachable, 2 unseen"
    assert counted_reasons(np.full(n, -1)) == ""


@settings(max_examples=15)
@given(st.lists(SHARE, min_size=100, max_size=100).map(np.array), st.integers(0, 7), st.integers(0, 99))
def test_alternatives_are_other_places_the_likeliest_first_apart_from_each_other(probability, count, chosen):
    s = np.linspace(0, 1, 100)
    against = np.where(np.arange(100) % 3 == 0, list(Against).index(Against.UNSEEN), -1)
    found = alternatives(s, probability, against, 50, chosen, count)
    assert len(found) == count
    likelihoods = [a.probability for a in found]
    assert likelihoods == sorted(likelihoods, reverse=True)
    places = [round(a.s_capture * 99) for a in found]
    assert chosen not in places
    for i, a in zip(places, found, strict=True):
        assert a.probability == probability[i]
        assert a.reason == ("unseen" if i % 3 == 0 else BETTER_ELSEWHERE)
    for i, place in enumerate(places):
        assert all(abs(place - other) >= 100 // (2 * count) for other in (*places[:i], chosen))
