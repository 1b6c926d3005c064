"""A PSM behind a console that speaks CRTK: joint set points out, measurements and the console's own state in.

Set points go to `servo_jp` and `jaw/servo_jp` at every tick, never to `move_*`: a console makes a joint-space
trajectory of those, and mixing one with the other has slammed arms. The last set point is held by the console when none
follows, for it knows no time-out.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.backend import ArmState, Readiness
from agents.robot_bridge.dvrk.frames_moved import FramesWatch
from agents.robot_bridge.dvrk.readings import KINDS, NOTHING, Readings
from agents.robot_bridge.dvrk.said import TELEOPERATION, Judged
from agents.robot_bridge.dvrk.set_points import SetPointsWatch
from agents.robot_bridge.refusals import Code
from schemas.messages import StateWord
from shared.calibration.hand_eye.file import HandEye
from shared.clock import now_ns as clock_ns
from shared.kinematics.arm import ArmKinematics
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.ros import crtk
from shared.ros.link import Heard, RosLink, Said
from shared.ros.naming import ALIVE, GUARD_NODE, GUARDED, Naming
from shared.ros.types import BOOL, EMPTY, FLOAT64, JOINT_STATE, OPERATING_STATE, POSE_STAMPED, STRING, STRING_STAMPED
from shared.runtime.session import SessionSettings

MOTIONS = {
    **dict.fromkeys(
        ("servo_jp", "move_jp", "servo_jr", "move_jr", "jaw/servo_jp", "jaw/move_jp", "servo_jf"), JOINT_STATE
    ),
    **dict.fromkeys(("servo_cp", "move_cp"), POSE_STAMPED),
}
"""Whoever publishes one of these beside us is another owner of the arm."""
SERVOS = ("servo_jp", "jaw/servo_jp")
STOPS = {"hold": EMPTY, "free": EMPTY, "state_command": STRING_STAMPED}
"""Whoever sends one of these wants us to stop; that somebody could does not."""

NOW_NS = 2_000_000_000
BEGINS_NS = 300_000_000
"""A console that was told to home an arm that is homed already says for a moment longer that it is."""


class Linked(Protocol):
    """As much of a RosLink as an arm needs."""

    failed: str

    def open(self) -> None:
        """Begin to hear."""
        ...

    def say(self, topic: str, payload: bytes) -> None:
        """Speak on a topic."""
        ...

    def close(self) -> None:
        """Neither hear nor speak any more."""
        ...


class DvrkPsm:
    """One PSM; in a dry run, or until it is opened, nothing is ever sent."""

    accepts_replayed_time = False

    def __init__(
        self,
        name: str,
        settings: SessionSettings,
        naming: Naming,
        tool: str,
        dry_run: bool,
        through_guard: bool = False,
        kinematics: ArmKinematics = LARGE_NEEDLE_DRIVER,
        base: HandEye | None = None,
        linked: Callable[..., Linked] = RosLink,
        clock: Callable[[], int] = clock_ns,
    ) -> None:
        """The arm of that name on the console that is reached so; `tool` as Readings has it.

        `through_guard`: set points go to the guard on the robot's computer, which passes on what is fresh.
        `base`: where it is, to follow it where that is told from the ECM.
        `linked`, `clock`: what else makes a link of what RosLink is made of, and tells the time.
        """
        self.kinematics, self.dry_run, self._name = kinematics, dry_run, name
        self._to, self._tells_guard = (f"{GUARDED}/{name}" if through_guard else name), through_guard and not dry_run
        self._readings = readings = Readings(name, tool, kinematics)
        self._commanded_ns, self._replayed, self._clock_ns = 0, False, clock
        self._frames, self._set_points = FramesWatch(name, base), SetPointsWatch(name)
        heard = (
            *(self._measurement(kind) for kind in KINDS),
            *self._frames.heard(),
            *self._set_points.heard(),
            Heard(f"{name}/operating_state", OPERATING_STATE, readings.hear_state, latched=True),
            Heard(f"{name}/error", STRING, readings.hear_error, latched=True),
            Heard(f"{name}/goal_reached", BOOL, readings.hear_goal),
            Heard(f"{name}/tool_type", STRING, readings.hear_tool, latched=True),
            Heard(TELEOPERATION, BOOL, readings.hear_teleoperation, latched=True),
            *(
                Heard(f"{name}/{topic}", ros_type, self._another(topic), others_only=True)
                for topic, ros_type in (MOTIONS | STOPS).items()
                if not (through_guard and topic in SERVOS)
            ),
        )
        servos = (*SERVOS, ALIVE) if through_guard else SERVOS
        says = (*(Said(f"{self._to}/{servo}", JOINT_STATE) for servo in servos), Said(f"{name}/hold", EMPTY))
        says += (
            Said(f"{name}/state_command", STRING_STAMPED),
            Said(f"{name}/trajectory_j/set_ratio", FLOAT64),
        )
        said = () if dry_run else says
        watched = tuple(f"{name}/{topic}" for topic in MOTIONS)
        self._link = linked(settings, naming, heard, said, watched, self._owner_changed)

    def state(self, now_ns: int) -> ArmState:
        """The newest that was heard; the first time, the connection is begun.

        Whoever gives a time that is not now replays something, and reaches no robot.
        """
        self._replayed = abs(now_ns - self._clock_ns()) > NOW_NS
        if self._replayed:
            return ArmState(0, NOTHING.joints, NOTHING.jaw_rad, Readiness.DISABLED, "it is real, and the time is not")
        self._link.open()
        if self._tells_guard:
            self._link.say(f"{self._to}/{ALIVE}", crtk.joint_command(np.zeros(1), self._clock_ns()))
        measured = self._readings.measured()
        judged = self._readings.judge(measured, self._commanded_ns, now_ns)
        moved = self._frames.judge(now_ns)
        if judged.readiness is Readiness.READY and moved:
            judged = Judged(Readiness.DISABLED, Code.MOVED, moved)
        if judged.readiness is Readiness.READY:
            judged = self._set_points.judge(now_ns) or judged
        else:
            self._set_points.let_go(now_ns)
        return ArmState(
            measured.measured_ns,
            measured.joints,
            measured.jaw_rad,
            judged.readiness,
            self._link.failed or judged.reason,
            judged.code,
            self._readings.busy,
            self._frames.still_since_ns,
            self._frames.T_camera_base,
        )

    def move(self, joints: Float64[np.ndarray, "6"], jaw_rad: float) -> None:
        """Send a set point for the arm and one for its jaw."""
        if self.dry_run or self._replayed:
            return
        self._commanded_ns = self._clock_ns()
        self._set_points.sent(joints, jaw_rad, self._commanded_ns)
        self._link.say(f"{self._to}/servo_jp", crtk.joint_command(joints, self._commanded_ns))
        self._link.say(f"{self._to}/jaw/servo_jp", crtk.joint_command(np.array([jaw_rad]), self._commanded_ns))

    def hold(self) -> None:
        """Have the console stop the arm where it is."""
        if not self.dry_run and not self._replayed:
            self._set_points.let_go(self._clock_ns())
            self._link.say(f"{self._name}/hold", crtk.empty())

    def change_state(self, word: StateWord, now_ns: int) -> str:
        """Send the word to the console; what it makes of it shows in the state."""
        if self.dry_run or self._replayed:
            return "nothing is sent in a dry run" if self.dry_run else "it is real, and the time is not"
        if why := self._link.failed or self._readings.changeable(word, now_ns):
            return why
        self._commanded_ns = self._clock_ns()
        self._link.say(f"{self._name}/state_command", crtk.state_command(word.name.lower(), self._commanded_ns))
        return ""

    def reached_state(self, word: StateWord) -> bool:
        """By the console's operating state, once it has had time to begin."""
        began = self._clock_ns() - self._commanded_ns > (BEGINS_NS if word is StateWord.HOME else 0)
        return began and self._readings.reached(word)

    def slow_down(self, ratio: float) -> None:
        """Tell the console the share of their speed that its own trajectories have."""
        if not self.dry_run and not self._replayed:
            self._link.say(f"{self._name}/trajectory_j/set_ratio", crtk.ratio(ratio))

    def close(self) -> None:
        """Hold what we moved, and let go; an arm that we did not move may be somebody else's by now."""
        if self._commanded_ns:
            self.hold()
        self._link.close()

    def _owner_changed(self, token: str, comes: bool) -> None:
        """Note who else could command the arm; the guard does so for us."""
        if f"/{GUARD_NODE}/" not in token:
            self._readings.owner_changed(token, comes)

    def _measurement(self, kind: str) -> Heard:
        ros_type = POSE_STAMPED if kind.endswith("_cp") else JOINT_STATE
        return Heard(f"{self._name}/{kind}", ros_type, lambda data, at_ns: self._readings.hear(kind, data, at_ns))

    def _another(self, topic: str) -> Callable[[bytes, int], None]:
        return lambda _data, at_ns: self._readings.hear_other(f"{self._name}/{topic}", at_ns)
