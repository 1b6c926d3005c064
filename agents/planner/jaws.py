"""The fingers of the jaws as points of their outlines, and how far those stay before the tissue on the way of a grasp.

The tool frame sits on the jaw's pin, x along the pin and z along the closed fingers. Each finger is a bar as long as
FINGER_M, of constant width along the pin and of constant thickness, whose inner face is turned about the pin by half
the jaw angle. The outline is looked at on both faces, at both edges and in their middle, the more densely the nearer
to the tip.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.tissue import Tissue, clearance
from schemas.messages import Phase
from shared.kinematics.psm import FINGER_M
from shared.rigid_transforms import apply

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
