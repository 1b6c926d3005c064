"""The instrument against thread outside of the grasp: by brute force, and on threads that are in its way."""

import dataclasses

import numpy as np
import pytest

from agents.planner.config import PlannerConfig
from agents.planner.instrument import Capsules, clearances
from agents.planner.plan import plan_grasp
from schemas.messages import Policy, Status

CONFIG = PlannerConfig()


def test_clearances_are_those_of_a_brute_force():
    rng = np.random.default_rng(1)
    capsules = Capsules(rng.normal(size=(3, 4, 3)), rng.normal(size=(3, 4, 3)), rng.uniform(0, 0.3, 4))
    points = rng.normal(size=(20, 3))
    share = np.linspace(0, 1, 4001)[:, None]
    for k in range(3):
        for n in range(20):
            lines = [capsules.start[k, c] + share * (capsules.end[k, c] - capsules.start[k, c]) for c in range(4)]
            off = [
                np.linalg.norm(line - points[n], axis=1).min() - r
                for line, r in zip(lines, capsules.radius_m, strict=True)
            ]
            assert clearances(capsules, points)[k, n] == pytest.approx(min(off), abs=1e-3)


def known(thread, sigma_mm=0.2):
    covariance = np.tile(np.eye(3) * sigma_mm**2, (5, 1, 1))
    return dataclasses.replace(thread, posterior_s=np.linspace(0, 1, 5), posterior_covariance=covariance)


def stands(plan):
    """How a plan stands to the rest of the thread."""
    assert plan.thread is not None
    return plan.thread


def test_a_plan_on_straight_thread_is_clear_of_it_and_says_how_far(bench):
    plan = plan_grasp(bench.goal(s=0.5), known(bench.straight()), bench.arm(), CONFIG)
    assert (plan.status, plan.policy_model) == (Status.OK, "geometric")
    assert stands(plan).obstructed == ""
    assert (stands(plan).clearance_m or 0.0) > CONFIG.thread_clear_m


def under_a_strand(bench, base_camera):
    """Thread that comes back over itself, 14 mm nearer to the camera, where the wrist has to be."""
    over = bench.polyline((-30, 0, 80), (30, 0, 80), (30, 0, 66), (-30, 0, 66))
    plan = plan_grasp(bench.goal(s=0.22, policy=Policy.DIRECT), known(over), bench.arm(base_camera), CONFIG)
    assert plan.status is Status.OK, plan.reason
    return plan


def test_where_thread_hangs_in_the_way_of_every_approach_the_plan_says_so(bench):
    found = stands(under_a_strand(bench, (0, 0, 0)))
    assert "touches the thread" in found.obstructed
    assert found.clearance_m is not None
    assert found.clearance_m < 0
    assert (found.s or 0.0) > 0.5


def test_of_two_approaches_that_is_taken_which_keeps_clear(bench):
    assert stands(under_a_strand(bench, (0.05, -0.1, 0))).obstructed == ""
