"""By how much a camera's stamps are later than those of an arm's joints, from the motion of its tool in the images.

Each window of WINDOW_S is looked at by itself. In its middle frame points are found where the image changes (Shi and
Tomasi 1994), and tracked to both ends of the window, there and back (Lucas and Kanade 1981). While a tool moves by some
centimetres, where a point of it is seen is about linear in the tool's pose, whatever camera and registration are:

    x_i(t) = c_i + C_i f(t - δ) + noise,        f = (place, two axes, jaw).

For each δ of a grid the C_i follow by least squares, in the main directions that f takes within the window, and what is
left of the points' motion says how well δ fits:

    L(δ) = -Σ_windows mean_i n log(RSS_i(δ) / TSS_i).

A pose of a moment later is no linear function of the pose of now, so L has a sharp maximum. Windows drawn anew with
replacement (the bootstrap of Efron, 1979) say how sure it is: other tools, tissue and light are in it as they come.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

WIDTH_PX = 480
"""Images are looked at in this width."""
WINDOW_S, HOP_S, LEAST_FRAMES = 1.5, 0.75, 20
MOST_POINTS, MOVED_GREY, MOVED_FRAMES = 100, 12, 6
"""Points are looked for where grey has changed by so much over so many frames."""
THERE_AND_BACK_PX, LEAST_WAY_PX, NOISE_PX = 0.5, 5.0, 0.15
AXIS_M, JAW_M = 0.01, 0.01
"""An axis that turns by a radian, and a jaw that opens by one, count as so many metres of the tool's way."""
LEAST_WAY_M, MOST_DIRECTIONS = 3e-4, 3
"""Directions of f count that it takes by as much (standard deviation) within a window."""
FARTHEST_S, STEP_S, FINE_S = 4.0, 0.02, 0.002
LEAST_WINDOWS, DRAWS = 5, 400
TOLD_S = 0.05
"""A 95 % interval that reaches farther to either side tells nothing: the tool hardly moved."""


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
    def total_px2(self) -> Float64[np.ndarray, "m"]:
        """The sum of their squares, of each point."""
        return (self.ways_px**2).reshape(len(self.time_s), -1, 2).sum(axis=(0, 2))


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
        held.append((at_s, _small(image)))
        if at_s - held[0][0] < WINDOW_S:
            continue
        if len(held) >= LEAST_FRAMES and (places := _tracked([image for _, image in held])) is not None:
            yield Window(np.array([at for at, _ in held]), places)
        while held and held[0][0] < at_s - (WINDOW_S - HOP_S):
            held.popleft()


def time_offset(windows: list[Window], motion: ToolMotion) -> TimeOffset | None:
    """The offset of a camera to an arm; None where too little moves to tell."""
    pose = motion.pose
    grid = np.arange(-FARTHEST_S, FARTHEST_S + STEP_S / 2, STEP_S)
    coarse = np.array([_fits(windows, motion.time_s, pose, delay) for delay in grid])
    moving = coarse.max(axis=0) > 0 if len(windows) else np.zeros(0, bool)
    if moving.sum() < LEAST_WINDOWS:
        return None
    coarse, windows = coarse[:, moving], [one for one, moves in zip(windows, moving, strict=True) if moves]
    best_s = float(grid[coarse.sum(axis=1).argmax()])
    near = best_s + np.arange(-2 * STEP_S, 2 * STEP_S + FINE_S / 2, FINE_S)
    fine = np.array([_fits(windows, motion.time_s, pose, delay) for delay in near])
    delay_s = float(near[fine.sum(axis=1).argmax()])
    drawn = np.random.default_rng(0).integers(0, len(windows), (DRAWS, len(windows)))
    elsewhere = grid[coarse[:, drawn].sum(axis=2).argmax(axis=0)]
    here = near[fine[:, drawn].sum(axis=2).argmax(axis=0)]
    of_draws = np.where(np.abs(elsewhere - best_s) > 2 * STEP_S, elsewhere, here)
    low_s, high_s = (float(value) for value in np.percentile(of_draws, (2.5, 97.5)))
    if max(delay_s - low_s, high_s - delay_s) > TOLD_S:
        return None
    return TimeOffset(delay_s, (low_s, high_s), len(windows))


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
    at_s = window.time_s - delay_s
    if at_s[0] < time_s[0] or at_s[-1] > time_s[-1]:
        return 0.0
    f = np.column_stack([np.interp(at_s, time_s, column) for column in pose.T])
    directions, size, _ = np.linalg.svd(f - f.mean(axis=0), full_matrices=False)
    taken = directions[:, : min(MOST_DIRECTIONS, int((size > LEAST_WAY_M * np.sqrt(len(f))).sum()))]
    explained = ((taken.T @ window.ways_px) ** 2).reshape(-1, len(window.places_px), 2).sum(axis=(0, 2))
    total, noise = window.total_px2, 2 * len(f) * NOISE_PX**2
    return -len(f) * float(np.log((total - explained + noise) / (total + noise)).mean())
