"""One armed plan being carried out: which set point comes next, and when to stop instead."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.backend import ArmState
from agents.robot_bridge.motion import Trajectory
from agents.robot_bridge.refusals import Code, Refusal
from schemas.messages import Arm, Phase
from shared.kinematics.arm import ArmKinematics
from shared.rigid_transforms import angle_between

LONGEST_STEP_PERIODS = 2
"""After a late tick the motion goes on where it was, and does not make up for lost time."""
RATIO_PER_S = 2.0
"""How fast the share of the planned speed changes: from all to half of it in a quarter of a second."""
FOLLOWING_M, FOLLOWING_RAD = 0.005, 0.2
"""Farther than this from where the arm is measured, no set point is sent."""
ARRIVED_M, ARRIVED_RAD = 5e-4, 0.02
ARRIVAL_S = 1.0
"""How long an arm may take to come to rest where it should."""


@dataclass(frozen=True)
class Patience:
    """How long to go on without a heartbeat: before the first one, when nothing moves yet, and after it."""

    first_heartbeat_s: float
    dead_man_s: float


@dataclass(frozen=True, eq=False)
class SetPoint:
    """Where to go next; `reached` are the phases that the arm has completed, `finished` that it was the last."""

    joints: Float64[np.ndarray, "6"]
    jaw_rad: float
    reached: tuple[Phase, ...]
    finished: bool


class Execution:
    """An armed plan. It moves only while heartbeats come, and rests at every stop until the arm has arrived.

    Fields:
        plan_id, arming_id: which plan is carried out, and by which command.
        moving: a heartbeat has come, so that set points follow.
    """

    def __init__(
        self, armed: Arm, trajectory: Trajectory, armed_ns: int, patience: Patience, kinematics: ArmKinematics
    ) -> None:
        """Arm a plan; nothing moves before the first heartbeat."""
        self.plan_id, self.arming_id = armed.plan_id, armed.header.id
        self.moving = False
        self._trajectory, self._patience, self._kinematics = trajectory, patience, kinematics
        self._alive_ns, self._beat_at_ns = armed_ns, None
        self._off_s: float | None = None
        self._progress_s: float | None = None
        self._stop, self._waited_s, self._ratio = 0, 0.0, 1.0

    def beat(self, beat_at_ns: int, now_ns: int) -> None:
        """Take a heartbeat; one that is not newer than the one before, by its sender's clock, is none."""
        if self._beat_at_ns is None or beat_at_ns > self._beat_at_ns:
            self._beat_at_ns, self._alive_ns, self.moving = beat_at_ns, now_ns, True
            self._off_s = None

    def untimely(self, ahead_s: float) -> None:
        """Note a heartbeat that counts for none, since its sender's clock is so far ahead (negative: behind)."""
        self._off_s = ahead_s

    def next(self, arm: ArmState, now_ns: int, elapsed_s: float, ratio: float = 1.0) -> SetPoint | Refusal | None:
        """The next set point, or why to hold; None while the first heartbeat is awaited.

        `ratio` is the share of the planned speed to go on with; another than before is gone over to within a while.
        """
        allowed_s = self._patience.dead_man_s if self.moving else self._patience.first_heartbeat_s
        if elapsed_s < 0:
            return Refusal(Code.CLOCK, "the clock went backwards")
        if now_ns - self._alive_ns > allowed_s * 1e9:
            return Refusal(Code.HEARTBEAT_LOST, self._why_lost(allowed_s, elapsed_s))
        if not self.moving:
            return None
        reached = self._go_on(arm, elapsed_s, ratio, now_ns)
        joints, jaw_rad = self._trajectory.at(self._progress_s or 0.0)
        if self._waited_s > ARRIVAL_S or not self._near(arm, joints, FOLLOWING_M, FOLLOWING_RAD):
            return Refusal(Code.NOT_FOLLOWING, "the arm does not follow its set points: it may be blocked, or pushed")
        return SetPoint(joints, jaw_rad, reached, finished=self._stop == len(self._trajectory.stops))

    def _why_lost(self, allowed_s: float, elapsed_s: float) -> str:
        if elapsed_s > allowed_s:
            passed = f"{elapsed_s:.1f} s passed between two turns of the bridge"
            return f"{passed}: its clock was set, or it stood still; the operator must arm a plan again"
        if self._off_s is not None:
            where = f"{abs(self._off_s):.1f} s {'ahead' if self._off_s > 0 else 'behind'}"
            return f"heartbeats come from a clock that is {where}: set the clocks of operator and bridge by each other"
        return f"no heartbeat came for {allowed_s:g} s: the operator must arm a plan again"

    def _go_on(self, arm: ArmState, elapsed_s: float, ratio: float, now_ns: int) -> tuple[Phase, ...]:
        """Go towards the next stop, which the first set point, where the trajectory begins, does not yet."""
        if self._progress_s is None:
            self._progress_s, self._ratio = 0.0, ratio
        elif self._progress_s < self._stop_s():
            step_s = min(elapsed_s, LONGEST_STEP_PERIODS * self._trajectory.period_s)
            change = RATIO_PER_S * step_s
            self._ratio += min(max(ratio - self._ratio, -change), change)
            step_s *= self._ratio
            self._progress_s = min(self._progress_s + step_s, self._stop_s())
        else:
            return self._reached(arm, elapsed_s, now_ns)
        return ()

    def _reached(self, arm: ArmState, elapsed_s: float, now_ns: int) -> tuple[Phase, ...]:
        """The phases that end here, where the arm has been sent already, once it has arrived."""
        joints, _ = self._trajectory.at(self._stop_s())
        self._waited_s += elapsed_s
        # as it was measured before it was sent here it may have come by on its way
        since_ns = now_ns - round(self._waited_s * 1e9)
        if arm.busy or arm.measured_ns < since_ns or not self._near(arm, joints, ARRIVED_M, ARRIVED_RAD):
            return ()
        here_s, self._waited_s, reached = self._stop_s(), 0.0, list[Phase]()
        while self._stop < len(self._trajectory.stops) and self._stop_s() == here_s:
            phase = self._trajectory.stops[self._stop].phase
            reached += [phase] if phase else []
            self._stop += 1
        return tuple(reached)

    def _stop_s(self) -> float:
        stops = self._trajectory.stops
        return stops[min(self._stop, len(stops) - 1)].sample * self._trajectory.period_s

    def _near(self, arm: ArmState, joints: Float64[np.ndarray, "6"], metres: float, radians: float) -> bool:
        T = self._kinematics.forward(np.stack((arm.joints, joints)))
        distance = np.linalg.norm(T[0, :3, 3] - T[1, :3, 3])
        return bool(distance <= metres and angle_between(T[0, :3, :3], T[1, :3, :3]) <= radians)
