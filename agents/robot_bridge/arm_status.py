"""How an arm stands: where it was measured, where its base is, what is around it, and why it must not be moved.

**The age of the newest camera frame** counts by the bridge's clock: a motion must not go on where nobody sees it.
Frames echo the bridge's challenges. A frame that echoes a challenge was taken after that was issued, so the time since
then bounds its age, and a queue that is as long all the time cannot make an old frame pass for a new one. A camera that
tells no frames at all is an older recording's, or a simulated arm's without one: nothing is known then, which speaks
against moving a real arm alone.

**Whether somebody stands by** is told by challenge and answer: who acts asks, by its own clock. The bridge's challenge
is the time at which it issued it, told with its state. An answer echoes it, so it is as young as the challenge: what a
queue held back for three seconds tells that somebody was there three seconds ago. No clock but the bridge's own counts,
which does not jump while an arm is armed (shared/runtime/clocks.py).
"""

import dataclasses
import logging
from collections import deque

import numpy as np

from agents.robot_bridge.backend import ArmState, Backend
from agents.robot_bridge.config import RobotBridgeConfig
from agents.robot_bridge.correction import Correcting
from agents.robot_bridge.jaw import Jaw
from agents.robot_bridge.limits import Setup
from agents.robot_bridge.measuring import Measuring
from agents.robot_bridge.motion import CONTACT
from agents.robot_bridge.plans import Code, Refusal, taken_ns
from agents.robot_bridge.tissue import measured_at
from schemas.messages import FrameStamp, GraspPlan, Phase, TissueSurface, ToolCorrection

DAY_NS = 86_400_000_000_000


