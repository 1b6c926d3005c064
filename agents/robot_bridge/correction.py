"""Where an arm's base is by the images: the registration, corrected by what perception tells of the arm's tool.

A correction C is taken while perception tells one, is sure of it, and it is within its limits; the base is then at
C · T_camera_base. While a plan is armed it stays what it was when the motion was planned, for set points in the base's
frame would jump with it; where the images then tell something else, or nothing any more, the motion ends.

On a busy computer a look is told some seconds after its frame. C changes slowly: with registration, which camera or
set-up joints that move would undo (frames_moved.py hears of those within a tick), and with what joints are wrong by,
which changes as they move. So an older look is held: to begin with, where the arm has stood since its frame, and in
mid-motion for HELD_S in any case, for the base stays as it was planned with anyhow, and no look could better it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.plans import CLOCK_TOLERANCE_S, Code, Refusal, taken_ns
from schemas.messages import ToolCorrection, ToolStatus
from shared.rigid_transforms import angle_between, apply, inverse, nearest_rotation

CORRECTION_LIMIT_MM, CORRECTION_LIMIT_DEG = 15.0, 8.0
FRESH_S, HELD_S = 1.0, 4.0
"""How old the frame of a look may be for a motion to begin wherever the arm went since, and for the look to be held."""
SURE_M = 0.0015
"""The most that the tip's deviation may be."""
JUMP_M, JUMP_RAD = 0.003, 0.06
"""Two corrections that place the tip, or turn the tool, so far from each other are not both right."""


@dataclass(frozen=True)
class CorrectionLimits:
    """How far a correction may move the tip and turn the instrument."""

    metres: float = 1e-3 * CORRECTION_LIMIT_MM
    radians: float = float(np.radians(CORRECTION_LIMIT_DEG))


