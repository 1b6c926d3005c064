"""How well the offset of a camera to an arm's joints is found: drawn sessions, offsets from -3 to 3 s, jittered clocks.

    python -m benchmarks.time_offset [--seeds 1 9] [--seconds 60]

An instrument goes from place to place at random, rests now and then, and is drawn over tissue with noise; in some a
second instrument stands in view. Both clocks jitter by 3 ms. Aimed at: within 10 ms wherever it is told.
"""

import argparse
import dataclasses
import sys

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from benchmarks.tool_tip import IN_MM, Case, backdrop_of, case, joints_in_view
from shared.calibration.time_offset import TimeOffset, ToolMotion, time_offset, windows_of
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER as PSM
from shared.rendering.sensor import Sensor, expose, grain
from shared.rendering.tool_view import Instrument, draw_solids, solids_of

HZ, JITTER_S, MARGIN_S, LARGEST_S = 30.0, 0.003, 5.0, 3.0
HALF = dataclasses.replace(
    IN_MM,
    image_width=IN_MM.image_width // 2,
    image_height=IN_MM.image_height // 2,
    fx_px=IN_MM.fx_px / 2,
    fy_px=IN_MM.fy_px / 2,
    cx_px=IN_MM.cx_px / 2 - 0.25,
    cy_px=IN_MM.cy_px / 2 - 0.25,
)
"""What is seen is looked at half as wide anyway."""


class Wandering:
    """Joints that go from place to place, at rest in each, some for longer."""

    def __init__(self, one: Case, seconds: float, rng: np.random.Generator) -> None:
        count = int(seconds) + 20
        self._at_s = np.cumsum(rng.uniform(1.0, 3.0, count)) - 2 * MARGIN_S
        self._joints = np.stack([joints_in_view(rng, one.T_true) for _ in range(count)])
        for i in np.flatnonzero(rng.random(count - 1) < 0.25):
            self._joints[i + 1] = self._joints[i]

    def at(self, time_s: float) -> Float64[np.ndarray, "6"]:
        """Where they are, with a smooth beginning and end of each way."""
        i = int(np.clip(np.searchsorted(self._at_s, time_s) - 1, 0, len(self._at_s) - 2))
        share = np.clip((time_s - self._at_s[i]) / (self._at_s[i + 1] - self._at_s[i]), 0, 1)
        way = self._joints[i + 1] - self._joints[i]
        return self._joints[i] + (10 * share**3 - 15 * share**4 + 6 * share**5) * way


def tried(seed: int, seconds: float) -> tuple[float, TimeOffset | None]:
    """The offset of a drawn session, and what was found."""
    one, rng = case(seed), np.random.default_rng([seed, 33])
    wandering, delay_s = Wandering(one, seconds, rng), rng.uniform(-LARGEST_S, LARGEST_S)
    seen_s = np.arange(0, seconds, 1 / HZ)
    stamps_s = np.maximum.accumulate(seen_s + rng.normal(0, JITTER_S, len(seen_s)))
    windows = list(windows_of((at, _image(one, wandering, t)) for at, t in zip(stamps_s.tolist(), seen_s, strict=True)))
    true_s = np.arange(-MARGIN_S, seconds + MARGIN_S, 0.01)
    measured_s = np.sort(true_s - delay_s + rng.normal(0, JITTER_S, len(true_s)))
    poses = np.stack([PSM.forward(wandering.at(t)) for t in true_s])
    motion = ToolMotion(measured_s, poses, np.array([one.jaw_at(t) for t in true_s]))
    return delay_s, time_offset(windows, motion)


def _image(one: Case, wandering: Wandering, at_s: float) -> UInt8[np.ndarray, "h w 3"]:
    behind = cv2.resize(backdrop_of(*one.background).left_bgr, (HALF.image_width, HALF.image_height))
    image = np.asarray(behind, np.uint8)
    if one.other:
        image = draw_solids(image, HALF, list(one.other), Instrument(), 0.0, one.seed + 9)[0]
    solids = solids_of(one.T_true, PSM.forward(wandering.at(at_s)), one.jaw_at(at_s), one.tool)
    image = draw_solids(image, HALF, solids, one.tool, 0.0, one.seed)[0]
    return expose(image, Sensor(), grain(image.shape[:2], round(1e3 * at_s) + 100_000 * one.seed))


def main(arguments: list[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.time_offset", description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(1, 9), metavar=("FROM", "TO"))
    parser.add_argument("--seconds", type=float, default=60.0)
    chosen = parser.parse_args(arguments)
    print("| seed | offset ms | found: off by ms | 95 % interval ms | windows |\n|---|---|---|---|---|")
    off, held, sessions = list[float](), 0, 0
    for seed in range(*chosen.seeds):
        delay_s, found = tried(seed, chosen.seconds)
        sessions += 1
        if found is None:
            print(f"| {seed} | {1e3 * delay_s:.0f} | too little motion to tell | | |", flush=True)
            continue
        off.append(1e3 * (found.delay_s - delay_s))
        low, high = (1e3 * (value - delay_s) for value in found.interval_s)
        held += low <= 0 <= high
        said = f"{off[-1]:+.1f} | {low:+.0f} to {high:+.0f} | {found.windows}"
        print(f"| {seed} | {1e3 * delay_s:.0f} | {said} |", flush=True)
    if off:
        worst = max(map(abs, off))
        print(f"told in {len(off)} of {sessions}; at most {worst:.1f} ms off; within the interval {held} of {len(off)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
