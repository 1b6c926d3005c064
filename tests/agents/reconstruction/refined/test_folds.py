"""Length of a curve that no point of either image supports: it leaves the thread and comes back."""

import dataclasses

import numpy as np
import pytest

from agents.reconstruction.refined.cubic import fitted
from agents.reconstruction.refined.projection import Curve, at_constant_speed
from agents.reconstruction.refined.sightings import Sightings, folds
from shared.splines import clamped_uniform_knots

SPANS = 40
OUT = 0.2
"""Share of the way that goes past the end and back again."""


@pytest.fixture
def overshooting(sight_of, threads):
    """A curve that goes past the thread's first end and returns, with the thread's points on what follows."""
    t = np.linspace(0, 1, 5 * (SPANS + 3))
    out = np.clip(t / OUT, 0, 1)
    place = np.where(t < OUT, -0.1 * np.sin(np.pi * out), (t - OUT) / (1 - OUT))
    points = threads["winding"](place) + np.where(t < OUT, 0.4 * np.sin(2 * np.pi * out), 0.0)[:, None]
    curve = Curve(clamped_uniform_knots(SPANS + 3), fitted(SPANS, points))
    sight = sight_of(curve, 200)
    return curve, sight.s == 0, dataclasses.replace(sight, is_end=np.zeros(len(sight.s), bool))


def only(sight, chosen):
    return Sightings(
        sight.point_px[chosen], sight.deviation_px[chosen], sight.eye[chosen], sight.s[chosen], sight.is_end[chosen]
    )


def length(curve):
    return np.linalg.norm(np.diff(curve.at(np.linspace(0, 1, 999)), axis=0), axis=1).sum()


@pytest.mark.parametrize("eye", [0, 1])
def test_an_end_that_one_eye_shows_does_not_support_the_way_out_and_back(overshooting, camera, eye):
    curve, at_end, sight = overshooting
    seen = only(sight, (sight.s > OUT + 0.01) | (at_end & (sight.eye == eye)))
    (fold,) = folds(seen, curve, camera)
    assert fold[0] == 0
    assert fold[1] == pytest.approx(OUT, abs=0.02)
    without, _ = at_constant_speed(curve, seen.s, folds(seen, curve, camera))
    assert length(without) < 0.9 * length(curve)


def test_a_fold_of_both_eyes_is_one_and_supported_or_straight_stretches_are_none(overshooting, camera):
    curve, at_end, sight = overshooting
    assert len(folds(only(sight, at_end | (sight.s > OUT + 0.01)), curve, camera)) == 1
    assert folds(sight, curve, camera).shape == (0, 2)
    assert len(folds(only(sight, (sight.s < 0.5) | (sight.s > 0.8)), curve, camera)) == 0