class Correcting:
    """One arm's corrections; with limits None there are none, and nothing speaks against moving without."""

    def __init__(self, limits: CorrectionLimits | None) -> None:
        self._limits = limits
        self._last: ToolCorrection | None = None
        self._usable_ns = 0
        self.looked_ns = 0
        """When the newest frame was captured by which the base is corrected; 0 where it is not."""
        self._applied: Float64[np.ndarray, "4 4"] | None = None
        self._made: tuple[tuple[np.ndarray, np.ndarray], Float64[np.ndarray, "4 4"]] | None = None

    def hear(self, told: ToolCorrection, armed: bool) -> None:
        """Take the newest; what is applied changes only while nothing is `armed`."""
        self._last = told
        usable = told.T_correction is not None and self._doubt(told) is None
        if usable:
            self._usable_ns = taken_ns(told.stamp, told.arm)
        if not armed:
            if usable and told.T_correction is not None:
                self._applied = told.T_correction
            elif told.status is not ToolStatus.CONVERGED or self._doubt(told) is not None:
                self._applied = None
        self.looked_ns = self._usable_ns if self._applied is not None else 0

    def corrected(self, T_camera_base: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"] | None:
        """Where the base is by the correction that is applied; None where none is."""
        if self._applied is None:
            return None
        made_of = (self._applied, T_camera_base)
        if self._made is None or any(a is not b for a, b in zip(self._made[0], made_of, strict=True)):
            T = self._applied @ T_camera_base
            T[:3, :3] = nearest_rotation(T[:3, :3])
            self._made = made_of, T
        return self._made[1]

    @property
    def calibration_id(self) -> str:
        """Of the camera in whose frame the correction is that is applied; empty where none is."""
        return self._last.stamp.calibration_id if self._last is not None and self._applied is not None else ""

    def refusal(self, now_ns: int, stood_since_ns: int, still_since_ns: int) -> Refusal | None:
        """Why no motion may begin now of an arm that has stood where it stands since then.

        Args:
            still_since_ns: camera, set-up joints or the arm were moved by hand before, not since.
        """
        if self._limits is None:
            return None
        if self._last is None:
            return Refusal(Code.CORRECTION_LOST, "nothing was told yet of where the tool is in the images")
        if doubt := self._doubt(self._last):
            return doubt
        if self._last.T_correction is None or self._applied is None:
            reason = self._last.reason or "a motion has just ended"
            return Refusal(Code.CORRECTION_LOST, f"where the tool is in the images is not known: {reason}")
        if why := self._silent(now_ns):
            return why
        if self._usable_ns < still_since_ns:
            moved = "camera, set-up joints or the arm were moved by hand since the tool was seen in the images"
            return Refusal(Code.CORRECTION_LOST, f"{moved}: arm again when it was seen anew")
        if self._age_s(now_ns) <= FRESH_S or self._usable_ns >= stood_since_ns:
            return None
        moved = f"the tool was seen {self._age_s(now_ns):.1f} s ago in the images, and has moved since"
        return Refusal(Code.CORRECTION_LOST, f"{moved}: arm again when it was seen where it stands")

    def broken(self, now_ns: int) -> Refusal | None:
        """Why a motion that was planned with what is applied must not go on."""
        last = self._last
        if self._limits is None or last is None:
            return None
        if last.status is not ToolStatus.CONVERGED:
            return Refusal(Code.CORRECTION_LOST, f"the tool is not followed in the images any more: {last.reason}")
        if doubt := self._doubt(last):
            return doubt
        return self._jumped(last) or self._silent(now_ns)

    def _doubt(self, told: ToolCorrection) -> Refusal | None:
        """What speaks against a correction by itself."""
        limits = self._limits or CorrectionLimits()
        if told.T_correction is None:
            return None
        if told.tip_off_m > limits.metres or told.turned_rad > limits.radians:
            off = f"{1e3 * told.tip_off_m:.1f} mm and {np.degrees(told.turned_rad):.1f} degrees"
            allowed = f"{1e3 * limits.metres:g} mm and {np.degrees(limits.radians):g} degrees may be corrected"
            return Refusal(
                Code.CORRECTION_LIMIT, f"the tool is {off} off in the images, where {allowed}: register anew"
            )
        if told.tip_deviation_m > SURE_M:
            unsure = f"known to {1e3 * told.tip_deviation_m:.1f} mm only, where {1e3 * SURE_M:g} mm are needed"
            return Refusal(Code.CORRECTION_LOST, f"where the tool's tip is in the images is {unsure}")
        return None

    def _jumped(self, told: ToolCorrection) -> Refusal | None:
        if told.T_correction is None or self._applied is None:
            return None
        change = told.T_correction @ inverse(self._applied)
        tip = told.tip_camera[None]
        moved_m = float(np.linalg.norm(apply(inverse(change), tip) - tip))
        turned_rad = float(angle_between(change[:3, :3], np.eye(3)))
        if moved_m <= JUMP_M and turned_rad <= JUMP_RAD:
            return None
        by = f"{1e3 * moved_m:.1f} mm and {np.degrees(turned_rad):.1f} degrees"
        return Refusal(Code.CORRECTION_JUMPED, f"the tool is {by} from where it was when its motion was planned")

    def _age_s(self, now_ns: int) -> float:
        return (now_ns - self._usable_ns) * 1e-9

    def _silent(self, now_ns: int) -> Refusal | None:
        age_s = self._age_s(now_ns)
        if age_s < -CLOCK_TOLERANCE_S:
            future = f"the frame in which the tool was seen was captured {-age_s:.1f} s in the future"
            return Refusal(Code.CLOCK, f"{future}: set the clocks of camera and bridge by each other")
        if age_s <= HELD_S:
            return None
        seen = f"the tool was seen {age_s:.1f} s ago in the images, and {HELD_S:g} s are allowed"
        return Refusal(Code.CORRECTION_LOST, f"{seen}: see that perception runs, and has the tool in view")
