"""Chances of many grips at once are those of each by itself, draw by draw."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planner.chances import Aimed
from agents.planner.config import PlannerConfig
from agents.planner.errors import across_jaw
from agents.planner.slide import Swept, keep_probability, spread
from agents.planner.wedge import wedge_probability, within_wedge

MM, DRAWS, SAMPLES = 1e-3, 72, 7
CONFIG = PlannerConfig(give_m=0.0007)


def drawn(seed):
    """Errors, ways to turn the jaws and a covariance, as they come."""
    rng = np.random.default_rng(seed)
    R = np.linalg.qr(rng.normal(size=(2, SAMPLES, 3, 3)))[0]
    roots = rng.normal(scale=1.5 * MM, size=(SAMPLES, 3, 3))
    return rng.normal(scale=2 * MM, size=(DRAWS, SAMPLES, 3)), R, roots @ np.swapaxes(roots, 1, 2)


@settings(max_examples=12)
@given(seed=st.integers(0, 999), goal=st.integers(0, SAMPLES - 1), depth=st.sampled_from((2.0, 5.1)))
def test_the_share_that_is_kept_is_counted_draw_by_draw(seed, goal, depth):
    errors, R, _ = drawn(seed)
    config = replace(CONFIG, depth_m=depth * MM)
    swept = Swept(spread(errors, R), config.setback_m, goal)
    found = keep_probability(swept.captured(1.0), swept.kept(0.5, 0.7 * MM), goal)
    for way in range(2):
        for i in range(SAMPLES):
            y, z = np.einsum("mnj,njk->knm", errors, R[way, :, :, 1:])
            caught = within_wedge(y, z + config.setback_m, 1.0)[i]
            on_the_way = within_wedge(y, z + config.setback_m, 0.5, 0.7 * MM)[min(i, goal) : max(i, goal) + 1]
            share = (caught & on_the_way.all(axis=0)).sum() / max(caught.sum(), 1)
            assert found[way, i] == (1 if i == goal else share)


def test_grips_share_what_they_have_in_common_and_nothing_else():
    errors, R, covariance = drawn(1)
    across = across_jaw(R, covariance)
    aimed = Aimed(across, spread(errors, R))
    grips = [
        replace(CONFIG, depth_m=d, open_deg=o, slide_deg=s) for d in (0.002, 0.004) for o in (45, 60) for s in (20, 30)
    ]
    for grip, whole in zip(grips, aimed.whole(3, grips), strict=True):
        (alone,) = aimed.whole(3, [grip])
        np.testing.assert_array_equal(whole, alone)
        at_goal = wedge_probability(np.tile([0.0, grip.setback_m], (2, 1)), across[:, 3], np.radians(grip.open_deg))
        assert whole[:, 3] == pytest.approx(at_goal, abs=1e-12)
