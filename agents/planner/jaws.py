"""The fingers of the jaws as points of their outlines, and how far those stay before the tissue on the way of a grasp.

The tool frame sits on the jaw's pin, x along the pin and z along the closed fingers. Each finger is a bar as long as
FINGER_M, of constant width along the pin and of constant thickness, whose inner face is turned about the pin by half
the jaw angle. The outline is looked at on both faces, at both edges and in their middle, the more densely the nearer
to the tip.

The whole instrument is four capsules: two fingers, the link of the wrist, and the shaft. The shaft passes through the
remote centre, the origin of the base, and the wrist's link is at right angles to the pin and in one plane with it
(shared/kinematics/psm.py), so a pose of the tool tells of all of them.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.tissue import Tissue, clearance
from schemas.messages import Phase
from shared.kinematics.psm import FINGER_M, LARGE_NEEDLE_DRIVER, WRIST_YAW
from shared.rigid_transforms import apply, inverse

ALONG = (0.0, 0.3, 0.6, 0.8, 0.9, 1.0)
"""Shares of a finger's length at which its outline is looked at."""
CLOSING_STEPS, APPROACH_STEPS = 5, 5


@dataclass(frozen=True)
class Pass:
    """What the jaws do at each pose of the tool: angles at which they stand there, and how far back they come from.

    Fields:
        phase: what each pair of these belongs to.
    """

    jaw_rad: Float64[np.ndarray, "k"]
    back_m: Float64[np.ndarray, "k"]
    phase: tuple[Phase, ...]


@dataclass(frozen=True)
class Nearest:
    """For each pose what is nearest to the tissue, or deepest in it, of all that the jaws pass there.

    Fields:
        bound_m: the clearance less so many deviations; inf where nothing is known.
        clearance_m, deviation_m, place_camera: of the place where that is least; NaN where nothing is known.
        step: which of the steps of the pass it belongs to.
        known: how many of the places passed have known tissue before or behind them, as a share.
    """

    bound_m: Float64[np.ndarray, "*n"]
    clearance_m: Float64[np.ndarray, "*n"]
    deviation_m: Float64[np.ndarray, "*n"]
    place_camera: Float64[np.ndarray, "*n 3"]
    step: np.ndarray
    known: Float64[np.ndarray, "*n"]


def capture_pass(config: PlannerConfig) -> Pass:
    """Open jaws that come to the thread along the approach, and close partly there."""
    back_m = np.linspace(config.standoff_m, 0.0, APPROACH_STEPS, endpoint=False)
    jaw = np.radians(np.linspace(config.open_deg, config.slide_deg, CLOSING_STEPS))
    opened = np.full(APPROACH_STEPS, jaw[0])
    phases = (*[Phase.APPROACH] * (APPROACH_STEPS + 1), *[Phase.CAPTURE] * (CLOSING_STEPS - 1))
    return Pass(np.concatenate((opened, jaw)), np.concatenate((back_m, np.zeros(CLOSING_STEPS))), phases)


def slide_pass(config: PlannerConfig) -> Pass:
    """Jaws that are partly closed."""
    return Pass(np.radians([config.slide_deg]), np.zeros(1), (Phase.SLIDE,))


def grasp_pass(config: PlannerConfig) -> Pass:
    """Jaws that close on the thread, and lift off."""
    jaw = np.radians(np.linspace(config.slide_deg, config.closed_deg, CLOSING_STEPS))
    back_m = np.append(np.zeros(CLOSING_STEPS), config.retreat_m)
    return Pass(np.append(jaw, jaw[-1]), back_m, (*[Phase.GRASP] * CLOSING_STEPS, Phase.RETREAT))


def aside_pass(config: PlannerConfig) -> Pass:
    """Closed jaws after the lift."""
    return Pass(np.radians([config.closed_deg]), np.zeros(1), (Phase.RETREAT,))


