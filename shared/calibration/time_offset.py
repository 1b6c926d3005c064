"""By how much a camera's stamps are later than those of an arm's joints, from the motion of its tool in the images.

Each window of WINDOW_S is looked at by itself. In its middle frame points are found where the image changes (Shi and
Tomasi 1994), and tracked to both ends of the window, there and back (Lucas and Kanade 1981). While a tool moves by some
centimetres, where a point of it is seen is about linear in the tool's pose, whatever camera and registration are:

    x_i(t) = c_i + C_i f(t - δ) + r_i(t),        f = (place, two axes, jaw).

For each δ of a grid the C_i follow by least squares, in the two main directions that f takes within the window. What is
left is not white, for perspective bends what is taken for linear: r_i(t) = ρ_i r_i(t - 1) + e_i(t). So it is the
variance of e that says how well δ fits,

    L(δ) = -Σ_windows mean_i n log((1 - ρ_i²) (var r_i + σ²)).

A pose of a moment later is no linear function of the pose of now, so L has a sharp maximum. Windows drawn anew with
replacement, neighbours together (the block bootstrap), say how sure it is: other tools and tissue are in it too. Frames
of a window, and states of an arm, are taken to come evenly where about as much time lies between all of them: what
their stamps jitter by is not the motion's.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8
from scipy.ndimage import median_filter, uniform_filter1d

from schemas.messages import RobotState

WIDTH_PX = 480
"""Images are looked at in this width."""
WINDOW_S, HOP_S, LEAST_FRAMES = 1.5, 0.75, 20
MOST_POINTS, MOVED_GREY, MOVED_FRAMES = 100, 12, 6
"""Points are looked for where grey has changed by so much over so many frames."""
THERE_AND_BACK_PX, LEAST_WAY_PX, NOISE_PX = 0.5, 5.0, 0.03
AXIS_M, JAW_M = 0.01, 0.01
"""An axis that turns by a radian, and a jaw that opens by one, count as so many metres of the tool's way."""
DIRECTIONS, LEAST_WAY_M = 2, 1e-3
"""Windows tell something where f moves by as much (standard deviation)."""
EVEN, BESIDE, EVEN_STATES = 3.0, 9, 51
"""Stamps are even where no interval is so many times the usual of so many beside it; of an arm so many go together."""
FARTHEST_S, STEP_S, FINE_S = 4.0, 0.02, 0.002
LEAST_WINDOWS, DRAWS = 5, 400
BLOCK = 4
"""Neighbouring windows share frames, and a motion lasts for several: so many are drawn together."""
TOLD_S = 0.05
"""A 95 % interval that reaches farther to either side tells nothing: the tool hardly moved."""
TOO_LITTLE = f"too little motion to tell, or more than {FARTHEST_S:.0f} s apart"


@dataclass(frozen=True, eq=False)
class Window:
    """Where points were seen in the frames of a window, in pixels of an image WIDTH_PX wide."""

    time_s: Float64[np.ndarray, "n"]
    places_px: Float64[np.ndarray, "m n 2"]

    @cached_property
    def ways_px(self) -> Float64[np.ndarray, "n mc"]:
        """Away from the mean place of each."""
        away = self.places_px - self.places_px.mean(axis=1, keepdims=True)
        return away.transpose(1, 0, 2).reshape(len(self.time_s), -1)

    @cached_property
    def untold(self) -> float:
        """L of the window where nothing of the motion is explained."""
        return _innovations(self.ways_px)


@dataclass(frozen=True, eq=False)
class ToolMotion:
    """The tool's poses as the arm measured them, times increasing."""

    time_s: Float64[np.ndarray, "k"]
    T_base_tool: Float64[np.ndarray, "k 4 4"]
    jaw_rad: Float64[np.ndarray, "k"]

    @property
    def pose(self) -> Float64[np.ndarray, "k 10"]:
        """f of the equation, in metres."""
        T = self.T_base_tool
        return np.column_stack((T[:, :3, 3], AXIS_M * T[:, :3, 0], AXIS_M * T[:, :3, 2], JAW_M * self.jaw_rad))


def motion_of(states: Mapping[int, RobotState]) -> ToolMotion:
    """The tool's motion, from the states of an arm by when they were measured."""
    ordered = [states[at_ns] for at_ns in sorted(states)]
    return ToolMotion(
        np.array([state.measured_ns * 1e-9 for state in ordered]),
        np.array([state.T_base_tool for state in ordered]),
        np.array([state.jaw_rad for state in ordered]),
    )


