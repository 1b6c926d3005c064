"""How likely grasps succeed, and which is taken: against Monte Carlo, draw by draw, and by brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planner.chances import Swept, keep_probability, spread
from agents.planner.config import PlannerConfig
from agents.planner.policy import BETTER_ELSEWHERE, Against, alternatives, grasp_probability, most_likely
from agents.planner.wedge import wedge_probability, within_wedge
from shared.kinematics.psm import FINGER_M

MM, DRAWS, SAMPLES = 1e-3, 72, 7
SHARE = st.floats(0, 1)


@pytest.mark.parametrize("case", range(5))
def test_lying_between_the_fingers_is_as_likely_as_a_monte_carlo_says(case):
    rng = np.random.default_rng(case)
    mean = np.array([rng.normal(0, 2), rng.uniform(2, 11)]) * MM
    root = rng.normal(size=(2, 2)) * 10 ** rng.uniform(-2, 0.7) * MM
    covariance = root @ root.T + (0.3 * MM) ** 2 * np.eye(2)
    opening, give = rng.uniform(0.2, 1.4), rng.choice([0.0, 1.0]) * MM
    drawn = rng.multivariate_normal(mean, covariance, 100_000)
    share = within_wedge(drawn[:, 0], drawn[:, 1], opening, give).mean()
    assert wedge_probability(mean, covariance, opening, give) == pytest.approx(share, abs=0.006)
    for certain_mm, expected in ((7.0, 1), (1e3 * FINGER_M + 1.0, 0)):
        assert wedge_probability(np.array([0.0, certain_mm]) * MM, np.zeros((2, 2)), 0.7) == pytest.approx(expected)


@settings(max_examples=12)
@given(seed=st.integers(0, 999), goal=st.integers(0, SAMPLES - 1), depth_mm=st.sampled_from((2.0, 5.1)))
def test_the_share_that_is_kept_on_a_slide_is_counted_draw_by_draw(seed, goal, depth_mm):
    rng = np.random.default_rng(seed)
    R = np.linalg.qr(rng.normal(size=(2, SAMPLES, 3, 3)))[0]
    errors, setback_m = (
        rng.normal(scale=2 * MM, size=(DRAWS, SAMPLES, 3)),
        PlannerConfig(depth_m=depth_mm * MM).setback_m,
    )
    swept = Swept(spread(errors, R), setback_m, goal)
    found = keep_probability(swept.captured(1.0), swept.kept(0.5, 0.7 * MM), goal)
    for way in range(2):
        y, z = np.einsum("mnj,njk->knm", errors, R[way, :, :, 1:])
        caught, held = within_wedge(y, z + setback_m, 1.0), within_wedge(y, z + setback_m, 0.5, 0.7 * MM)
        for i in range(SAMPLES):
            on_the_way = held[min(i, goal) : max(i, goal) + 1].all(axis=0)
            share = (caught[i] & on_the_way).sum() / max(caught[i].sum(), 1)
            assert found[way, i] == (1 if i == goal else share)


@given(st.lists(st.tuples(SHARE, st.booleans()), min_size=2, max_size=30), st.integers(0, 29))
def test_the_capture_is_the_best_of_all_that_are_allowed_and_of_equals_the_nearest_to_the_goal(drawn, goal):
    captured, allowed = (np.array(each) for each in zip(*drawn, strict=True))
    goal = min(goal, len(captured) - 1)
    likely = [captured[i] * 0.99 ** abs(i - goal) for i in range(len(captured))]
    chosen = most_likely(grasp_probability(captured, goal, 0.99), allowed, goal)
    if not allowed.any():
        assert chosen is None
    else:
        assert chosen is not None
        assert likely[chosen] == pytest.approx(max(p for p, free in zip(likely, allowed, strict=True) if free))
    places = np.flatnonzero(allowed)
    nearest = min(places, key=lambda i: (abs(i - goal), i), default=None)
    assert most_likely(np.zeros(len(captured)), allowed, goal) == nearest


@settings(max_examples=15)
@given(st.lists(SHARE, min_size=100, max_size=100).map(np.array), st.integers(0, 7), st.integers(0, 99))
def test_alternatives_are_other_places_the_likeliest_first_apart_from_each_other(probability, count, chosen):
    against = np.where(np.arange(100) % 3 == 0, list(Against).index(Against.UNSEEN), -1)
    found = alternatives(np.linspace(0, 1, 100), probability, against, 50, chosen, count)
    assert len(found) == count
    places = [round(a.s_capture * 99) for a in found]
    assert [a.probability for a in found] == sorted(probability[places], reverse=True)
    assert [a.reason for a in found] == ["unseen" if i % 3 == 0 else BETTER_ELSEWHERE for i in places]
    for i, place in enumerate(places):
        assert all(abs(place - other) >= 100 // (2 * count) for other in (*places[:i], chosen))
