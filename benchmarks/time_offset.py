"""How well the offset of a camera to an arm's joints is found: drawn sessions, offsets from -3 to 3 s, jittered clocks.

    python -m benchmarks.time_offset [--seeds 1 9] [--seconds 60]

An instrument goes from place to place at random, rests now and then, and is drawn over tissue with noise; in some a
second instrument stands in view. Both clocks jitter by 3 ms. Aimed at: within 10 ms wherever it is told.
"""

import dataclasses
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import tyro
from jaxtyping import Float64, UInt8

from agents.simulator.agent import ENDOSCOPE
from agents.tool_tracker.outline import outline
from agents.tool_tracker.tubes import FINGER, tubes
from benchmarks.tables import CONSOLE, Row, print_rows, shown
from shared.calibration.time_offset import ToolMotion, time_offset, windows_of
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER as PSM
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rendering.path_traced.solids import Solid
from shared.rendering.render import render_backdrop
from shared.rendering.sensor import Sensor, expose, grain
from shared.rendering.tool_view import Instrument, draw_solids, solids_of
from shared.rigid_transforms import apply

HZ, JITTER_S, MARGIN_S, LARGEST_S = 30.0, 0.003, 5.0, 3.0
T_CAMERA_BASE = SIMULATED_BASES["psm1"]
TIP = np.array([[0.0, 0.0, 0.0102]])
LOWER, UPPER = (-0.09, -0.06, 0.15, -1.2, -0.8, -0.8), (0.1, 0.06, 0.185, 1.2, 0.8, 0.8)
"""Of the joints: the tip is in view."""
IN_MM = dataclasses.replace(ENDOSCOPE, baseline=1e3 * ENDOSCOPE.baseline, metres_per_unit=1e-3)
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


@dataclass(frozen=True)
class Options:
    """Which sessions."""

    seeds: tuple[int, int] = (1, 9)
    """First, and one past the last."""
    seconds: float = 60.0


def main() -> None:
    """Print the table."""
    options = tyro.cli(Options, description=__doc__)
    rows: list[Row] = []
    for seed in range(*options.seeds):
        rows.append(tried(seed, options.seconds))
        CONSOLE.print(", ".join(f"{name} {shown(value)}" for name, value in rows[-1].items()))
    print_rows("offsets of drawn sessions, in ms", rows)
    if told := [row for row in rows if row["off"] is not None]:
        worst = max(abs(row["off"]) for row in told)
        held = sum(row["low"] <= 0 <= row["high"] for row in told)
        count = f"told in {len(told)} of {len(rows)}"
        CONSOLE.print(f"{count}; at most {worst:.1f} ms off; within the 95 % interval {held} of {len(told)}")


def tried(seed: int, seconds: float) -> Row:
    """The offset of a drawn session, and how far the one that was found and its 95 % interval are off; None untold."""
    session, rng = Session(seed, seconds), np.random.default_rng([seed, 33])
    delay_s, seen_s = rng.uniform(-LARGEST_S, LARGEST_S), np.arange(0, seconds, 1 / HZ)
    stamps_s = np.maximum.accumulate(seen_s + rng.normal(0, JITTER_S, len(seen_s)))
    windows = list(windows_of((at, session.image(t)) for at, t in zip(stamps_s.tolist(), seen_s, strict=True)))
    true_s = np.arange(-MARGIN_S, seconds + MARGIN_S, 0.01)
    measured_s = np.sort(true_s - delay_s + rng.normal(0, JITTER_S, len(true_s)))
    poses = np.stack([PSM.forward(session.joints(t)) for t in true_s])
    found = time_offset(windows, ToolMotion(measured_s, poses, np.array([session.jaw_rad(t) for t in true_s])))
    names = "off", "low", "high"
    off = [None] * 3 if found is None else [1e3 * (one - delay_s) for one in (found.delay_s, *found.interval_s)]
    return {"seed": seed, "offset": 1e3 * delay_s, **dict(zip(names, off, strict=True))}