@dataclass(frozen=True)
class TimeOffset:
    """By how much the camera's stamps are later than the joints', its 95 % interval, and from how many windows."""

    delay_s: float
    interval_s: tuple[float, float]
    windows: int


def windows_of(frames: Iterable[tuple[float, UInt8[np.ndarray, "h w *c"]]]) -> Iterator[Window]:
    """Windows of a video in which points move; frames come with their times, in order, and are not kept."""
    held: deque[tuple[float, UInt8[np.ndarray, "h w"]]] = deque()
    for at_s, image in frames:
        small = _small(image)
        if held and (small.shape != held[-1][1].shape or at_s <= held[-1][0]):
            held.clear()
        held.append((at_s, small))
        if at_s - held[0][0] < WINDOW_S:
            continue
        if len(held) >= LEAST_FRAMES and (places := _tracked([image for _, image in held])) is not None:
            yield Window(_even(np.array([at for at, _ in held])), places)
        while held and held[0][0] < at_s - (WINDOW_S - HOP_S):
            held.popleft()


def time_offset(windows: list[Window], motion: ToolMotion) -> TimeOffset | None:
    """The offset of a camera to an arm; None where too little moves to tell."""
    motion, pose = replace(motion, time_s=_evenly(motion.time_s)), motion.pose
    grid = np.arange(-FARTHEST_S, FARTHEST_S + STEP_S / 2, STEP_S)
    coarse = np.array([_fits(windows, motion.time_s, pose, delay) for delay in grid])
    best_s = float(grid[coarse.sum(axis=1).argmax()])
    moving = np.array([_moves(one, motion.time_s, pose, best_s) for one in windows], bool)
    if moving.sum() < LEAST_WINDOWS:
        return None
    coarse, windows = coarse[:, moving], [one for one, moves in zip(windows, moving, strict=True) if moves]
    best_s = float(grid[coarse.sum(axis=1).argmax()])
    near = best_s + np.arange(-2 * STEP_S, 2 * STEP_S + FINE_S / 2, FINE_S)
    fine = np.array([_fits(windows, motion.time_s, pose, delay) for delay in near])
    delay_s = float(near[fine.sum(axis=1).argmax()])
    drawn = _drawn(len(windows))
    elsewhere = grid[coarse[:, drawn].sum(axis=2).argmax(axis=0)]
    here = near[fine[:, drawn].sum(axis=2).argmax(axis=0)]
    of_draws = np.where(np.abs(elsewhere - best_s) > 2 * STEP_S, elsewhere, here)
    low_s, high_s = (float(value) for value in np.percentile(of_draws, (2.5, 97.5)) + np.array((-FINE_S, FINE_S)))
    if max(delay_s - low_s, high_s - delay_s) > TOLD_S:
        return None
    return TimeOffset(delay_s, (low_s, high_s), len(windows))


