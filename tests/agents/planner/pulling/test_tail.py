"""The length of a strand: its deviation against draws of the posterior, and what it does not claim."""

import numpy as np
import pytest

from agents.planner.pulling.tail import tail_length
from schemas.messages import TailLength
from shared.rigid_transforms import exp_so3
from tests.agents.planner.pulling.bench import path

LAMBDA_M = 0.006


def strand(bent, length_m=0.04, n=81):
    """A straight strand along x, or one on half a circle."""
    angle = np.linspace(0.0, np.pi, n)
    radius = length_m / np.pi
    if bent:
        return np.column_stack((radius * np.sin(angle), -radius * np.cos(angle), np.full(n, 0.08)))
    return np.column_stack((np.linspace(0, length_m, n), np.zeros(n), np.full(n, 0.08)))


def drawn_lengths(points, covariance, draws, rng):
    """Lengths of strands as the posterior has them, whose errors go together over λ."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    together = np.exp(-0.5 * ((along[:, None] - along) / LAMBDA_M) ** 2)
    values, vectors = np.linalg.eigh(together)
    field = rng.standard_normal((draws, len(points), 3))
    smooth = np.einsum("nk,dkj->dnj", vectors * np.sqrt(np.maximum(values, 0.0)), field)
    off = np.einsum("nij,dnj->dni", np.linalg.cholesky(covariance), smooth)
    return np.linalg.norm(np.diff(points + off, axis=1), axis=2).sum(axis=1)


@pytest.mark.parametrize("bent", [False, True])
@pytest.mark.parametrize("deviations_mm", [(0.1, 0.1, 0.3), (0.1, 0.1, 1.0), (0.4, 0.4, 0.4)])
def test_the_interval_holds_the_true_length_at_least_as_often_as_it_says(bent, deviations_mm):
    points, rng = strand(bent), np.random.default_rng(7)
    R = exp_so3(np.array((0.2, 0.1, 0.0)))
    covariance = np.tile(R @ np.diag(np.square(deviations_mm) * 1e-6) @ R.T, (len(points), 1, 1))
    told = tail_length(points, covariance, LAMBDA_M)
    low_m, high_m = told.interval_m
    true_m = drawn_lengths(points, covariance, 2000, rng)
    inside = ((true_m >= low_m) & (true_m <= (high_m or 0.0))).mean()
    assert inside >= 0.94
    assert told.deviation_m < 2.0 * max(true_m.std(), abs(true_m.mean() - told.length_m)), "nor is it far too wide"


def test_what_moves_a_strand_as_a_whole_leaves_its_length_and_its_ends_count_in_full():
    points = strand(False)
    along = np.tile(np.diag([1e-6, 0.0, 0.0]), (len(points), 1, 1))
    whole = tail_length(points, along, 1e3)
    assert whole.length_m == pytest.approx(0.04)
    assert whole.deviation_m == pytest.approx(0.0, abs=1e-6)
    apart = tail_length(points, along, 1e-4)
    assert apart.deviation_m == pytest.approx(np.sqrt(2) * 1e-3, rel=0.01)
    assert tail_length(points, 0 * along, LAMBDA_M, end_m=3e-4).deviation_m == pytest.approx(np.sqrt(2) * 3e-4)


def test_a_tail_whose_free_end_is_not_seen_has_no_upper_bound():
    told = TailLength(0.03, 0.001, at_least=True)
    assert told.interval_m == (pytest.approx(0.03 - 1.96e-3), None)
    assert tail_length(np.zeros((5, 3)), np.zeros((5, 3, 3)), LAMBDA_M).length_m == 0.0
    points, long_mm = path([(0, 0, 1), (3, 4, 1)], 9)
    assert tail_length(points, np.zeros((9, 3, 3)), LAMBDA_M).length_m == pytest.approx(long_mm)
