"""How far an instrument's tip is from where it is taken to be, once it was corrected from the images; many seeds.

    python -m benchmarks.tool_tip [--seeds 40] [--first 1000] [--seconds 3] [--json FILE]

Each seed draws an instrument (dark, steel or bright shaft, highlights, blood), tissue behind it, motion, a tip that is
8 mm and 3 degrees from where registration and joints have it, errors of each joint that change as the arm moves, noise
of the sensor, and in every second seed what hides parts of it: a flap of tissue, or another instrument. It is looked
at every 0.2 s while the tool is followed, and every 0.4 s while it is searched for, which takes longer. Told are the
error of the fingers' tip, whether it keeps to its covariance (normalised squared error over 3 degrees of freedom: 1 is
right, above is too sure), and what the estimator says of itself.
"""

import argparse
import dataclasses
import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.simulator.agent import ENDOSCOPE
from agents.tool_tracker.correction import about
from agents.tool_tracker.outline import outline
from agents.tool_tracker.refinement import View
from agents.tool_tracker.search import soft_pair
from agents.tool_tracker.track import Following, begun, followed
from agents.tool_tracker.tubes import FINGER, tubes
from shared.clock import processor_s
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER as PSM
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rendering.backdrop_files import Backdrop
from shared.rendering.path_traced.solids import Solid
from shared.rendering.render import render_backdrop
from shared.rendering.sensor import Sensor, expose, grain
from shared.rendering.tool_view import Instrument, draw_solids, solids_of
from shared.rigid_transforms import apply

WAYPOINTS = 5
PERIOD_S = 1.0
OFF_M, OFF_RAD = 0.008, np.radians(3.0)
JOINT_ERRORS = np.array((0.003, 0.003, 0.0004, 0.02, 0.02, 0.02))
"""Amplitudes, in radians and metres: half a millimetre at the tip from yaw and pitch, a degree of the wrist."""
IN_MM = dataclasses.replace(ENDOSCOPE, baseline=1e3 * ENDOSCOPE.baseline, metres_per_unit=1e-3)
TIP = np.array([[0.0, 0.0, 0.0102]])
FLAP_DEPTH_MM = 80.0
Images = tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]


@dataclass(frozen=True, eq=False)
class Case:
    """One seed. `T_camera_base` is as registered, `T_true` as it is; `told` says what is in it."""

    seed: int
    told: str
    T_camera_base: Float64[np.ndarray, "4 4"]
    T_true: Float64[np.ndarray, "4 4"]
    waypoints: Float64[np.ndarray, "w 6"]
    phase: Float64[np.ndarray, "6"]
    tool: Instrument
    background: tuple[str, int]
    hides: str
    flap_px: Float64[np.ndarray, "k 2"]
    other: tuple[Solid, ...]

    def joints_at(self, at_s: float) -> Float64[np.ndarray, "6"]:
        """As measured: from waypoint to waypoint, at rest in each."""
        i, share = divmod(at_s / PERIOD_S, 1.0)
        one, other = self.waypoints[int(i) % WAYPOINTS], self.waypoints[(int(i) + 1) % WAYPOINTS]
        return one + (0.5 - 0.5 * np.cos(np.pi * share)) * (other - one)

    def true_joints_at(self, at_s: float) -> Float64[np.ndarray, "6"]:
        """As they are: errors change with the joints' own motion, and are none at the beginning."""
        q = self.joints_at(at_s)
        swing = np.sin(20.0 * q + self.phase) - np.sin(20.0 * self.waypoints[0] + self.phase)
        return q + 0.5 * JOINT_ERRORS * swing

    def jaw_at(self, at_s: float) -> float:
        """Opening and closing."""
        return 0.5 + 0.4 * float(np.sin(1.7 * at_s + self.phase[0]))


def case(seed: int) -> Case:
    """The case of a seed."""
    rng = np.random.default_rng([seed, 77])
    T_true = SIMULATED_BASES["psm1"]
    waypoints = np.stack([joints_in_view(rng, T_true) for _ in range(WAYPOINTS)])
    tip = apply(T_true @ PSM.forward(waypoints[0]), TIP)[0]
    twist = np.concatenate([size * _unit(rng) for size in (OFF_M, OFF_RAD)])
    tool = Instrument(
        shaft_radius=4.2 * rng.normal(1, 0.005),
        finger_length=10.2 * rng.normal(1, 0.02),
        finger_half_width=1.9 * rng.normal(1, 0.08),
        finger_thickness=1.7 * rng.normal(1, 0.08),
        shaft_metal=str(rng.choice(["dark", "steel", "bright"])),
        gloss=float(rng.uniform(0.3, 1.0)),
        stains=int(rng.integers(0, 5)),
    )
    kind = str(rng.choice(["rendered", "rendered", "tissue"]))
    background = (kind, int(rng.integers(1, 5)))
    hides = "" if seed % 2 else str(rng.choice(["flap", "instrument"]))
    return Case(
        seed,
        f"{tool.shaft_metal}, {kind} {background[1]}{', ' + hides if hides else ''}",
        about(tip, twist) @ T_true,
        T_true,
        waypoints,
        rng.uniform(0, 2 * np.pi, 6),
        tool,
        background,
        hides,
        _flap(rng, T_true, waypoints[0]),
        _other(rng) if hides == "instrument" else (),
    )


