"""A PSM behind a console that speaks CRTK: joint set points out, measurements and the console's own state in.

Set points go to the guard beside the console at every tick, which passes on what may pass to `servo_jp` and
`jaw/servo_jp`; never to `move_*`: a console makes a joint-space trajectory of those, and mixing one with the other has
slammed arms. The last set point is held by the console when none follows, for it knows no time-out. A hold goes to the
console itself.
"""

from collections.abc import Callable, Collection
from typing import Protocol

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.backend import ArmState, Readiness
from agents.robot_bridge.dvrk.frames_moved import FramesWatch, SinceRegistration
from agents.robot_bridge.dvrk.guard_link import GuardLink
from agents.robot_bridge.dvrk.readings import KINDS, NOTHING, STOPPING, TELEOPERATION, Judged, Measured, Readings
from agents.robot_bridge.dvrk.set_points import SetPointsWatch
from agents.robot_bridge.plans import Code
from schemas.messages import StateWord
from shared.calibration.hand_eye.file import HandEye
from shared.clock import monotonic_ns
from shared.clock import now_ns as clock_ns
from shared.kinematics.arm import ArmKinematics
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.ros import crtk
from shared.ros.guarded import ALIVE, CHALLENGE, SET_POINT, Gate
from shared.ros.link import Heard, RosLink, Said
from shared.ros.naming import GUARD_NODE, Naming
from shared.ros.types import BOOL, EMPTY, FLOAT64, JOINT_STATE, OPERATING_STATE, POSE_STAMPED, STRING, STRING_STAMPED
from shared.runtime.session import SessionSettings

MOTIONS = {
    **dict.fromkeys(
        ("servo_jp", "move_jp", "servo_jr", "move_jr", "jaw/servo_jp", "jaw/move_jp", "servo_jf"), JOINT_STATE
    ),
    **dict.fromkeys(("servo_cp", "move_cp"), POSE_STAMPED),
}
"""Whoever publishes one of these beside us is another owner of the arm."""
SERVOS = {"servo_jp": 6, "jaw/servo_jp": 1}
"""Which the guard publishes for us, with how many positions."""
STOPS = {"free": EMPTY, "state_command": STRING_STAMPED}
"""Whoever sends one of these wants us to stop; that somebody could does not. A hold in mid-motion the guard tells."""

NOW_NS = 2_000_000_000
STANDS = np.array((2e-3, 2e-3, 2e-4, 2e-3, 2e-3, 2e-3))
STANDS_NS = 200_000_000
"""An arm whose joints (rad, the third m) have stood for so long since a hold holds."""
HALT_AGAIN_NS = 5_000_000
"""A hold that was said so lately, a tick ago, is not said again for one more halt: the next tick says it again."""
BEGINS_NS = 300_000_000
"""A console that was told to home an arm that is homed already says for a moment longer that it is."""


class Linked(Protocol):
    """As much of a RosLink as an arm needs."""

    failed: str
    broken: int

    def open(self) -> None:
        """Begin to hear."""
        ...

    def say(self, topic: str, payload: bytes) -> bool:
        """Speak on a topic; whether that could be handed over."""
        ...

    def close(self) -> None:
        """Neither hear nor speak any more."""
        ...


