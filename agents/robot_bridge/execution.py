"""One armed plan being carried out: which set point comes next, and when to stop instead."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.backend import ArmState
from agents.robot_bridge.jaw import ARRIVED_RAD, UNCALIBRATED, Jaw, stays_open
from agents.robot_bridge.motion import Trajectory, contact_joints, segment_end
from agents.robot_bridge.plans import Code, Refusal
from agents.robot_bridge.pulling import Pulling
from schemas.messages import Arm, GraspPlan, Phase
from shared.kinematics.arm import ArmKinematics
from shared.rigid_transforms import angle_between

LONGEST_STEP_PERIODS = 2
"""After a late tick the motion goes on where it was, and does not make up for lost time."""
RATIO_PER_S = 2.0
"""How fast the share of the planned speed changes: from all to half of it in a quarter of a second."""
FOLLOWING_M, FOLLOWING_RAD = 0.005, 0.2
"""Farther than this from where the arm is measured, no set point is sent."""
ARRIVED_M = 5e-4
ARRIVAL_S = 1.0
"""How long an arm may take to come to rest where it should, and its jaw to be closed there."""
OPENS_S = 0.15
"""For how long a jaw that was closed may be measured open: as long as one takes that follows FOLLOWING_JAW_RAD behind,
at its greatest speed (2 rad/s)."""
CLOSED = (Phase.GRASP, Phase.RETREAT, Phase.PULL)
"""Phases that end with a closed jaw, where the plan has it closed."""
NOT_FOLLOWING = Refusal(Code.NOT_FOLLOWING, "the arm does not follow its set points: it may be blocked, or pushed")
KEPT_BACK = Refusal(Code.NO_GUARD, "the guard lets no set point of this arming pass: see what it says, then arm again")
SEGMENT_WAIT_S = 10.0
"""How long an arm rests between two segments for a plan from a fresh image; whoever stands by may give up before."""


@dataclass(frozen=True)
class Patience:
    """How long to go on without a heartbeat: before the first one, when nothing moves yet, and after it.

    Fields:
        segment_s: how long one segment may last, whatever the speed.
    """

    first_heartbeat_s: float
    dead_man_s: float
    segment_s: float


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
        plan, plan_id, arming_id: which plan is carried out, and by which command.
        plans: the ids of those of all segments.
        pressed: by the page's button.
        moving: a heartbeat has come, so that set points follow.
        let_through: set points reach the arm; until then it is sent where it is.
        segment: the how many-th of a chain, from 1 on, of at most `segments`.
        pull: what is pulled, and within which bounds; None for a grasp.
        jaw_sent_rad: the newest set point of the jaw.
        ended_ns: since when it rests at the end of a segment that is not the last; None while it does not.
    """

    def __init__(
        self,
        armed: Arm,
        plan: GraspPlan,
        trajectory: Trajectory,
        armed_ns: int,
        patience: Patience,
        kinematics: ArmKinematics,
        jaw: Jaw = UNCALIBRATED,
        pull: Pulling | None = None,
    ) -> None:
        """Arm a plan; nothing moves before the first heartbeat."""
        self.arming_id = armed.header.id
        self.pressed, self.segments, self.segment = armed.pressed, max(1, armed.segments), 0
        self.moving, self.let_through, self._kept_back_s = False, False, 0.0
        self._patience, self._kinematics, self._jaw = patience, kinematics, jaw
        self._alive_ns, self._beat_at_ns = armed_ns, 0
        self._late_ns: int | None = None
        self.plans, self.pull, self.jaw_sent_rad = set[str](), pull, 0.0
        self.follow(plan, trajectory)

    def follow(self, plan: GraspPlan, trajectory: Trajectory) -> None:
        """Go on with the next segment: along the trajectory of this plan, from its beginning."""
        self.plan, self.plan_id, self._trajectory = plan, plan.plan_id, trajectory
        self.plans.add(plan.plan_id)
        self.segment += 1
        self._held = self.pull is not None and Phase.GRASP not in {stop.phase for stop in trajectory.stops}
        self._goes_on = plan.pull is not None and not plan.pull.last
        self._ends_early = False
        # a segment of a pull is a plan of its own, and none is cut
        whole = len(trajectory.stops) - 1
        self._last = segment_end(trajectory, self._patience.segment_s) if self.pull is None else whole
        self.ended_ns: int | None = None
        self._began_ns: int | None = None
        self._progress_s: float | None = None
        self._stop, self._waited_s, self._ratio = 0, 0.0, 1.0
        self._explained_rad, self._open_s = self._jaw.explained_rad(plan), 0.0

    @property
    def touched(self) -> bool:
        """Whether the approach is over: the fingers are at the thread, or hold it."""
        return all(stop.phase is not Phase.APPROACH for stop in self._trajectory.stops[self._stop :])

    @property
    def approached(self) -> bool:
        """Whether the segment that has ended was the last one before contact."""
        return self._trajectory.stops[self._last].phase is Phase.APPROACH

    @property
    def pulls(self) -> bool:
        """Whether closed jaws pull thread now, or are about to."""
        left = any(stop.phase is Phase.PULL for stop in self._trajectory.stops[self._stop :])
        return left and self._closed and self.ended_ns is None

    def end_early(self) -> None:
        """Slow down to rest, and end the segment there."""
        self._ends_early = True

    @property
    def contact(self) -> Float64[np.ndarray, "6"]:
        """The joints where the last rest before contact is."""
        return contact_joints(self._trajectory)

    def answered(self, challenge_ns: int) -> None:
        """Take an answer to a challenge of this bridge, issued then: somebody stood by as late as that."""
        self._alive_ns = max(self._alive_ns, challenge_ns) if self.moving else challenge_ns
        self.moving = True
        self._late_ns = None

    def beaten(self, beat_at_ns: int, now_ns: int) -> None:
        """Take a heartbeat that answers nothing, as of recordings of before, from when it came: for no real arm."""
        if beat_at_ns > self._beat_at_ns:
            self._beat_at_ns, self._alive_ns, self.moving = beat_at_ns, now_ns, True

    def late(self, age_ns: int) -> None:
        """Note an answer that counts for none, since its challenge was issued so long ago."""
        self._late_ns = age_ns

    def next(self, arm: ArmState, now_ns: int, elapsed_s: float, ratio: float = 1.0) -> SetPoint | Refusal | None:
        """The next set point, or why to hold; None while the first heartbeat is awaited.

        `ratio` is the share of the planned speed to go on with; another than before is gone over to within a while.
        """
        allowed_s = self._patience.dead_man_s if self.moving else self._patience.first_heartbeat_s
        if elapsed_s < 0:
            return Refusal(Code.CLOCK, "the clock went backwards")
        if now_ns - self._alive_ns > allowed_s * 1e9:
            return self._why_lost(allowed_s, elapsed_s)
        if not self.moving:
            return None
        self._began_ns = self._began_ns or now_ns
        if self.ended_ns is None and now_ns - self._began_ns > self._patience.segment_s * 1e9:
            cap = f"the motion has lasted longer than the {self._patience.segment_s:g} s that it may at once"
            return Refusal(Code.TOO_LONG, f"{cap}: plan again, or let it go faster")
        if self.ended_ns is not None and now_ns - self.ended_ns > SEGMENT_WAIT_S * 1e9:
            silent = f"no plan from a fresh image came within {SEGMENT_WAIT_S:g} s for the next segment"
            return Refusal(
                Code.SEGMENT, f"{silent}: see that the thread is seen and planned for, then set a goal again"
            )
        reached = self._go_on(arm, elapsed_s, ratio, now_ns)
        if self._kept_back_s > ARRIVAL_S:
            return KEPT_BACK
        joints, jaw_rad = self._trajectory.at(self._progress_s or 0.0)
        if why := self._jaw_strays(arm, jaw_rad, elapsed_s):
            return why
        if self._waited_s > ARRIVAL_S or not self._near(arm, joints, FOLLOWING_M, FOLLOWING_RAD):
            return NOT_FOLLOWING
        self.jaw_sent_rad, over = jaw_rad, self._stop == len(self._trajectory.stops)
        if self._stop > self._last and (not over or self._goes_on) and self.ended_ns is None:
            self.ended_ns = now_ns
        return SetPoint(joints, jaw_rad, reached, finished=over and not self._goes_on)

    def _why_lost(self, allowed_s: float, elapsed_s: float) -> Refusal:
        if elapsed_s > allowed_s:
            passed = f"{elapsed_s:.1f} s passed between two turns of the bridge"
            again = "its clock was set, or it stood still; the operator must arm a plan again"
            return Refusal(Code.HEARTBEAT_LOST, f"{passed}: {again}")
        if self._late_ns is not None:
            took = f"answers take {1e-6 * self._late_ns:.0f} ms from the bridge to whoever stands by and back"
            allowed = f"{1e3 * self._patience.dead_man_s:.0f} ms are allowed: see to the network between them"
            return Refusal(Code.ROUND_TRIP, f"{took}, and {allowed}")
        return Refusal(
            Code.HEARTBEAT_LOST, f"no heartbeat came for {allowed_s:g} s: the operator must arm a plan again"
        )

    def _go_on(self, arm: ArmState, elapsed_s: float, ratio: float, now_ns: int) -> tuple[Phase, ...]:
        """Go towards the next stop, which the first set point, where the trajectory begins, does not yet."""
        if self._progress_s is None:
            self._progress_s, self._ratio = 0.0, ratio
        elif not self.let_through:
            self._kept_back_s += elapsed_s
        elif self.ended_ns is not None:
            return ()
        elif self._progress_s < self._stop_s():
            step_s = min(elapsed_s, LONGEST_STEP_PERIODS * self._trajectory.period_s)
            change, ratio = RATIO_PER_S * step_s, 0.0 if self._ends_early else ratio
            self._ratio += min(max(ratio - self._ratio, -change), change)
            step_s *= self._ratio
            self._progress_s = min(self._progress_s + step_s, self._stop_s())
            if self._ratio <= 0.0:
                self._stop = len(self._trajectory.stops)
        else:
            return self._reached(arm, elapsed_s, now_ns)
        return ()

    def _reached(self, arm: ArmState, elapsed_s: float, now_ns: int) -> tuple[Phase, ...]:
        """The phases that end here, where the arm has been sent already, once it has arrived."""
        joints, jaw_rad = self._trajectory.at(self._stop_s())
        self._waited_s += elapsed_s
        # as it was measured before it was sent here it may have come by on its way
        since_ns = now_ns - round(self._waited_s * 1e9)
        if arm.busy or arm.measured_ns < since_ns or not self._near(arm, joints, ARRIVED_M, ARRIVED_RAD):
            return ()
        if self._closes_here and self._is_open(arm, jaw_rad):
            return ()
        here_s, self._waited_s, reached = self._stop_s(), 0.0, list[Phase]()
        while self._stop < len(self._trajectory.stops) and self._stop_s() == here_s:
            phase = self._trajectory.stops[self._stop].phase
            reached += [phase] if phase else []
            self._stop += 1
        return tuple(reached)

    def _jaw_strays(self, arm: ArmState, jaw_rad: float, elapsed_s: float) -> Refusal | None:
        """Why to hold where the jaw does not follow; where it was told to close and has not, or has opened since."""
        follows, is_open = self._jaw.follows(arm.jaw_rad, jaw_rad), self._is_open(arm, jaw_rad)
        self._open_s = self._open_s + elapsed_s if is_open and self._closed else 0.0
        late = self._open_s > OPENS_S or (self._closes_here and self._waited_s > ARRIVAL_S)
        if is_open and (late or not follows):
            return stays_open(arm.jaw_rad - self._jaw.closes_rad, self._explained_rad)
        return None if follows else NOT_FOLLOWING

    def _is_open(self, arm: ArmState, sent_rad: float) -> bool:
        """Whether the jaw is told to be closed, and measured more open than thread, backlash and lag explain."""
        told = self._jaw.told_to_close(sent_rad)
        return told and arm.jaw_rad - self._jaw.closes_rad > self._explained_rad

    @property
    def _closed(self) -> bool:
        """Whether the grasp is over, so that the jaw was found closed."""
        return self._held or any(stop.phase is Phase.GRASP for stop in self._trajectory.stops[: self._stop])

    @property
    def _closes_here(self) -> bool:
        """Whether the phase that ends at the next stop is one that ends with a closed jaw."""
        left = self._trajectory.stops[self._stop :]
        return any(stop.sample == left[0].sample and stop.phase in CLOSED for stop in left)

    def _stop_s(self) -> float:
        stops = self._trajectory.stops
        return stops[min(self._stop, len(stops) - 1)].sample * self._trajectory.period_s

    def _near(self, arm: ArmState, joints: Float64[np.ndarray, "6"], metres: float, radians: float) -> bool:
        T = self._kinematics.forward(np.stack((arm.joints, joints)))
        distance = np.linalg.norm(T[0, :3, 3] - T[1, :3, 3])
        return bool(distance <= metres and angle_between(T[0, :3, :3], T[1, :3, :3]) <= radians)