class Session:
    """An instrument that goes from place to place, at rest in each, for longer in some; drawn over tissue."""

    def __init__(self, seed: int, seconds: float) -> None:
        rng, count = np.random.default_rng([seed, 77]), int(seconds) + 20
        self._seed, self._phase = seed, rng.uniform(0, 2 * np.pi)
        self._at_s = np.cumsum(rng.uniform(1.0, 3.0, count)) - 2 * MARGIN_S
        self._joints = np.stack([joints_in_view(rng) for _ in range(count)])
        for i in np.flatnonzero(rng.random(count - 1) < 0.25):
            self._joints[i + 1] = self._joints[i]
        self._tool = Instrument(
            shaft_metal=str(rng.choice(["dark", "steel", "bright"])),
            gloss=float(rng.uniform(0.3, 1.0)),
            stains=int(rng.integers(0, 5)),
        )
        self._behind = str(rng.choice(["rendered", "rendered", "tissue"])), int(rng.integers(1, 5))
        self._other = other_instrument(rng) if seed % 4 == 0 else []

    def joints(self, at_s: float) -> Float64[np.ndarray, "6"]:
        """Where they are, with a smooth beginning and end of each way."""
        i = int(np.clip(np.searchsorted(self._at_s, at_s) - 1, 0, len(self._at_s) - 2))
        share = np.clip((at_s - self._at_s[i]) / (self._at_s[i + 1] - self._at_s[i]), 0, 1)
        way = self._joints[i + 1] - self._joints[i]
        return self._joints[i] + (10 * share**3 - 15 * share**4 + 6 * share**5) * way

    def jaw_rad(self, at_s: float) -> float:
        """Opening and closing."""
        return 0.5 + 0.4 * float(np.sin(1.7 * at_s + self._phase))

    def image(self, at_s: float) -> UInt8[np.ndarray, "h w 3"]:
        """What the left eye sees then."""
        image = background(*self._behind)
        if self._other:
            image = draw_solids(image, HALF, self._other, Instrument(), 0.0, self._seed + 9)[0]
        solids = solids_of(T_CAMERA_BASE, PSM.forward(self.joints(at_s)), self.jaw_rad(at_s), self._tool)
        image = draw_solids(image, HALF, solids, self._tool, 0.0, self._seed)[0]
        return expose(image, Sensor(), grain(image.shape[:2], round(1e3 * at_s) + 100_000 * self._seed))


def joints_in_view(rng: np.random.Generator) -> Float64[np.ndarray, "6"]:
    """Joints with the tip in view, and a part of the fingers not behind the shaft."""
    while True:
        joints = rng.uniform(LOWER, UPPER)
        T_base_tool = PSM.forward(joints)
        tip = apply(T_CAMERA_BASE @ T_base_tool, TIP)[0]
        u = ENDOSCOPE.fx_px * tip[:2] / tip[2] + (ENDOSCOPE.cx_px, ENDOSCOPE.cy_px)
        seen = outline(ENDOSCOPE, tubes(T_CAMERA_BASE, T_base_tool, 0.5), 0.0)
        if (seen.part == FINGER).sum() >= 15 and (u > 60).all() and (u < (900, 480)).all() and 0.07 < tip[2] < 0.105:
            return joints


def other_instrument(rng: np.random.Generator) -> list[Solid]:
    """A second arm's, from the other side."""
    joints = np.array((*rng.uniform((-0.1, -0.06, 0.15), (-0.02, 0.06, 0.175)), 0.3, 0.2, -0.2))
    metal = str(rng.choice(["dark", "steel"]))
    return solids_of(SIMULATED_BASES["psm2"], PSM.forward(joints), 0.3, Instrument(shaft_metal=metal))


@lru_cache(maxsize=8)
def background(kind: str, seed: int) -> UInt8[np.ndarray, "h w 3"]:
    """Tissue, half as wide."""
    behind = render_backdrop(IN_MM, kind, 95.0 + 3.0 * seed, seed).left_bgr
    return np.asarray(cv2.resize(behind, (HALF.image_width, HALF.image_height)), np.uint8)


if __name__ == "__main__":
    main()
