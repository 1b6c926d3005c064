"""Length of a curve that no point of either image supports: it leaves the thread and comes back."""

import dataclasses

import numpy as np
import pytest

from agents.reconstruction.refined.cubic import fitted
from agents.reconstruction.refined.projection import Curve, at_constant_speed
from agents.reconstruction.refined.sightings import folds
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
    at_end = sight.s == 0
    return curve, at_end, dataclasses.replace(sight, is_end=np.zeros(len(sight.s), bool))


def kept(sight, chosen):
    """Only these of the sightings."""
    return dataclasses.replace(
        sight,
        **{
            f.name: getattr(sight, f.name)[chosen]
            for f in dataclasses.fields(sight)
            if f.name not in ("width_px", "raised")
        },
    )


@pytest.mark.parametrize("eye", [0, 1])
def test_an_end_that_one_eye_shows_does_not_support_the_way_out_and_back(overshooting, camera, eye):
    curve, at_end, sight = overshooting
    seen = kept(sight, (sight.s > OUT + 0.01) | (at_end & (sight.eye == eye)))
    (fold,) = folds(seen, curve, camera)
    assert fold[0] == 0
    assert fold[1] == pytest.approx(OUT, abs=0.02)
    without, _ = at_constant_speed(curve, seen.s, folds(seen, curve, camera))
    length, shorter = (
        np.linalg.norm(np.diff(c.at(np.linspace(0, 1, 999)), axis=0), axis=1).sum() for c in (curve, without)
    )
    assert shorter < 0.9 * length


def test_what_points_support_is_no_fold(overshooting, camera):
    curve, _, sight = overshooting
    assert folds(sight, curve, camera).shape == (0, 2)


def test_folds_that_both_eyes_show_are_one(overshooting, camera):
    curve, at_end, sight = overshooting
    assert len(folds(kept(sight, at_end | (sight.s > OUT + 0.01)), curve, camera)) == 1


def test_a_gap_that_the_thread_crosses_straight_is_no_fold(overshooting, camera):
    curve, _, sight = overshooting
    assert len(folds(kept(sight, (sight.s < 0.5) | (sight.s > 0.8)), curve, camera)) == 0
