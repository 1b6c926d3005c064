"""What an arm says of itself, turn by turn: where it is, whether it may be moved, whether it rests."""

import logging
import re

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.backend import ArmState, Backend, Readiness
from agents.robot_bridge.plans import Code, Refusal

STILL = np.array([2e-3, 2e-3, 2e-4, 2e-3, 2e-3, 2e-3, 2e-3])
"""An arm whose joints (rad, the third m) and jaw are this near to where they were a while ago has not moved."""
MEASUREMENT_AGE_S = 0.1
"""An arm that was measured longer ago than this is not ready."""

FIGURES = re.compile(r"[\d.]+")


class Measuring:
    """One arm.

    Fields:
        state: the newest that is finite; None before the first.
        not_ready: why it must not be moved now; None where it may be.
        stood_since_ns: since when its joints, the jaw aside, have been where they are.
    """

    def __init__(self, backend: Backend, log: logging.Logger) -> None:
        self.state: ArmState | None = None
        self.not_ready: Refusal | None = Refusal(Code.NOT_READY, "the arm has not been measured yet")
        self._backend, self._log, self._logged = backend, log, ""
        self._still_at = np.full(7, np.inf)
        self.stood_since_ns, self._stood_at = 0, np.full(6, np.inf)
        self._tool: tuple[np.ndarray, Float64[np.ndarray, "4 4"]] | None = None

    def measure(self, now_ns: int) -> ArmState | None:
        """The newest finite state, noting why the arm is not ready."""
        state = self._backend.state(now_ns)
        if not (np.isfinite(state.joints).all() and np.isfinite(state.jaw_rad)):
            why = state.reason or "the arm reports a joint that is not finite"
            self.not_ready = Refusal(state.code, why)
            self._tell_readiness()
            return self.state
        self.state = state
        if (np.abs(state.joints - self._stood_at) > STILL[:6]).any():
            self.stood_since_ns, self._stood_at = state.measured_ns, state.joints
        late = abs(now_ns - state.measured_ns) > MEASUREMENT_AGE_S * 1e9
        if state.readiness is not Readiness.READY:
            self.not_ready = Refusal(state.code, f"the arm is {state.readiness.name}: {state.reason}")
        else:
            silent = f"the arm was not measured for {MEASUREMENT_AGE_S:g} s"
            self.not_ready = Refusal(Code.STALE_STATE, silent) if late else None
        self._tell_readiness()
        return state

    def has_moved(self, arm: ArmState) -> bool:
        """Whether the arm is elsewhere than when this was last so."""
        place = np.append(arm.joints, arm.jaw_rad)
        if (np.abs(place - self._still_at) <= STILL).all():
            return False
        self._still_at = place
        return True

    def tool_pose(self, arm: ArmState) -> Float64[np.ndarray, "4 4"]:
        """The pose of the tool, computed anew where the joints are others than the last time."""
        if self._tool is None or not np.array_equal(self._tool[0], arm.joints):
            self._tool = arm.joints.copy(), self._backend.kinematics.forward(arm.joints)
        return self._tool[1]

    def _tell_readiness(self) -> None:
        """Log why the arm is not ready, and that it is again; not each change of a figure in it."""
        sentence = self.not_ready.sentence if self.not_ready else ""
        words = FIGURES.sub("", sentence)
        if words != self._logged:
            self._logged = words
            self._log.warning("%s", sentence) if words else self._log.info("the arm is ready")