def _drawn(count: int) -> Int64[np.ndarray, "d w"]:
    """Windows drawn in blocks of neighbours, as many as there are (Künsch, 1989)."""
    begun = np.random.default_rng(0).integers(0, count, (DRAWS, -(-count // BLOCK)))
    return ((begun[..., None] + np.arange(BLOCK)) % count).reshape(DRAWS, -1)[:, :count]


def _small(image: UInt8[np.ndarray, "h w *c"]) -> UInt8[np.ndarray, "h w"]:
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    scale = WIDTH_PX / grey.shape[1]
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def _tracked(images: list[UInt8[np.ndarray, "h w"]]) -> Float64[np.ndarray, "m n 2"] | None:
    """Where points that move are seen in all frames; None where there are none."""
    middle, last = len(images) // 2, len(images) - 1
    beside = max(0, middle - MOVED_FRAMES), min(last, middle + MOVED_FRAMES)
    moved = np.maximum(*(cv2.absdiff(images[middle], images[k]) for k in beside)) > MOVED_GREY
    mask = cv2.dilate(255 * moved.astype(np.uint8), np.ones((7, 7), np.uint8))
    begun: Any = cv2.goodFeaturesToTrack(images[middle], MOST_POINTS, 0.02, 5, mask=mask)
    if begun is None:
        return None
    places = np.zeros((len(images), len(begun), 2))
    places[middle], kept = begun[:, 0], np.ones(len(begun), bool)
    for way in (range(middle, last), range(middle, 0, -1)):
        point = begun
        for k in way:
            one, other = images[k], images[k + way.step]
            there, found, _ = cv2.calcOpticalFlowPyrLK(one, other, point, np.empty_like(point))
            back, again, _ = cv2.calcOpticalFlowPyrLK(other, one, there, np.empty_like(there))
            off_px = np.linalg.norm((back - point)[:, 0], axis=1)
            kept &= (found[:, 0] > 0) & (again[:, 0] > 0) & (off_px < THERE_AND_BACK_PX)
            places[k + way.step], point = there[:, 0], there
    kept &= np.ptp(places, axis=0).max(axis=1) > LEAST_WAY_PX
    return places[:, kept].transpose(1, 0, 2) if kept.any() else None


def _fits(
    windows: list[Window], time_s: Float64[np.ndarray, "k"], pose: Float64[np.ndarray, "k f"], delay_s: float
) -> Float64[np.ndarray, "w"]:
    """L of each window at a delay."""
    return np.array([_fit(one, time_s, pose, delay_s) for one in windows])


def _fit(window: Window, time_s: Float64[np.ndarray, "k"], pose: Float64[np.ndarray, "k f"], delay_s: float) -> float:
    f = _pose_in(window, time_s, pose, delay_s)
    if f is None:
        return 0.0
    taken = np.linalg.svd(f, full_matrices=False)[0][:, :DIRECTIONS]
    return _innovations(window.ways_px - taken @ (taken.T @ window.ways_px)) - window.untold


def _pose_in(
    window: Window, time_s: Float64[np.ndarray, "k"], pose: Float64[np.ndarray, "k f"], delay_s: float
) -> Float64[np.ndarray, "n f"] | None:
    """f in the window's frames, away from its mean; None where the arm was not measured then."""
    at_s = window.time_s - delay_s
    if at_s[0] < time_s[0] or at_s[-1] > time_s[-1]:
        return None
    f = np.column_stack([np.interp(at_s, time_s, column) for column in pose.T])
    return f - f.mean(axis=0)


def _moves(window: Window, time_s: Float64[np.ndarray, "k"], pose: Float64[np.ndarray, "k f"], delay_s: float) -> bool:
    f = _pose_in(window, time_s, pose, delay_s)
    return f is not None and float(np.sqrt((f**2).sum(axis=1).mean())) > LEAST_WAY_M


def _innovations(left_px: Float64[np.ndarray, "n mc"]) -> float:
    """L of what is left of the points' ways."""
    n = len(left_px)
    square = (left_px**2).reshape(n, -1, 2).sum(axis=(0, 2))
    beside = (left_px[1:] * left_px[:-1]).reshape(n - 1, -1, 2).sum(axis=(0, 2))
    noisy = square + 2 * n * NOISE_PX**2
    rho = np.clip(beside / noisy, 0.0, None)
    return -n * float(np.log(noisy * (1 - rho**2)).mean())


def _even(time_s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """Stamps on the straight line through them, where they are even."""
    steps = np.diff(time_s)
    if steps.max() > EVEN * np.median(steps):
        return time_s
    number = np.arange(len(time_s))
    return np.polyval(np.polyfit(number, time_s, 1), number)


def _evenly(time_s: Float64[np.ndarray, "k"]) -> Float64[np.ndarray, "k"]:
    """The same of runs of even stamps, each of which may drift."""
    steps = np.diff(time_s)
    if not len(steps):
        return time_s
    # an arm that rests tells seldom: before a change of its rate and after it, another interval is usual
    before, after = (median_filter(steps, BESIDE, mode="nearest", origin=way) for way in (BESIDE // 2, -(BESIDE // 2)))
    return np.concatenate(
        [_smoothed(run) for run in np.split(time_s, np.flatnonzero(steps > EVEN * np.minimum(before, after)) + 1)]
    )


def _smoothed(time_s: Float64[np.ndarray, "k"]) -> Float64[np.ndarray, "k"]:
    if len(time_s) < EVEN_STATES:
        return time_s
    number = np.arange(len(time_s))
    line = np.polyval(np.polyfit(number, time_s - time_s[0], 1), number) + time_s[0]
    return line + uniform_filter1d(time_s - line, EVEN_STATES, mode="nearest")
