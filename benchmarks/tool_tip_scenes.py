"""Simulated views of an instrument whose place is wrongly told, for benchmarks/tool_tip.py and tests."""

import dataclasses
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.simulator.agent import ENDOSCOPE
from agents.tool_tracker.correction import about
from agents.tool_tracker.outline import outline
from agents.tool_tracker.tubes import FINGER, tubes
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER as PSM
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import apply
from shared.scene.backdrop import Backdrop
from shared.scene.path_traced.solids import Solid
from shared.scene.render import render_backdrop
from shared.scene.sensor import Sensor, expose, grain
from shared.scene.tool_view import Instrument, draw_solids, solids_of

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
    waypoints = np.stack([_in_view(rng, T_true) for _ in range(WAYPOINTS)])
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
    backdrop = _backdrop(*one.background)
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


def _in_view(rng: np.random.Generator, T_camera_base: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "6"]:
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
def _backdrop(kind: str, seed: int) -> Backdrop:
    return render_backdrop(IN_MM, kind, 95.0 + 3.0 * seed, seed)


def _unit(rng: np.random.Generator) -> Float64[np.ndarray, "3"]:
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)
