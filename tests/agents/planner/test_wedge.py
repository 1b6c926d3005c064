"""The probability of lying between closing fingers: by Monte Carlo, and in its limits."""

import numpy as np
import pytest

from agents.planner.wedge import wedge_probability, within_wedge
from shared.kinematics.psm import FINGER_M

MM = 1e-3
MIDDLE = np.array([0.0, 7.0]) * MM


@pytest.mark.parametrize("case", range(5))
def test_it_is_the_share_of_a_monte_carlo_that_lies_between_the_fingers(case):
    rng = np.random.default_rng(case)
    mean = np.array([rng.normal(0, 2), rng.uniform(2, 11)]) * MM
    root = rng.normal(size=(2, 2)) * 10 ** rng.uniform(-2, 0.7) * MM
    covariance = root @ root.T + (0.3 * MM) ** 2 * np.eye(2)
    opening, give = rng.uniform(0.2, 1.4), rng.choice([0.0, 1.0]) * MM
    drawn = rng.multivariate_normal(mean, covariance, 100_000)
    share = within_wedge(drawn[:, 0], drawn[:, 1], opening, give).mean()
    assert wedge_probability(mean, covariance, opening, give) == pytest.approx(share, abs=0.006)


def test_without_any_error_it_is_certain_and_with_a_huge_one_hopeless():
    assert wedge_probability(MIDDLE, np.zeros((2, 2)), 0.7) == pytest.approx(1)
    assert wedge_probability(np.array([0.0, FINGER_M + MM]), np.zeros((2, 2)), 0.7) == pytest.approx(0)
    assert wedge_probability(MIDDLE, np.eye(2), 0.7) < 1e-3


def test_the_larger_the_error_the_less_likely_and_the_wider_the_opening_the_likelier():
    sigmas = np.linspace(0.1, 5, 25) * MM
    by_error = wedge_probability(np.tile(MIDDLE, (25, 1)), sigmas[:, None, None] ** 2 * np.eye(2), 0.7)
    assert (np.diff(by_error) < 0).all()
    covariance = (1.5 * MM) ** 2 * np.eye(2)
    by_opening = [float(wedge_probability(MIDDLE, covariance, opening)) for opening in np.linspace(0.2, 1.3, 12)]
    assert (np.diff(by_opening) > 0).all()
    assert wedge_probability(MIDDLE, covariance, 0.5, MM) > wedge_probability(MIDDLE, covariance, 0.5)