class DvrkPsm:
    """One PSM; in a dry run, or until it is opened, nothing is ever sent."""

    accepts_replayed_time = False
    is_real = True

    def __init__(
        self,
        name: str,
        settings: SessionSettings,
        naming: Naming,
        tool: str,
        dry_run: bool,
        kinematics: ArmKinematics = LARGE_NEEDLE_DRIVER,
        base: HandEye | None = None,
        has_no: Collection[str] = (),
        since: SinceRegistration | None = None,
        linked: Callable[..., Linked] = RosLink,
        clock: Callable[[], int] = clock_ns,
        monotonic: Callable[[], int] = monotonic_ns,
    ) -> None:
        """The arm of that name on the console that is reached so; `tool` as Readings has it.

        `base`: where it is, to follow it where that is told from the ECM.
        `has_no`: what this rig has none of, so that its silence says nothing (`untold`).
        `since`: what has moved since the arm was registered, where a bridge before this one saw it.
        `linked`, `clock`, `monotonic`: what else makes a link of what RosLink is made of, and tells the time.
        """
        self.kinematics, self.dry_run, self._name = kinematics, dry_run, name
        self._readings = readings = Readings(name, tool, kinematics)
        self._commanded_ns, self._replayed, self._clock_ns, self._monotonic_ns = 0, False, clock, monotonic
        self._frames, self._set_points = FramesWatch(name, base, since), SetPointsWatch(name)
        self._guard = GuardLink(name, self._say, monotonic)
        self._has_no, self._halted, self._arming_id = frozenset(has_no), False, ""
        self._held_ns: int | None = None
        self._console_held_ns = -1
        self._said_ns = self._measured_ns = self._heard_ns = 0
        self._stands, self._stands_ns = NOTHING.joints, 0
        self._broken, self._guard_held = 0, ("", "")
        heard = (
            *(self._measurement(kind) for kind in KINDS),
            *self._frames.heard(),
            *self._set_points.heard(),
            Heard(f"{name}/operating_state", OPERATING_STATE, readings.hear_state, latched=True),
            Heard(f"{name}/error", STRING, readings.hear_error, latched=True),
            Heard(f"{name}/goal_reached", BOOL, readings.hear_goal),
            Heard(f"{name}/tool_type", STRING, readings.hear_tool, latched=True),
            Heard(TELEOPERATION, BOOL, readings.hear_teleoperation, latched=True),
            Heard(self._guard.keys[CHALLENGE], "", self._guard.hear, plain=True),
            Heard(f"{name}/hold", EMPTY, self._hear_hold, others_only=True),
            *(
                Heard(f"{name}/{topic}", ros_type, self._another(topic), others_only=True)
                for topic, ros_type in (MOTIONS | STOPS).items()
            ),
        )
        says = (
            *(Said(self._guard.keys[topic], "", plain=True) for topic in (SET_POINT, ALIVE)),
            Said(f"{name}/hold", EMPTY),
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
        # where the clock was set back, no hold is of the time to come
        self._console_held_ns = min(self._console_held_ns, now_ns)
        if not self.dry_run:
            self._guard.turn()
        measured = self._readings.measured()
        judged = self._judge(measured, now_ns)
        if measured.measured_ns != self._measured_ns:
            self._measured_ns, self._heard_ns = measured.measured_ns, self._monotonic_ns()
        if not (np.abs(measured.joints - self._stands) <= STANDS).all():
            self._stands, self._stands_ns = measured.joints, self._monotonic_ns()
        told = self._guard.told
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
            told.challenge if told else 0,
            told is not None and told.pedal,
            tuple(told for name, told in self._untold().items() if name not in self._has_no),
            self._set_points.jaw_rad,
            measured.jaw_effort,
            self._readings.instrument,
        )

    def _judge(self, measured: Measured, now_ns: int) -> Judged:
        judged, moved = self._readings.judge(measured, self._commanded_ns, now_ns), self._frames.judge(now_ns)
        if judged.readiness is Readiness.READY and moved:
            judged = Judged(Readiness.DISABLED, Code.MOVED, moved)
        told = self._guard.told
        if told is not None and told.gate is Gate.HELD and (told.arming_id, told.reason) != self._guard_held:
            self._set_points.let_go(now_ns)
        self._guard_held = (told.arming_id, told.reason) if told is not None else ("", "")
        broken, self._broken = self._broken, self._link.broken
        if broken != self._broken and self._arming_id:
            judged = Judged(Readiness.DISABLED, Code.STALE_STATE, "the link to the robot broke: arm again")
        if judged.readiness is not Readiness.READY:
            self._set_points.let_go(now_ns)
            return judged
        unguarded = None if self.dry_run else self._guard.judge(self._arming_id)
        return self._set_points.judge(now_ns) or unguarded or judged

    def move(self, joints: Float64[np.ndarray, "6"], jaw_rad: float, arming_id: str) -> None:
        """Send a set point of the arm and its jaw to the guard."""
        if self.dry_run or self._replayed or self._halted:
            return
        self._commanded_ns, self._arming_id, self._held_ns = self._clock_ns(), arming_id, None
        self._set_points.sent(joints, jaw_rad, self._commanded_ns)
        self._guard.move((*(float(joint) for joint in joints), float(jaw_rad)), arming_id)

    def lets_through(self, arming_id: str) -> bool:
        """Whether the guard says so."""
        told = self._guard.told
        return told is not None and told.gate is Gate.OPEN and told.arming_id == arming_id

    def finish(self, arming_id: str) -> None:
        """Tell the guard that the motion has ended as it should."""
        self._arming_id = ""
        if not self.dry_run:
            self._guard.finish(arming_id)

    def hold(self) -> bool:
        """Have the console stop the arm where it is, whatever the time and whoever's that is."""
        self._arming_id = ""
        if self.dry_run:
            return True
        said = self._link.say(f"{self._name}/hold", crtk.empty())
        self._set_points.let_go(self._clock_ns())
        if said:
            self._said_ns = self._monotonic_ns()
            self._held_ns = self._said_ns if self._held_ns is None else self._held_ns
        return said

    def halt(self) -> None:
        """Hold, and send no set point until a plan is armed again; of many halts at once the console hears a few."""
        if not self._halted or self._held_ns is None or self._monotonic_ns() - self._said_ns >= HALT_AGAIN_NS:
            self._halted = True
            self.hold()

    @property
    def halted(self) -> bool:
        """Whether it was halted since it was armed last."""
        return self._halted

    def rearm(self, asked_ns: int) -> bool:
        """Set points may be sent again, unless somebody has said hold at the console since whoever arms heard of it."""
        # a hold that another thread hears meanwhile halts after this, or is seen below
        self._halted, self._held_ns = False, None
        if self._console_held_ns >= asked_ns:
            self._halted = True
        return not self._halted

    @property
    def holds(self) -> bool:
        """Whether a hold was handed over, and the arm has been measured to stand for a while since."""
        if self.dry_run:
            return True
        return self._held_ns is not None and self._heard_ns - max(self._held_ns, self._stands_ns) > STANDS_NS

    def change_state(self, word: StateWord, now_ns: int) -> str:
        """Send the word to the console; what it makes of it shows in the state."""
        if self.dry_run:
            return "nothing is sent in a dry run"
        stops = word in STOPPING
        if not stops and (why := self._why_unchangeable(word, now_ns)):
            return why
        said = self._link.say(f"{self._name}/state_command", crtk.state_command(word.name.lower(), self._clock_ns()))
        self._commanded_ns = self._clock_ns()
        return "" if said else self._link.failed or "the robot's Zenoh is not reached"

    def _why_unchangeable(self, word: StateWord, now_ns: int) -> str:
        if self._replayed:
            return "it is real, and the time is not"
        return self._link.failed or self._readings.changeable(word, now_ns)

    def _untold(self) -> dict[str, tuple[str, str]]:
        return {} if self.dry_run else self._readings.untold | self._frames.untold

    def _say(self, key: str, payload: bytes) -> bool:
        return self._link.say(key, payload)

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

    def _hear_hold(self, _data: bytes, _at_ns: int) -> None:
        """Somebody else says hold, the guard perhaps: before the guard lets our arming pass, that ends it as well."""
        self._console_held_ns = self._clock_ns()
        told = self._guard.told
        if told is None or told.gate is not Gate.OPEN or told.arming_id != self._arming_id:
            self._halted = True

    def _measurement(self, kind: str) -> Heard:
        ros_type = POSE_STAMPED if kind.endswith("_cp") else JOINT_STATE
        return Heard(f"{self._name}/{kind}", ros_type, lambda data, at_ns: self._readings.hear(kind, data, at_ns))

    def _another(self, topic: str) -> Callable[[bytes, int], None]:
        def hear(data: bytes, at_ns: int) -> None:
            if topic not in SERVOS or not self._guard.ours(data, SERVOS[topic]):
                self._readings.hear_other(f"{self._name}/{topic}", at_ns)

        return hear