class Standing:
    """One arm.

    Fields:
        measured: what it says of itself.
        registered: where its base is registered, and with it the tool by the joints alone.
        setup: what motions are planned with; its base is corrected where the images correct it.
        corrected: whether they do.
    """

    def __init__(self, config: RobotBridgeConfig, backend: Backend, log: logging.Logger) -> None:
        self.measured = Measuring(backend, log)
        self.registered, self.corrected = config.T_camera_base, False
        limits = dataclasses.replace(config.limits, maximum_duration_s=config.maximum_motion_s)
        jaw = Jaw.calibrated(config.jaw_zero)
        self.setup = Setup(backend.kinematics, config.T_camera_base, limits, 1 / config.tick_hz, jaw=jaw)
        self._config = config
        self._correcting = Correcting(config.correction)
        self._surface: TissueSurface | None = None
        self._calibration_id = config.calibration_id

    def measure(self, now_ns: int) -> ArmState | None:
        """The newest state, and where its base is by that and by the images."""
        arm = self.measured.measure(now_ns)
        if arm and arm.T_camera_base is not None:
            self.registered = arm.T_camera_base
        by_images = self._correcting.corrected(self.registered)
        self.corrected = by_images is not None
        base = self.registered if by_images is None else by_images
        if base is not self.setup.T_camera_base:
            self.setup = dataclasses.replace(self.setup, T_camera_base=base)
        return arm

    def forget_tissue(self) -> None:
        """What was seen of the tissue is of another time."""
        self._surface = None

    def hear(self, told: TissueSurface | ToolCorrection, armed: bool) -> None:
        """Take the newest tissue, or the newest correction; while a plan is armed the base stays where it is."""
        if isinstance(told, ToolCorrection):
            self._correcting.hear(told, armed)
        else:
            self._surface = told

    @property
    def looked_ns(self) -> int:
        """When the newest frame was captured by which the images correct the base; 0 where they do not."""
        return self._correcting.looked_ns

    def refusal(self, now_ns: int) -> Refusal | None:
        """Why no motion may begin now, whichever it is."""
        stood, still = self.measured.stood_since_ns, self._still_since_ns
        return self.measured.not_ready or self._correcting.refusal(now_ns, stood, still)

    def broken(self, now_ns: int) -> Refusal | None:
        """Why a motion must not go on."""
        return self.measured.not_ready or self._correcting.broken(now_ns)

    def unknown(self, plan: GraspPlan, setup: Setup, now_ns: int) -> Refusal | None:
        """What must be known before a real arm moves and is not, with what to do about it; None where all is."""
        config, state = self._config, self.measured.state
        if not plan.stamp.calibration_id:
            why = "the plan's frame does not say of which camera calibration it is"
            return Refusal(Code.UNKNOWN, f"{why}: see that the camera's agent is of this version")
        if not self._calibration_id:
            why = "nobody says with which camera calibration the arm was registered"
            remedy = f'set T_camera_base_calibration = "{plan.stamp.calibration_id}", if it was with the one of now'
            return Refusal(Code.UNKNOWN, f"{why}: {remedy}")
        if not config.registered_ns:
            why = "nobody says when the arm was registered before the camera"
            return Refusal(Code.UNKNOWN, f"{why}: set T_camera_base_made beside its T_camera_base")
        if (days := (now_ns - config.registered_ns) / DAY_NS) < -1:
            ahead = f"the arm was registered {-days:.0f} days ahead of this host's clock"
            return Refusal(Code.UNKNOWN, f"{ahead}: set the clock, or T_camera_base_made")
        if days > config.registration_days:
            old = f"the arm was registered {days:.0f} days ago, and {config.registration_days:g} are allowed"
            return Refusal(
                Code.UNKNOWN,
                f"{old}: register it anew (docs/camera.md)",
            )
        if why := self._jaw_unknown("" if state is None else state.instrument, now_ns):
            return Refusal(Code.UNKNOWN, f"{why}: calibrate it anew with suturegrasp calibrate jaw (docs/dvrk.md)")
        if state is not None and state.untold:
            what, remedy = state.untold[0]
            return Refusal(Code.UNKNOWN, f"{what}: {remedy}")
        looked_at = CONTACT
        if plan.continues:
            # the tool itself hides the place by now, and it was measured before, unless a pull grasps anew elsewhere
            looked_at = () if plan.pull is None else (Phase.CAPTURE, Phase.GRASP)
        contact = [one.T_camera_tool for one in plan.waypoints if one.phase in looked_at]
        surface = setup.surface
        lets_go = all(one.phase is Phase.RELEASE for one in plan.waypoints)
        if (
            config.tissue_needed
            and not lets_go
            and (surface is None or (contact and not measured_at(surface, np.stack(contact))))
        ):
            why = "where the tissue is was not measured at the thread, or too long ago"
            return Refusal(Code.UNKNOWN, f"{why}: see that perception sees it, or say has_no = ['tissue']")
        return None

    def _jaw_unknown(self, mounted: str, now_ns: int) -> str:
        """Why a calibration of the jaw is none of now, or of the instrument that is mounted; empty where it is."""
        zero, allowed = self._config.jaw_zero, self._config.jaw_days
        if zero is None:
            return ""
        if mounted and mounted != zero.instrument:
            return f"the jaw was calibrated with {zero.instrument}, and {mounted} is mounted"
        if not zero.made_ns:
            return "nobody says when the jaw was calibrated"
        days = (now_ns - zero.made_ns) / DAY_NS
        if -1 <= days <= allowed:
            return ""
        when = f"{days:.0f} days ago, and {allowed:g} are allowed" if days > 0 else f"{-days:.0f} days ahead of now"
        return f"the jaw was calibrated {when}"

    def with_tissue(self, now_ns: int, maximum_age_s: float) -> Setup:
        """With the tissue as it was seen last, where that is no older than that and nothing was moved since."""
        surface = self._surface
        if surface is None:
            return self.setup
        seen_ns = taken_ns(surface.stamp, self._config.arm)
        if now_ns - seen_ns > maximum_age_s * 1e9 or seen_ns < self._still_since_ns:
            return self.setup
        return dataclasses.replace(self.setup, surface=surface)

    def frames(self, setup: Setup) -> tuple[tuple[str, str], ...]:
        """What a motion would stand on that is told in a rectified camera's frame, and of which calibration it is."""
        return (
            ("the arm was registered", self._calibration_id),
            ("the tissue was measured", setup.surface.stamp.calibration_id if setup.surface is not None else ""),
            ("the tool was seen", self._correcting.calibration_id),
        )

    @property
    def _still_since_ns(self) -> int:
        arm = self.measured.state
        return 0 if arm is None else arm.still_since_ns


