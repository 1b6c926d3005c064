"""Where a jaw closes is found in closings with noise, lag, backlash, offset and give, and in none that meet nothing."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from shared.calibration import CalibrationError
from shared.calibration.jaw.estimate import CLOSES_RAD, JawMotion, closings_in, estimated

HZ = 100.0
FREE_RAD = -9.0


@dataclass(frozen=True)
class Simulated:
    """A jaw that somebody opens and closes, and what it does.

    Fields:
        give: of what it is told beyond its closing, the share by which it still comes nearer.
        scatter_rad: the deviation of where it closes.
        effort: of 1 N m per rad beyond its closing, with noise, is told.
        ramp: it is told to go at constant speed, and not as a person moves.
        stands: so many samples open.
    """

    seed: int = 0
    closings: int = 5
    closes_rad: float = 0.08
    noise_rad: float = 1e-3
    lag_s: float = 0.03
    backlash_rad: float = 0.0
    offset_rad: float = 0.0
    give: float = 0.0
    scatter_rad: float = 0.0
    effort: bool = False
    press_rad: tuple[float, float] = (0.15, 0.4)
    ramp: bool = False
    stands: int = 30

    def motion(self) -> JawMotion:
        rng = np.random.default_rng(self.seed)
        told, stops, at = [np.full(20, 1.0)], [np.full(20, self.closes_rad)], 1.0
        for _ in range(self.closings):
            stop = self.closes_rad + rng.normal(0, self.scatter_rad) if self.scatter_rad else self.closes_rad
            bottom = (stop if stop > FREE_RAD / 2 else -0.1) - self.offset_rad - rng.uniform(*self.press_rad)
            top = rng.uniform(0.7, 1.1)
            # as a person moves: with the least jerk from rest to rest
            s = np.linspace(0, 1, int(HZ * rng.uniform(0.7, 2.0)))
            along = s if self.ramp else 10 * s**3 - 15 * s**4 + 6 * s**5
            parts = [
                at + (bottom - at) * along,
                np.full(30, bottom),
                bottom + (top - bottom) * along,
                np.full(self.stands, top),
            ]
            told += parts
            stops.append(np.full(sum(map(len, parts)), stop))
            at = top
        x, stop = np.concatenate(told), np.concatenate(stops)
        free = self._free(x)
        measured = np.where(free > stop, free, stop + self.give * (free - stop))
        effort = np.full(len(x), np.nan)
        if self.effort:
            effort = np.minimum(0.0, free - stop) + rng.normal(0, 0.01, len(x))
        return JawMotion(np.arange(len(x)) / HZ, x, measured + rng.normal(0, self.noise_rad, len(x)), effort)

    def _free(self, x: np.ndarray) -> np.ndarray:
        """Through a critically damped drive, then backlash."""
        if self.lag_s:
            keeps = float(np.exp(-2 / (self.lag_s * HZ)))
            for _ in range(2):
                x = lfilter([1 - keeps], [1, -keeps], x - x[0]) + x[0]
        followed, here = np.empty_like(x), x[0]
        for i, drive in enumerate(x):
            here = min(max(here, drive - self.backlash_rad / 2), drive + self.backlash_rad / 2)
            followed[i] = here
        return followed + self.offset_rad


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10**6),
    st.floats(-0.3, 0.3),
    st.floats(1e-4, 3e-3),
    st.floats(0, 0.1),
    st.floats(0, 0.05),
    st.floats(-0.05, 0.05),
    st.floats(0, 0.6),
    st.booleans(),
)
def test_where_a_jaw_closes_is_found_to_a_few_milliradians_by_its_following_error(
    seed, closes_rad, noise_rad, lag_s, backlash_rad, offset_rad, give, ramp
):
    jaw = Simulated(seed, 5, closes_rad, noise_rad, lag_s, backlash_rad, offset_rad, give, ramp=ramp)
    found = estimated(jaw.motion())
    assert len(found.contacts) >= 3
    assert abs(found.closes_rad - closes_rad) < 0.006
    assert found.deviation_rad < 0.02
    # its set point there is off by offset, half of the backlash, and what of its inertia is no lag; a jaw that is told
    # too little presses more, and one that is told too much must still press: it is squeezed by 0.02 and more
    assert -0.06 < found.told_rad - (closes_rad - offset_rad - backlash_rad / 2) < 0.02


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 10**6),
    st.floats(0, 3e-3),
    st.floats(0, 0.1),
    st.floats(0, 0.05),
    st.floats(-0.05, 0.05),
    st.booleans(),
)
def test_a_jaw_that_meets_nothing_is_not_said_to_close_anywhere(seed, noise_rad, lag_s, backlash, offset, effort):
    free = Simulated(seed, 5, FREE_RAD, noise_rad, lag_s, backlash, offset, effort=effort)
    with pytest.raises(CalibrationError, match="too little motion to tell"):
        estimated(free.motion())


def test_a_jaw_that_is_measured_to_go_on_is_found_by_its_effort_alone():
    yielding = Simulated(give=1.0, effort=True)
    assert estimated(yielding.motion()).closes_rad == pytest.approx(0.08, abs=8e-3)
    with pytest.raises(CalibrationError, match="too little motion to tell"):
        estimated(replace(yielding, effort=False).motion())


def test_the_deviation_is_that_of_one_more_closing_however_sharp_each_is():
    off = []
    for seed in range(20):
        found = estimated(Simulated(seed, closings=6, scatter_rad=0.01, noise_rad=5e-4).motion())
        once_more = Simulated(seed + 100, closings=1, scatter_rad=0.01)
        closes = np.random.default_rng(once_more.seed).normal(0, 0.01) + 0.08
        off.append((closes - found.closes_rad) / found.deviation_rad)
    assert 0.5 < np.std(off) < 1.7


@pytest.mark.parametrize(
    ("motion", "told"),
    [
        (Simulated(stands=2).motion(), "stand open for a moment"),
        (Simulated(closings=2).motion(), "2 closings, and 3 are needed"),
        (Simulated(closes_rad=FREE_RAD).motion(), "0 of 5 closings met resistance"),
        (Simulated(scatter_rad=0.2).motion(), r"closings differ by 0\.\d+ rad"),
        (JawMotion(np.arange(500) / HZ, *(np.full(500, 0.3),) * 3), "0 closings"),
    ],
)
def test_too_little_motion_and_contradicting_closings_are_told(motion, told):
    with pytest.raises(CalibrationError, match=told):
        estimated(motion)


def test_a_closing_that_was_not_recorded_throughout_or_hardly_moves_is_none():
    motion = Simulated().motion()
    assert len(closings_in(motion)) == 5
    first = closings_in(motion)[0]
    # a quarter of a second is missing in the middle of the first
    middle = (first.start + first.stop) // 2
    kept = np.r_[0 : middle - 12, middle + 13 : len(motion.time_s)]
    gap = JawMotion(*(getattr(motion, name)[kept] for name in ("time_s", "told_rad", "measured_rad", "effort")))
    assert len(closings_in(gap)) == 4
    little = replace(motion, told_rad=1.0 + 0.9 * CLOSES_RAD * (motion.told_rad - motion.told_rad.max()) / 1.6)
    assert closings_in(little) == []


def test_a_jaw_at_rest_that_is_told_of_five_times_a_second_until_it_moves_is_found_all_the_same():
    motion = Simulated(lag_s=0.05).motion()
    moves = np.abs(np.gradient(motion.told_rad)) * HZ > 0.02
    # 100 Hz once it has moved by the last state, and one in twenty at rest
    kept = np.array([i for i in range(len(moves)) if moves[max(0, i - 15)] or i % 20 == 0])
    seldom = JawMotion(*(getattr(motion, name)[kept] for name in ("time_s", "told_rad", "measured_rad", "effort")))
    assert estimated(seldom).closes_rad == pytest.approx(0.08, abs=3e-3)