def pair_at(one: Case, at_s: float) -> tuple[Images, Float64[np.ndarray, "4 4"], Float64[np.ndarray, "3"]]:
    """Both images, `T_base_tool` as the joints tell it, and where the tip is before the camera, metres."""
    solids = solids_of(one.T_true, PSM.forward(one.true_joints_at(at_s)), one.jaw_at(at_s), one.tool)
    backdrop = backdrop_of(*one.background)
    images = []
    for k, (behind, eye_x) in enumerate(((backdrop.left_bgr, 0.0), (backdrop.right_bgr, IN_MM.baseline))):
        image = behind
        if one.other:
            image = draw_solids(image, IN_MM, list(one.other), Instrument(), eye_x, one.seed + 9)[0]
        image = draw_solids(image, IN_MM, solids, one.tool, eye_x, one.seed)[0]
        if one.hides == "flap":
            image = _with_flap(image, behind, one.flap_px - (IN_MM.fx_px * eye_x / FLAP_DEPTH_MM, 0.0))
        images.append(expose(image, Sensor(), grain(image.shape[:2], 1000 * one.seed + 2 * round(10 * at_s) + k)))
    tip = apply(one.T_true @ PSM.forward(one.true_joints_at(at_s)), TIP)[0]
    return (images[0], images[1]), PSM.forward(one.joints_at(at_s)), tip


def joints_in_view(rng: np.random.Generator, T_camera_base: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "6"]:
    """Joints with the tip in view, and a part of the fingers not behind the shaft."""
    lower, upper = (-0.09, -0.06, 0.15, -1.2, -0.8, -0.8), (0.1, 0.06, 0.185, 1.2, 0.8, 0.8)
    while True:
        joints = rng.uniform(lower, upper)
        T_base_tool = PSM.forward(joints)
        tip = apply(T_camera_base @ T_base_tool, TIP)[0]
        u = ENDOSCOPE.fx_px * tip[:2] / tip[2] + (ENDOSCOPE.cx_px, ENDOSCOPE.cy_px)
        seen = outline(ENDOSCOPE, tubes(T_camera_base, T_base_tool, 0.5), 0.0)
        if (seen.part == FINGER).sum() >= 15 and (u > 60).all() and (u < (900, 480)).all() and 0.07 < tip[2] < 0.105:
            return joints


def _flap(rng: np.random.Generator, T: Float64[np.ndarray, "4 4"], joints: Float64[np.ndarray, "6"]) -> np.ndarray:
    """The corners of a flap of tissue over the shaft, in the left image."""
    place = tubes(T, PSM.forward(joints), 0.5)[0].places[int(rng.integers(4, 14))]
    centre = ENDOSCOPE.fx_px * place[:2] / place[2] + (ENDOSCOPE.cx_px, ENDOSCOPE.cy_px)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    size = rng.uniform(25, 60) * rng.uniform(0.7, 1.3, 12)
    return centre + rng.normal(0, 15, 2) + size[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))


def _with_flap(
    image: UInt8[np.ndarray, "h w 3"], behind: UInt8[np.ndarray, "h w 3"], corners: np.ndarray
) -> np.ndarray:
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.rint(16 * corners).astype(np.int32)], 255, cv2.LINE_AA, 4)
    share = cv2.GaussianBlur(mask, (0, 0), 1.2)[..., None] / 255.0
    return np.clip(share * np.roll(behind, (97, -180), (0, 1)) + (1 - share) * image, 0, 255).astype(np.uint8)


def _other(rng: np.random.Generator) -> tuple[Solid, ...]:
    """A second arm's instrument, from the other side."""
    metal = str(rng.choice(["dark", "steel"]))
    joints = np.array((rng.uniform(-0.02, 0.06), rng.uniform(-0.06, 0.06), rng.uniform(0.15, 0.175), 0.3, 0.2, -0.2))
    joints[0] -= 0.08
    return tuple(solids_of(SIMULATED_BASES["psm2"], PSM.forward(joints), 0.3, Instrument(shaft_metal=metal)))


@lru_cache(maxsize=8)
def backdrop_of(kind: str, seed: int) -> Backdrop:
    return render_backdrop(IN_MM, kind, 95.0 + 3.0 * seed, seed)


def _unit(rng: np.random.Generator) -> Float64[np.ndarray, "3"]:
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)