KEPT_NS = 10_000_000_000
"""An answer that comes later than that is told to be older than this."""


class Challenges:
    """What one bridge has issued."""

    def __init__(self) -> None:
        self._issued: deque[int] = deque()

    def issue(self, now_ns: int) -> int:
        """The next challenge. Where the clock was set back, nothing of before counts any more."""
        if self._issued and now_ns <= self._issued[-1]:
            self._issued.clear()
        self._issued.append(now_ns)
        while now_ns - self._issued[0] > KEPT_NS:
            self._issued.popleft()
        return now_ns

    def age_ns(self, challenge_ns: int, now_ns: int) -> int | None:
        """How long ago it was issued; None for what never was, or too long ago to be known."""
        return now_ns - challenge_ns if challenge_ns in self._issued else None

    def behind_ns(self, challenge_ns: int, now_ns: int) -> int | None:
        """For how long a newer one has been out: how far its sender is behind, however seldom challenges are issued.

        0 for the newest, None as for `age_ns`.
        """
        if challenge_ns not in self._issued:
            return None
        newer = next((issued_ns for issued_ns in self._issued if issued_ns > challenge_ns), now_ns)
        return now_ns - newer


class Sight:
    """What one arm's bridge has been told of frames."""

    def __init__(self, arm: str, is_real: bool, challenges: Challenges) -> None:
        self._arm, self._is_real, self._challenges = arm, is_real, challenges
        self._newest: FrameStamp | None = None

    def hear(self, stamp: FrameStamp | None) -> None:
        """A frame was taken; None where none of before counts any more."""
        self._newest = stamp

    def refusal(self, now_ns: int, maximum_age_s: float) -> Refusal | None:
        """Why nobody may be moved by what the camera shows; None where it is new enough."""
        if self._newest is None:
            silent = "no camera has told of a frame yet: see that the camera runs, and that it is of this version"
            return Refusal(Code.FRAME_AGE, silent) if self._is_real else None
        newest = self._newest, self._arm, self._is_real, now_ns, maximum_age_s, "the newest camera frame"
        return too_old(*newest) or self._unissued(self._newest.echo_of(self._arm), now_ns)

    def _unissued(self, echo_ns: int, now_ns: int) -> Refusal | None:
        """Why an echo tells no age: this bridge did not issue it, or did so before its clock was set back."""
        if not self._is_real or self._challenges.age_ns(echo_ns, now_ns) is not None:
            return None
        before = "the newest camera frame echoes a challenge of before this bridge began or its clock was set"
        return Refusal(Code.FRAME_AGE, f"{before}: wait for another")


def too_old(stamp: FrameStamp, arm: str, is_real: bool, now_ns: int, maximum_age_s: float, what: str) -> Refusal | None:
    """Why a frame is too old to be moved by; None where it is not. Without an echo its own clock is believed."""
    echo_ns = stamp.echo_of(arm)
    if echo_ns == 0 and is_real:
        blind = f"{what} echoes no challenge of {arm}, so that nobody knows how old it is"
        remedy = f"see that the camera's agent hears the bridge of {arm}, and that its picture is not always the same"
        return Refusal(Code.FRAME_AGE, f"{blind}: {remedy}")
    since_ns = echo_ns or min(stamp.capture_left_ns, stamp.capture_right_ns)
    age_s = (now_ns - since_ns) * 1e-9
    if echo_ns and age_s < 0:
        return Refusal(
            Code.FRAME_AGE, f"{what} echoes a challenge of before the bridge's clock was set: wait for another"
        )
    if age_s <= maximum_age_s:
        return None
    old = f"{what} is {age_s:.1f} s old, and {maximum_age_s:g} s are allowed"
    return Refusal(Code.FRAME_AGE, f"{old}: see to the camera and its link, then plan again")