def nearest_to_tissue(
    tissue: Tissue, T_camera_tool: Float64[np.ndarray, "*n 4 4"], passed: Pass, config: PlannerConfig
) -> Nearest:
    """What of the jaws is nearest to the tissue where they pass, for each pose on the thread."""
    *shape, _, _ = T_camera_tool.shape
    stands = zip(passed.jaw_rad, passed.back_m, strict=True)
    tool = np.stack([outline(float(jaw), config) - (0, 0, back) for jaw, back in stands])
    outlined = tool.shape[1]
    places = apply(T_camera_tool.reshape(-1, 1, 4, 4), tool.reshape(1, -1, 3))[:, 0]
    off, deviation = clearance(tissue, places)
    known = np.isfinite(off)
    bound = np.where(known, off - config.sigmas * deviation, np.inf)
    least = np.argmin(bound, axis=1)

    def there(values: np.ndarray) -> np.ndarray:
        return np.take_along_axis(values, least.reshape(-1, *[1] * (values.ndim - 1)), axis=1)[:, 0].reshape(
            *shape, *values.shape[2:]
        )

    return Nearest(
        bound_m=there(bound),
        clearance_m=there(np.where(known, off, np.nan)),
        deviation_m=there(np.where(known, deviation, np.nan)),
        place_camera=there(places),
        step=(least // outlined).reshape(shape),
        known=known.mean(axis=1).reshape(shape),
    )


def outline(jaw_rad: float, config: PlannerConfig) -> Float64[np.ndarray, "p 3"]:
    """Points of the outlines of both fingers, in the tool frame."""
    half = 0.5 * jaw_rad
    along, across, out = np.meshgrid(
        FINGER_M * np.array(ALONG),
        config.finger_width_m * np.array([-0.5, 0.0, 0.5]),
        config.finger_thickness_m * np.array([0.0, 1.0]),
        indexing="ij",
    )
    y = along * np.sin(half) + out * np.cos(half)
    z = along * np.cos(half) - out * np.sin(half)
    finger = np.stack((across.ravel(), y.ravel(), z.ravel()), axis=1)
    return np.concatenate((finger, finger * (1.0, -1.0, 1.0)))


FINGER_RADIUS_M, WRIST_RADIUS_M, SHAFT_RADIUS_M = 0.001, 0.0035, 0.0042
SHAFT_M = 0.06
"""How much of the shaft can come near the thread."""


@dataclass(frozen=True)
class Capsules:
    """At each of k poses, c capsules from start to end, in the camera frame."""

    start: Float64[np.ndarray, "k c 3"]
    end: Float64[np.ndarray, "k c 3"]
    radius_m: Float64[np.ndarray, "c"]


def instrument_at(
    T_camera_tool: Float64[np.ndarray, "k 4 4"], jaw_rad: Float64[np.ndarray, "k"], T_camera_base: np.ndarray
) -> Capsules:
    """The capsules of an instrument whose base stands there."""
    half = 0.5 * jaw_rad[:, None] * np.array([1.0, -1.0])
    tips_tool = FINGER_M * np.stack((np.zeros_like(half), np.sin(half), np.cos(half)), axis=-1)
    tips = np.einsum("kij,kfj->kfi", T_camera_tool[:, :3, :3], tips_tool) + T_camera_tool[:, None, :3, 3]
    T_base_tool = inverse(T_camera_base) @ T_camera_tool
    pin, axis = T_base_tool[:, :3, 3], T_base_tool[:, :3, 0]
    wrist = pin - LARGE_NEEDLE_DRIVER.links[WRIST_YAW].a * _unit(pin - (pin * axis).sum(axis=1, keepdims=True) * axis)
    shaft = wrist - SHAFT_M * _unit(wrist)
    pin, wrist, shaft = (apply(T_camera_base, point) for point in (pin, wrist, shaft))
    return Capsules(
        start=np.stack((pin, pin, pin, wrist), axis=1),
        end=np.stack((tips[:, 0], tips[:, 1], wrist, shaft), axis=1),
        radius_m=np.array([FINGER_RADIUS_M, FINGER_RADIUS_M, WRIST_RADIUS_M, SHAFT_RADIUS_M]),
    )


def clearances(capsules: Capsules, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "k n"]:
    """From each point to the nearest surface of the capsules at each pose; negative within one."""
    step = capsules.end - capsules.start
    squared = np.maximum((step**2).sum(axis=-1), 1e-18)
    # |p - a - x step|^2 expanded, so that nothing of size k c n 3 is made
    along = np.einsum("kcj,nj->kcn", step, points) - np.einsum("kcj,kcj->kc", step, capsules.start)[..., None]
    share = np.clip(along / squared[..., None], 0.0, 1.0)
    off = (points**2).sum(axis=-1) + ((capsules.start**2).sum(axis=-1))[..., None]
    off = off - 2.0 * np.einsum("kcj,nj->kcn", capsules.start, points)
    distance = np.sqrt(np.maximum(off - 2.0 * share * along + share**2 * squared[..., None], 0.0))
    return (distance - capsules.radius_m[:, None]).min(axis=1)


def _unit(vectors: Float64[np.ndarray, "k 3"]) -> Float64[np.ndarray, "k 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
