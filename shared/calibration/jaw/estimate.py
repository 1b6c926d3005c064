"""At which angle a jaw closes: where its measured angle falls behind its set point.

While a jaw is free its measured angle m follows the set point x, up to the lag τ of its drive, an offset and a gain.
Once its fingers touch, each other or thread, the set point goes on and the measured angle does not, or less far:

    m(t) - x = b + c x + g max(0, h - x),    x = told(t - τ),    g ≥ 0.

So the following error is a line that bends at the set point h, where the jaw is measured at h + b + c h. The effort
bends at the same h, towards closing: its sign is that of the joint (sensor_msgs/JointState), so its bend is q ≤ 0.

For one h the rest is linear. With y the following error, and r the bend, both less what a line in x explains of them,

    g = max(0, r·y / r·r),    RSS(h) = y·y - g r·y,

and likewise for the effort. Where the deviation of the noise is not known, the likelihood's profile over h is

    log L(h) = -n/2 Σ log RSS(h) + constant,    n = samples (1 - ρ) / (1 + ρ),

summed over both signals, ρ being the correlation of neighbouring residuals: samples that go together count as fewer.
The mean and deviation of the measured angle under L are those of one closing.

Inertia and friction bend a line too. So a closing shows resistance where, beside the set point's velocity and
acceleration, the bend is worth its parameters (Schwarz, Ann. Statist. 6, 1978): n Σ log(RSS without / RSS with it) >
parameters · log n; where the jaw is free over the wider part of the closing; and where the following error, or the
effort, grows by more below the bend than it varies above. Where the bend lies is told by the line alone: velocity and
acceleration of a person's closing go along with the bend so far that they would leave its place to noise.

The lag is one for all closings. Where a jaw closes as measured it hardly matters: at constant speed it moves h and b by
the same, and their sum not. Where it is told to be then, h, hangs on it. What tells it is a jaw that opens and comes to
rest: there the speed changes, in one direction, so that backlash and offset stay.

A jaw does not close at quite the same angle each time (cables, backlash). So the closings are pooled as draws of it:
s² is the variance between them beyond their own v (DerSimonian and Laird, Control. Clin. Trials 7, 1986),

    s² = max(0, (Σ w (z - z̄)² - (closings - 1)) / (Σ w - Σ w² / Σ w)),    w = 1 / v,

each weighs 1 / (s² + v), and the deviation that is told is that of one more closing, √(s² + 1 / Σ 1 / (s² + v)).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from shared.calibration.stated import CalibrationError
from shared.kinematics.psm import FINGER_M

CLOSES_RAD = 1e-3 / FINGER_M
"""A jaw that is told to close by less than this, by which its tips come a millimetre nearer, is not said to close:
people open it wider than that, which is more than the thickest thread. Until it has moved by half of it, its backlash
and its inertia speak."""
FEWEST_CLOSINGS = 3
"""From which on closings tell how far they scatter, and one that is off shows."""
FEWEST_SAMPLES = 12
"""Three for each of the four numbers of a bent line."""
LONGEST_GAP_S = 0.1
"""Between two samples of a closing: as long as an arm may go unmeasured while it moves."""
LAGS_S = np.arange(-0.02, 0.2001, 0.005)
"""Below 0 where set points are told later than measurements."""
BENDS, LOG_NEGLIGIBLE = 200, 12.0
"""How many places of the bend are tried, and where a likelihood counts no more: e^-12 of its peak is 5 deviations."""
STEP_S = 0.05
"""Over which velocity and acceleration of the set point are taken: less than people take to move a jaw, and enough for
a set point that is rounded to a milliradian."""
NOTHING = 1e-9
"""A residual (rad) that is rounding."""
WIDEST_RAD = 0.1
"""Of the deviation: with three of them a jaw would be held for closed anywhere within 0.3 rad of its closing, as it is
without a calibration."""


@dataclass(frozen=True, eq=False)
class JawMotion:
    """A jaw as it was told and measured; times increase, and `effort` is NaN where it was not told."""

    time_s: Float64[np.ndarray, "n"]
    told_rad: Float64[np.ndarray, "n"]
    measured_rad: Float64[np.ndarray, "n"]
    effort: Float64[np.ndarray, "n"]


@dataclass(frozen=True)
class Contact:
    """Where a closing met resistance: at `closes_rad` as measured, when it was told `told_rad`."""

    closes_rad: float
    told_rad: float
    deviation_rad: float


@dataclass(frozen=True)
class Estimate:
    """The angle at which a jaw closes, as measured and as it is told, and with which deviation once more.

    Fields:
        closings: how many there were, of which `contacts` have met resistance.
    """

    closes_rad: float
    told_rad: float
    deviation_rad: float
    contacts: tuple[Contact, ...]
    closings: int
    lag_s: float


def estimated(motion: JawMotion) -> Estimate:
    """Where a jaw closes, of all its closings.

    Raises:
        CalibrationError: where there is too little motion to tell, or the closings contradict each other.
    """
    closings = closings_in(motion)
    if len(closings) < FEWEST_CLOSINGS:
        few = f"too little motion to tell: {len(closings)} closings, and {FEWEST_CLOSINGS} are needed"
        raise CalibrationError(f"{few}; open the jaw and close it until it presses, slowly, several times")
    lag_s = _lag_s(motion, closings)
    found = [contact for each in closings if (contact := contact_in(motion, each, lag_s)) is not None]
    if len(found) < FEWEST_CLOSINGS:
        of = f"{len(found)} of {len(closings)} closings met resistance, and {FEWEST_CLOSINGS} are needed"
        raise CalibrationError(f"too little motion to tell: {of}; close the jaw until it presses, slowly")
    pooled = _pooled(tuple(found), len(closings), lag_s)
    if pooled.deviation_rad > WIDEST_RAD:
        apart = f"the closings differ by {pooled.deviation_rad:.3f} rad (deviation), and {WIDEST_RAD:g} is allowed"
        raise CalibrationError(f"{apart}: close the jaw on the same thing each time, slowly")
    return pooled


def closings_in(motion: JawMotion) -> list[slice]:
    """Stretches in which the jaw was told to close by CLOSES_RAD or more, from where it has begun to.

    Those that were not measured throughout, or too seldom to tell a bend from a line, are left out.
    """
    found = [_begun(motion, first, last) for first, last in _descents(motion.told_rad)]
    return [each for each in found if _is_whole(motion.time_s[each])]


def contact_in(motion: JawMotion, closing: slice, lag_s: float) -> Contact | None:
    """Where one closing met resistance; None where it shows none."""
    line, signals = _free(motion, closing, lag_s), _signals(motion, closing, lag_s)
    lower, upper = float(line.x.min()), float(line.x.max())
    h = np.linspace(lower, upper, BENDS + 2)[1:-1]
    rss = np.array([_bent(line, y, h).rss for y in signals])
    count = _independent(line, signals[0], float(h[rss[0].argmin()]))
    best = float(h[_log_likelihood(rss, count).argmax()])
    if best - lower > upper - best or not _is_bent(_free(motion, closing, lag_s, moving=True), signals, h):
        return None
    likely, step = h[_log_likelihood(rss, count) > -LOG_NEGLIGIBLE], h[1] - h[0]
    # between these, and the places beside them that were no longer likely
    h = np.linspace(max(lower, likely[0] - step), min(upper, likely[-1] + step), BENDS + 2)[1:-1]
    bent = [_bent(line, y, h) for y in signals]
    weight = np.exp(_log_likelihood(np.array([each.rss for each in bent]), count))
    weight /= weight.sum()
    at = h + bent[0].at_bend
    closes_rad = float(weight @ at)
    deviation_rad = float(np.sqrt(weight @ (at - closes_rad) ** 2))
    return Contact(closes_rad, float(weight @ h), deviation_rad) if deviation_rad <= WIDEST_RAD else None


class _Free(NamedTuple):
    """What a signal of a free jaw is made of: columns of 1, the set point x a lag ago and, where it moves, velocity and
    acceleration of x; and the pseudo-inverse of these."""

    basis: Float64[np.ndarray, "n c"]
    inverse: Float64[np.ndarray, "c n"]

    @property
    def x(self) -> Float64[np.ndarray, "n"]:
        """The set point a lag ago."""
        return self.basis[:, 1]

    def off(self, rows: Float64[np.ndarray, "k n"]) -> Float64[np.ndarray, "k n"]:
        """Rows less what these explain of each."""
        return rows - (rows @ self.inverse.T) @ self.basis.T


class _Bent(NamedTuple):
    """Signals of a free jaw that bend at some places: what they leave over, the line at each bend, how far the signal
    grows by it, and how much of velocity and acceleration is in it, where that is asked."""

    rss: Float64[np.ndarray, "k"]
    at_bend: Float64[np.ndarray, "k"]
    growth: Float64[np.ndarray, "k"]
    moving: Float64[np.ndarray, "k m"]


def _free(motion: JawMotion, closing: slice, lag_s: float, moving: bool = False) -> _Free:
    at_s, step = motion.time_s[closing] - lag_s, STEP_S
    before, x, after = (np.interp(at_s + d, motion.time_s, motion.told_rad) for d in (-step, 0.0, step))
    columns = [np.ones_like(x), x, after - before, after - 2 * x + before]
    basis = np.column_stack(columns if moving else columns[:2])
    return _Free(basis, np.linalg.pinv(basis, rcond=NOTHING))


def _signals(motion: JawMotion, closing: slice, lag_s: float) -> list[Float64[np.ndarray, "n"]]:
    """What bends upwards where the jaw meets resistance: the following error, and the effort where that is told."""
    effort = motion.effort[closing]
    told = np.isfinite(effort).all() and np.ptp(effort) > 0
    x = np.interp(motion.time_s[closing] - lag_s, motion.time_s, motion.told_rad)
    return [motion.measured_rad[closing] - x, *([-effort] if told else [])]


def _bent(free: _Free, y: Float64[np.ndarray, "n"], h: Float64[np.ndarray, "k"]) -> _Bent:
    """The signal of a free jaw that is nearest to y, with a bend upwards below each of these h."""
    bend = np.maximum(0.0, h[:, None] - free.x)
    r, left = free.off(bend), free.off(y[None])[0]
    g = np.maximum(0.0, r @ left) / np.maximum((r**2).sum(axis=1), NOTHING**2)
    rss = ((left - g[:, None] * r) ** 2).sum(axis=1) + NOTHING**2
    told = (y - g[:, None] * bend) @ free.inverse.T
    return _Bent(rss, told[:, 0] + told[:, 1] * h, g * bend.max(axis=1), told[:, 2:])


def _is_bent(moving: _Free, signals: list[Float64[np.ndarray, "n"]], h: Float64[np.ndarray, "k"]) -> bool:
    """Whether a bend explains what no motion of a free jaw does, and a signal grows more below than it varies above."""
    bent = [_bent(moving, y, h) for y in signals]
    rss = np.array([each.rss for each in bent])
    count = _independent(moving, signals[0], float(h[rss[0].argmin()]))
    unbent = np.array([np.sum(moving.off(y[None]) ** 2) + NOTHING**2 for y in signals])
    if count * np.log(unbent / rss.min(axis=1)).sum() <= (1 + len(signals)) * np.log(count):
        return False
    best = int(_log_likelihood(rss, count).argmax())
    above = moving.x > h[best]
    still = [y - moving.basis[:, 2:] @ each.moving[best] for y, each in zip(signals, bent, strict=True)]
    return any(each.growth[best] > np.ptp(y[above]) for y, each in zip(still, bent, strict=True))


def _log_likelihood(rss: Float64[np.ndarray, "s k"], count: float) -> Float64[np.ndarray, "k"]:
    """Of each bend, less that of the best."""
    logs = -0.5 * count * np.log(rss).sum(axis=0)
    return logs - logs.max()


def _independent(free: _Free, y: Float64[np.ndarray, "n"], h: float) -> float:
    """As how many independent samples those of a bent line count."""
    basis = np.column_stack((free.basis, np.maximum(0.0, h - free.x)))
    left = y - basis @ np.linalg.lstsq(basis, y)[0]
    rho = max(0.0, float(left[1:] @ left[:-1] / max(left @ left, NOTHING**2)))
    return max(float(basis.shape[1] + 1), len(y) * (1 - rho) / (1 + rho))


def _lag_s(motion: JawMotion, closings: list[slice]) -> float:
    """The lag with which the measured angles of all closings are most likely."""

    opened = _openings(motion, closings)
    if not opened:
        unknown = "too little motion to tell at which set point it closes"
        raise CalibrationError(f"{unknown}: open the jaw, and let it stand open for a moment before it is closed")

    def unlikely(lag_s: float) -> float:
        total = 0.0
        for each in opened:
            free, (y, *_) = _free(motion, each, lag_s), _signals(motion, each, lag_s)
            total += len(y) * float(np.log(np.sum(free.off(y[None]) ** 2) + NOTHING**2))
        for each in closings:
            free, (y, *_) = _free(motion, each, lag_s), _signals(motion, each, lag_s)
            h = np.linspace(free.x.min(), free.x.max(), BENDS // 4)[1:-1]
            total += len(y) * float(np.log(_bent(free, y, h).rss.min()))
        return total

    return min((float(lag_s) for lag_s in LAGS_S), key=unlikely)


def _openings(motion: JawMotion, closings: list[slice]) -> list[slice]:
    """From where the jaw is measured to be half open until it is told to close again: its fingers touch nothing.

    Those alone after which it stood for as long as its lag may be.
    """
    found = list[slice]()
    for first, last in zip(
        (each.stop for each in closings), [*(each.start for each in closings[1:]), None], strict=True
    ):
        told = motion.told_rad[first:last]
        if len(told) < FEWEST_SAMPLES or np.ptp(told) < CLOSES_RAD:
            continue
        open_from = np.flatnonzero(motion.measured_rad[first:last] >= 0.5 * (told.min() + told.max()))
        top = np.flatnonzero(told >= told.max() - NOTHING)
        stands_s = motion.time_s[first + top[-1]] - motion.time_s[first + top[0]]
        if len(open_from) and top[-1] - open_from[0] >= FEWEST_SAMPLES // 2 and stands_s >= LAGS_S[-1]:
            found.append(slice(first + int(open_from[0]), first + int(top[-1]) + 1))
    return found


def _pooled(found: tuple[Contact, ...], closings: int, lag_s: float) -> Estimate:
    at, told = (np.array([getattr(each, name) for each in found]) for name in ("closes_rad", "told_rad"))
    own = np.array([each.deviation_rad for each in found]) ** 2
    w = 1 / (own + NOTHING**2)
    apart = w @ (at - w @ at / w.sum()) ** 2 - (len(found) - 1)
    between = max(0.0, float(apart / (w.sum() - w @ w / w.sum())))
    weight = 1 / (between + own + NOTHING**2)
    once_more = np.sqrt(between + 1 / weight.sum())
    weight /= weight.sum()
    return Estimate(float(weight @ at), float(weight @ told), float(once_more), found, closings, lag_s)


def _descents(told_rad: Float64[np.ndarray, "n"]) -> list[tuple[int, int]]:
    """From the last sample at the top to the first at the bottom of each fall by CLOSES_RAD or more.

    A rise by half as much ends one.
    """
    found, top, bottom = list[tuple[int, int]](), 0, 0
    for i, angle in enumerate(told_rad):
        if angle > told_rad[bottom] + CLOSES_RAD / 2 or i == len(told_rad) - 1:
            bottom = i if angle < told_rad[bottom] else bottom
            if told_rad[top] - told_rad[bottom] >= CLOSES_RAD:
                found.append((top, bottom))
            top = bottom = i
        elif angle < told_rad[bottom]:
            bottom = i
        if angle >= told_rad[top]:
            top = bottom = i
    return found


def _begun(motion: JawMotion, first: int, last: int) -> slice:
    """From where the measured jaw has moved by half of CLOSES_RAD.

    A jaw at rest is told of seldom: where that was so until it moved, from where what it was told a lag ago is known.
    """
    times, measured = motion.time_s[first : last + 1], motion.measured_rad[first : last + 1]
    moved = measured[0] - measured >= CLOSES_RAD / 2
    begun = int(moved.argmax()) if moved.any() else len(times) - 1
    seldom = np.flatnonzero(np.diff(times[: begun + 1]) > LONGEST_GAP_S)
    if len(seldom):
        begun = max(begun, int(np.searchsorted(times, times[seldom[-1] + 1] + LAGS_S[-1])))
    return slice(first + min(begun, len(times) - 1), last + 1)


def _is_whole(time_s: Float64[np.ndarray, "n"]) -> bool:
    return len(time_s) >= FEWEST_SAMPLES and bool(np.diff(time_s).max() <= LONGEST_GAP_S)