GOAL_M, WRONG_M = 0.001, 0.002
NO_EYES = ()
FOLLOWING_S, SEARCHING_S = 0.2, 0.4


@dataclasses.dataclass(frozen=True)
class Moment:
    """One view of one seed: errors in metres, NaN where nothing is told."""

    at_s: float
    error_m: float
    uncorrected_m: float
    nees: float
    state: str
    processor_ms: float


def measured(one: Case, seconds: float) -> list[Moment]:
    """All views of a case."""
    track, told, at_s, waited_s = None, list[Moment](), 0.0, FOLLOWING_S
    while at_s <= seconds + 1e-9:
        images, T_base_tool, tip = pair_at(one, at_s)
        began = processor_s()
        soft = soft_pair(*images)
        view = View(ENDOSCOPE, NO_EYES, one.T_camera_base, T_base_tool, one.jaw_at(at_s))
        track = followed(track or begun(view), soft, view, waited_s, one.seed)
        took = 1e3 * (processor_s() - began)
        before = apply(one.T_camera_base @ T_base_tool, TIP)[0]
        error, nees = np.nan, np.nan
        if track.state is Following.FOLLOWED and track.correction is not None:
            found = apply(track.correction.matrix, before[None])[0]
            covariance = track.correction.point_covariance(found)
            error = float(np.linalg.norm(found - tip))
            nees = float((found - tip) @ np.linalg.solve(covariance, found - tip)) / 3
        told.append(Moment(at_s, error, float(np.linalg.norm(before - tip)), nees, track.state.name, took))
        waited_s = FOLLOWING_S if track.state is Following.FOLLOWED else SEARCHING_S
        at_s += waited_s
    return told


def newest(run: list[Moment], at_s: float) -> Moment:
    """What is known by then."""
    return [moment for moment in run if moment.at_s <= at_s + 1e-9][-1]


def table(runs: dict[int, list[Moment]]) -> list[str]:
    """Lines of a table over time, and the sentences below it."""
    head = "| after s | uncorrected mm (median) | followed | error mm: median | 95 % | worst | NEES (mean) |"
    lines = [head, "|---|---|---|---|---|---|---|"]
    end_s = int(max(run[-1].at_s for run in runs.values()))
    for at_s in range(end_s + 1):
        moments = [newest(run, at_s) for run in runs.values()]
        errors = np.array([m.error_m for m in moments])
        seen = np.isfinite(errors)
        nees = np.nanmean([m.nees for m in moments]) if seen.any() else np.nan
        mm = 1e3 * errors[seen] if seen.any() else np.array([np.nan])
        before = 1e3 * np.median([m.uncorrected_m for m in moments])
        lines.append(
            f"| {at_s} | {before:.2f} | {seen.sum()} of {len(seen)} | {np.median(mm):.2f} | "
            f"{np.percentile(mm, 95):.2f} | {mm.max():.2f} | {nees:.2f} |"
        )
    everything = [m for run in runs.values() for m in run]
    last = [run[-1] for run in runs.values()]
    within = sum(m.error_m <= GOAL_M for m in last)
    silent = [seed for seed, run in runs.items() if any(m.error_m > WRONG_M for m in run)]
    lost = [seed for seed, run in runs.items() if run[-1].state != Following.FOLLOWED.name]
    search = [m.processor_ms for m in everything if m.state == Following.SEARCHING.name]
    follow = [m.processor_ms for m in everything if m.state == Following.FOLLOWED.name]
    return [
        *lines,
        f"{within} of {len(last)} within {1e3 * GOAL_M:g} mm at the end; not followed, and told so: {lost or 'none'}",
        f"followed while more than {1e3 * WRONG_M:g} mm off at any time: {silent or 'none'}",
        f"processor time a view: searching {median(search):.0f} ms, following {median(follow):.0f} ms",
    ]


def median(values: list[float]) -> float:
    """NaN of none."""
    return float(np.median(values)) if values else float("nan")


def main() -> None:
    """Print the table; write all of it where asked."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seeds", type=int, default=40)
    options.add_argument("--first", type=int, default=1000)
    options.add_argument("--seconds", type=float, default=3.0)
    options.add_argument("--json", type=Path)
    asked = options.parse_args()
    runs: dict[int, list[Moment]] = {}
    for seed in range(asked.first, asked.first + asked.seeds):
        one = case(seed)
        runs[seed] = measured(one, asked.seconds)
        last = runs[seed][-1]
        print(
            f"{seed}: {one.told}: {last.state.lower()}, {1e3 * last.error_m:.2f} mm, NEES {last.nees:.1f}", flush=True
        )
    print("\n".join(table(runs)))
    if asked.json is not None:
        told = {seed: [dataclasses.asdict(moment) for moment in run] for seed, run in runs.items()}
        asked.json.write_text(json.dumps(told))


if __name__ == "__main__":
    main()
