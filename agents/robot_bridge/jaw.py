"""How an arm's jaw is told to close, and when it counts as closed.

A plan's jaw angle is how far the fingers are open: at 0 they are closed. Instruments close elsewhere, as a calibration
finds (shared/calibration/jaw): there the jaw is measured at z, and its set point is t. For a plan's angle a it is

    t + a - s max(0, 1 - a / s)   for a > 0,      t + a - s   for a ≤ 0,

which is t + a of an open jaw, and presses by s beyond the closing of a closed one. The squeeze s makes sure that the
fingers touch: three deviations of the closing, and as much as a joint that has arrived may be from its set point.
Waypoints are mapped before a motion is planned, so limits of angle, speed and jerk hold for what is sent.

A jaw that is told to be closed is measured at z, or is more open by no more than

    d + ARRIVED_RAD + 3 deviations,    d = 2 asin(r / l),

r being the radius of the thickest thread that is meant to be held, and l how far from the pin it may lie between the
fingers. Backlash is in the deviations: the calibration's closings took it up from the same side as a grasp does.

Without a calibration set points are a plan's own angles, and a jaw counts as closed where it follows at all.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.plans import Code, Refusal
from schemas.messages import GraspPlan
from shared.kinematics.psm import FINGER_M

if TYPE_CHECKING:
    # what reads files takes a while to load, and whoever reads a rig's configuration loads this
    from shared.calibration.jaw.file import JawZero

FOLLOWING_JAW_RAD = 0.3
"""Farther than this from where the jaw is measured, no set point is sent: as far as it goes at its greatest speed while
the tool turns by the angle that it may be off (execution.py) at its own."""
ARRIVED_RAD = 0.02
"""How near a joint is to where it was sent when it has arrived."""
SIGMAS = 3.0
THREAD_RADIUS_M = 0.0003
"""Of USP 2, 0.6 mm thick (USP <861>); planners have 0.4 mm."""
ROUNDING_RAD = 1e-6
OFF_M = 0.002
"""By how much the thread may lie nearer to the pin than planned: a registration is off by 1.5 mm, a tool by 0.7."""
DEEPEST_M = FINGER_M / 2
"""How far the tips of a plan reach beyond the thread, where it does not tell."""


@dataclass(frozen=True)
class Jaw:
    """An arm's jaw; without a calibration it closes at 0.

    Fields:
        closes_rad: measured there when it is closed.
        told_rad: the set point at which it closes.
        squeeze_rad: by how much it is told to close beyond that.
        spread_rad: three deviations of where it closes; None without a calibration.
    """

    closes_rad: float = 0.0
    told_rad: float = 0.0
    squeeze_rad: float = 0.0
    spread_rad: float | None = None

    @staticmethod
    def calibrated(zero: "JawZero | None") -> "Jaw":
        """As a calibration has it, or without one."""
        if zero is None:
            return UNCALIBRATED
        spread_rad = SIGMAS * zero.deviation_rad
        return Jaw(zero.closes_rad, zero.told_rad, spread_rad + ARRIVED_RAD, spread_rad)

    def set_points(self, planned_rad: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
        """What the jaw is told for a plan's angles."""
        if self.spread_rad is None:
            return planned_rad
        pressed = np.clip(1 - planned_rad / self.squeeze_rad, 0.0, 1.0)
        return self.told_rad + planned_rad - self.squeeze_rad * pressed

    def unreachable(self, limit: tuple[float, float]) -> Refusal | None:
        """Why the jaw cannot be told to close within its limits; None where it can."""
        closed_rad, (lower, upper) = self.told_rad - self.squeeze_rad, limit
        if self.spread_rad is None or lower <= closed_rad <= upper:
            return None
        told = f"to close, the jaw would be told to {closed_rad:.3g} rad by its calibration, outside {lower} to {upper}"
        return Refusal(Code.JAW_LIMIT, f"{told}: calibrate it anew, or take another instrument")

    def follows(self, measured_rad: float, sent_rad: float) -> bool:
        """Whether it is near its set point; told to close beyond its fingers' touch, it presses on what it holds."""
        there_rad = sent_rad + self.closes_rad - self.told_rad
        touching_rad = max(there_rad, self.closes_rad)
        return there_rad - FOLLOWING_JAW_RAD <= measured_rad <= touching_rad + FOLLOWING_JAW_RAD

    def told_to_close(self, sent_rad: float) -> bool:
        """Whether a set point is that of a closed jaw."""
        return sent_rad <= self.told_rad + ROUNDING_RAD

    def explained_rad(self, plan: GraspPlan) -> float:
        """By how much a jaw that is told to be closed may stay open."""
        if self.spread_rad is None:
            return FOLLOWING_JAW_RAD
        reach_m = DEEPEST_M if plan.depth_m is None else plan.depth_m
        from_pin_m = max(FINGER_M - reach_m - OFF_M, THREAD_RADIUS_M)
        holds_rad = 2 * math.asin(THREAD_RADIUS_M / from_pin_m)
        return min(holds_rad + ARRIVED_RAD + self.spread_rad, FOLLOWING_JAW_RAD)


UNCALIBRATED = Jaw()


def stays_open(open_rad: float, explained_rad: float) -> Refusal:
    """Why a motion ends whose jaw was told to close and has not."""
    told = f"the jaw was told to close and stays {open_rad:.2f} rad open, and {explained_rad:.2f} rad are explained"
    remedy = "see what is between its fingers, or calibrate it (docs/dvrk.md), then set a goal again"
    return Refusal(Code.JAW_OPEN, f"{told} by thread, backlash and lag: {remedy}")
