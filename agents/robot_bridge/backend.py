"""What drives an arm: the seam between the bridge and a robot, simulated or real."""

import enum
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.plans import Code
from schemas.messages import StateWord
from shared.kinematics.arm import ArmKinematics


class Readiness(enum.Enum):
    """Whether an arm would follow set points."""

    READY = 1
    DISABLED = 2
    FAULT = 3


@dataclass(frozen=True)
class ArmState:
    """An arm as measured.

    Fields:
        measured_ns: when, on the bridge's clock.
        reason, code: why it is not ready; empty where it is.
        busy: it makes a motion of its own.
        still_since_ns: what a camera saw before is elsewhere now: camera, set-up joints or the arm were moved.
        T_camera_base: where its base is now; None where that is as configured.
        guard_challenge: the newest number of the guard beside its console; 0 where it has none.
        pedal: its console's operator-present pedal is pressed, as the guard tells it.
        untold: what a real arm needs to be told before it may be armed and was not, each with what to do, by its name.
        jaw_set_point_rad, jaw_effort: where its console has the jaw head, and with which effort; None where it does not
            tell. Nothing is decided by them.
        instrument: the tool that its console has on it; empty where it does not tell.
    """

    measured_ns: int
    joints: Float64[np.ndarray, "6"]
    jaw_rad: float
    readiness: Readiness = Readiness.READY
    reason: str = ""
    code: Code = Code.NOT_READY
    busy: bool = False
    still_since_ns: int = 0
    T_camera_base: Float64[np.ndarray, "4 4"] | None = None
    guard_challenge: int = 0
    pedal: bool = False
    untold: tuple[tuple[str, str], ...] = ()
    jaw_set_point_rad: float | None = None
    jaw_effort: float | None = None
    instrument: str = ""


class Backend(Protocol):
    """An arm. Its methods return at once, and what cannot be had shows in the state, not as an exception.

    Fields:
        kinematics: the arm's geometry and limits.
        accepts_replayed_time: whether the arm may live in the time of a recording that is replayed, as a simulated one
            may; an arm that is real may not, and does not move meanwhile.
        dry_run: nothing is sent, so that arming ends with what would be.
        is_real: it moves something real: presence must be proven, and what is not known speaks against moving it.
    """

    kinematics: ArmKinematics
    accepts_replayed_time: bool = False
    dry_run: bool = False
    is_real: bool = False

    def state(self, now_ns: int) -> ArmState:
        """The newest state; asked for once in every tick, before anything else."""
        ...

    def move(self, joints: Float64[np.ndarray, "6"], jaw_rad: float, arming_id: str) -> None:
        """Take a new set point of an arming, a tick's way from the measured one; after `halt` none, until `rearm`."""
        ...

    def lets_through(self, arming_id: str) -> bool:
        """Whether set points of this arming reach the arm, as far as is known."""
        ...

    def finish(self, arming_id: str) -> None:
        """Note that the motion of an arming has ended as it should."""
        ...

    def hold(self) -> bool:
        """Stop where the arm is, and stay there; whether that could be handed over. From any thread, and again."""
        ...

    def halt(self) -> None:
        """Hold, and take no set point any more; from any thread, as soon as a command that stops has come."""
        ...

    @property
    def halted(self) -> bool:
        """Whether it was halted since it was armed last."""
        ...

    def rearm(self, asked_ns: int) -> bool:
        """Take set points again, of a plan that was armed after the last halt; False where somebody said hold since.

        Args:
            asked_ns: the challenge that whoever arms had heard: they know nothing of what came after it.
        """
        ...

    @property
    def holds(self) -> bool:
        """Whether the last hold is known to have come about."""
        ...

    def change_state(self, word: StateWord, now_ns: int) -> str:
        """Have the arm change its state, as a person wants it, while it is disarmed; why not, or empty."""
        ...

    def reached_state(self, word: StateWord) -> bool:
        """Whether the state that this leads to has come about since `change_state`, and the arm makes no motion."""
        ...

    def slow_down(self, ratio: float) -> None:
        """Have motions that the arm makes by itself, such as homing, take this share of their speed."""
        ...

    def close(self) -> None:
        """Stop where the arm is, if it was moved, and let go of it; nothing follows."""
        ...
