"""Where an arm's instrument is in the images, beside where registration and joints have it. Metres and radians."""

import enum
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from schemas.checks import UInt32, UInt64, check_message, require
from schemas.messages.grasping import check_arm, check_pose
from schemas.messages.imaging import FrameStamp
from schemas.messages.running import Consumed


class ToolStatus(enum.Enum):
    """How it stands with an instrument: searched for, followed, or lost after it was followed."""

    CONVERGING = 1
    CONVERGED = 2
    LOST = 3


@dataclass(frozen=True)
class ToolCandidate:
    """A place that the instrument may be at: six numbers about the pivot, their covariance, and the colours it has.

    Fields:
        twist: v and ω of the correction, as agents/tool_tracker/correction.py has them.
        table: how much each of 16³ colours is the instrument's, 255 being all.
        expected, fits: points of the outline in view, and the share of them at which there is an edge.
        quality: the same share, weighed by how near the edge is.
        residual_px: of the edges that fit, root mean square; 0 where none does.
    """

    twist: Float64[np.ndarray, "6"]
    covariance: Float64[np.ndarray, "6 6"]
    table: UInt8[np.ndarray, "16 16 16"]
    expected: UInt32
    fits: float
    quality: float
    residual_px: float

    def __post_init__(self) -> None:
        check_message(self)
        require(0 <= self.fits <= 1, f"fits must lie within 0 and 1, and is {self.fits}")


@dataclass(frozen=True)
class ToolCorrection:
    """By what rigid motion an instrument is off, after one more frame: all that the next frame goes on from, too.

    Fields:
        measured_ns: of the arm's state that the frame was looked at with.
        reason: why it is not followed, or was not seen in this frame; empty where all is well.
        T_correction: to be multiplied from the left onto the registered T_camera_base; None unless it may be used.
        pivot_camera: about which the candidates turn.
        tip_camera: the tip of the closed fingers, corrected where there is a correction.
        tip_off_m, turned_rad: how far the correction moves the tip, and turns the instrument; 0 without one.
        tip_deviation_m, turn_deviation_rad: of both (root of the covariance's trace); 0 without one.
        registered_left_px: outline in the rectified left image by registration and joints alone.
        found_left_px, found_right_px: the same with the correction; empty without one.
        candidates: the one that is followed, or the best so far of those that are searched among.
        attempts, misses, looks: searches so far, frames on end in which it was not seen, frames looked at.
    """

    arm: str
    stamp: FrameStamp
    measured_ns: int
    status: ToolStatus
    reason: str
    T_correction: Float64[np.ndarray, "4 4"] | None
    pivot_camera: Float64[np.ndarray, "3"]
    tip_camera: Float64[np.ndarray, "3"]
    tip_off_m: float
    turned_rad: float
    tip_deviation_m: float
    turn_deviation_rad: float
    registered_left_px: Float64[np.ndarray, "n 2"]
    found_left_px: Float64[np.ndarray, "m 2"]
    found_right_px: Float64[np.ndarray, "k 2"]
    candidates: tuple[ToolCandidate, ...]
    attempts: UInt32
    misses: UInt32
    looks: UInt64
    consumed: tuple[Consumed, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)
        if self.T_correction is not None:
            check_pose("ToolCorrection.T_correction", self.T_correction)
        usable = self.status is ToolStatus.CONVERGED and self.misses == 0
        require((self.T_correction is not None) == usable, "a correction is told where it may be used, else none")
        require((self.reason == "") == usable, "where a correction may not be used there is a reason, else none")
        require(self.status is not ToolStatus.CONVERGED or len(self.candidates) == 1, "one candidate is followed")
