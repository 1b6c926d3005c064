"""What a console and others have said of one arm, and what of that speaks against moving it."""

import dataclasses
import threading
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.backend import Readiness
from agents.robot_bridge.plans import Code
from schemas.messages import StateWord
from shared.kinematics.arm import ArmKinematics
from shared.rigid_transforms import angle_between
from shared.ros import crtk
from shared.ros.far_clock import FarClock
from shared.ros.types import RosMessageError

SECOND_NS = 1_000_000_000
ERROR_NS, OTHERS_NS, OWN_NS = 1 * SECOND_NS, 2 * SECOND_NS, 1 * SECOND_NS
"""How long an error, another's command, and a command of our own count after they came."""


TELEOPERATION = "console/teleop/enabled"
"""Of all of a console: it tells of no arm by itself."""

STOPPING = (StateWord.PAUSE, StateWord.DISABLE)
"""Words that only stop: they are always sent."""
LEADS_TO = {
    StateWord.ENABLE: "ENABLED",
    StateWord.RESUME: "ENABLED",
    StateWord.HOME: "ENABLED",
    StateWord.PAUSE: "PAUSED",
    StateWord.DISABLE: "DISABLED",
}


class Judged(NamedTuple):
    """Whether an arm may be moved, and if not, why."""

    readiness: Readiness
    code: Code = Code.NOT_READY
    reason: str = ""


class Raw(NamedTuple):
    """Bytes that are not read yet, and when they came."""

    data: bytes
    arrived_ns: int


@dataclass
class Said:
    """What was said, the newest of each; with when it came where that counts.

    Fields:
        left_ready: why the arm was not ready, even where it soon was again; None once that was told.
        missed_ns: when the console said that a goal was not reached.
        publishers: who else could command the arm, by their tokens.
        teleoperation: the console's own is on; None where nobody has said.
    """

    raw: dict[str, Raw] = field(default_factory=dict)
    operating: crtk.OperatingState | None = None
    left_ready: Judged | None = None
    error: tuple[str, int] = ("", 0)
    missed_ns: int = 0
    tool: str = ""
    other: tuple[str, int] = ("", 0)
    publishers: set[str] = field(default_factory=set)
    teleoperation: bool | None = None


def own_word(said: Said, operating: crtk.OperatingState, now_ns: int) -> Judged | None:
    """What the console itself says against moving the arm."""
    if now_ns - said.error[1] < ERROR_NS:
        return Judged(Readiness.FAULT, Code.ERROR_STATE, f"its console says: {said.error[0]}")
    if now_ns - said.missed_ns < ERROR_NS:
        return Judged(Readiness.FAULT, Code.GOAL_NOT_REACHED, "its console says that a goal was not reached")
    return unready(operating) or said.left_ready


def others(said: Said, commanded_ns: int, now_ns: int) -> Judged | None:
    """Who else commands the arm."""
    if said.publishers:
        who = f"somebody else could command it: {min(said.publishers)}; have one owner only"
    elif now_ns - said.other[1] < OTHERS_NS:
        who = f"somebody else commands it by {said.other[0]}; have one owner only"
    elif said.teleoperation:
        who = "its console's teleoperation is on; have one owner only"
    elif said.operating is not None and said.operating.is_busy and now_ns - commanded_ns > OWN_NS:
        who = "it is busy with a motion that is not ours"
    else:
        return None
    return Judged(Readiness.DISABLED, Code.OTHER_OWNER, who)


def unready(state: crtk.OperatingState) -> Judged | None:
    """Why an arm in this state takes no commands; None where it does."""
    if state.state == "ENABLED":
        return None if state.is_homed else Judged(Readiness.DISABLED, Code.NOT_HOMED, "it is not homed")
    why = f"its operating state is {state.state}, not ENABLED"
    if state.state == "FAULT":
        return Judged(Readiness.FAULT, Code.ERROR_STATE, why)
    return Judged(Readiness.DISABLED, Code.NOT_ENABLED, why)


def unchangeable(said: Said, operating: crtk.OperatingState, word: StateWord, now_ns: int) -> str:
    """Why the arm's state must not be changed in this way now; empty where it may."""
    if word in STOPPING:
        return ""
    if said.publishers or now_ns - said.other[1] < OTHERS_NS or said.teleoperation:
        who = min(said.publishers, default=TELEOPERATION if said.teleoperation else said.other[0])
        return f"somebody else has to do with it: {who}; have one owner only"
    allowed = {StateWord.ENABLE: ("DISABLED", "FAULT"), StateWord.RESUME: ("PAUSED",), StateWord.HOME: ("ENABLED",)}
    if operating.state not in allowed[word]:
        needed = " or ".join(allowed[word])
        return f"its operating state is {operating.state}, where {word.name.lower()} needs {needed}"
    return "it is busy with another motion" if operating.is_busy else ""


CLOCK_SET_NS = 1 * SECOND_NS
"""A stamp this far before the last one tells that the robot's clock was set, a smaller step that messages overtook."""
POSE_AGE_NS = SECOND_NS // 2
SAME_M, SAME_RAD = 0.003, 0.1
"""How near the console's own pose must be to that of our kinematics; tools differ by more."""
NEAR_NS = 50_000_000
"""A pose is compared with the joints of its own time, between two measurements so near to each other: an arm moves by
4 mm meanwhile, and along a line but for a small part of that. Or after the last one, where the arm stood before."""
SAME_TIME_NS, STANDS = 5_000_000, 1e-3
"""An arm moves by 0.4 mm meanwhile; an arm none of whose joints (rad, m) has moved by as much stands."""
KEPT = 64
"""Measurements of joints, and poses that wait for those of their time: a third of a second of them at 200 Hz."""


KINDS: tuple[str, ...] = ("measured_js", "jaw/measured_js", "local/measured_cp")


@dataclass(frozen=True, eq=False)
class Measured:
    """The arm as measured; NaN where nothing is known yet.

    Fields:
        measured_ns: when, on this host's clock.
        jaw_effort: None where it is not told.
    """

    measured_ns: int
    joints: Float64[np.ndarray, "6"]
    jaw_rad: float
    jaw_effort: float | None = None


NO_EFFORT = np.zeros(0)
UNKNOWN = np.full(6, np.nan)
NOTHING = Measured(0, UNKNOWN, float("nan"))


class _Apart(NamedTuple):
    """How far the console's pose was from that of our kinematics, and when."""

    at_ns: int
    metres: float
    radians: float

    def off(self) -> float:
        """In what is allowed."""
        return max(self.metres / SAME_M, self.radians / SAME_RAD)


class Readings:
    """Takes what comes from other threads; `measured` and `judge` are for the bridge's own."""

    def __init__(self, arm: str, tool: str, kinematics: ArmKinematics) -> None:
        """An arm by its console's name, and the type of tool whose kinematics are used; empty for any."""
        self._arm, self._tool, self._kinematics = arm, tool, kinematics
        self._lock, self._said = threading.Lock(), Said()
        self._clocks = {kind: FarClock() for kind in KINDS}
        self._stamps = dict.fromkeys(KINDS, 0)
        self._decoded = dict.fromkeys(KINDS, Raw(b"", 0))
        self._newest: dict[str, tuple[int, np.ndarray]] = {}
        self._faulty, self._apart = "", _Apart(0, 0.0, 0.0)
        self._joints = deque[tuple[int, np.ndarray]](maxlen=KEPT)
        self._poses = deque[tuple[int, int, np.ndarray]](maxlen=KEPT)
        self._jaw_effort: float | None = None

    def hear(self, kind: str, data: bytes, arrived_ns: int) -> None:
        """Keep the newest measurement of a kind, unread."""
        with self._lock:
            self._said.raw[kind] = Raw(data, arrived_ns)

    def hear_state(self, data: bytes, _arrived_ns: int) -> None:
        """Note the operating state, and that the arm was not ready even where it soon is again."""
        try:
            state = crtk.operating_state(data)
        except RosMessageError:
            # what cannot be read may have been anything
            state = crtk.OperatingState("not readable", False, False)
        with self._lock:
            self._said.operating = state
            self._said.left_ready = unready(state) or self._said.left_ready

    def hear_error(self, data: bytes, arrived_ns: int) -> None:
        """Note an error."""
        with self._lock:
            self._said.error = _text(data), arrived_ns

    def hear_goal(self, data: bytes, arrived_ns: int) -> None:
        """Note that a goal was not reached; what cannot be read may say so."""
        try:
            reached = crtk.flag(data)
        except RosMessageError:
            reached = False
        if not reached:
            with self._lock:
                self._said.missed_ns = arrived_ns

    def hear_tool(self, data: bytes, _arrived_ns: int) -> None:
        """Note which tool is mounted."""
        with self._lock:
            self._said.tool = _text(data)

    def hear_teleoperation(self, data: bytes, _arrived_ns: int) -> None:
        """Note whether the console's own teleoperation is on; what cannot be read may say so."""
        try:
            on = crtk.flag(data)
        except RosMessageError:
            on = True
        with self._lock:
            self._said.teleoperation = on

    def hear_other(self, topic: str, arrived_ns: int) -> None:
        """Note that somebody else has commanded the arm."""
        with self._lock:
            self._said.other = topic, arrived_ns

    def owner_changed(self, token: str, comes: bool) -> None:
        """Note that somebody else could command the arm, or no longer can."""
        with self._lock:
            (self._said.publishers.add if comes else self._said.publishers.discard)(token)

    def measured(self) -> Measured:
        """The newest measurements, read."""
        with self._lock:
            raw = dict(self._said.raw)
        self._faulty = ""
        for kind, newest in raw.items():
            if newest is not self._decoded[kind]:
                self._decoded[kind] = newest
                self._read(kind, newest)
        joints, jaw = self._newest.get("measured_js"), self._newest.get("jaw/measured_js")
        if joints is None or jaw is None:
            return NOTHING
        return Measured(min(joints[0], jaw[0]), joints[1], float(jaw[1][0]), self._jaw_effort)

    def judge(self, measured: Measured, commanded_ns: int, now_ns: int) -> Judged:
        """Whether the arm would follow, and may be moved by us; and if not, why. What is over by now is told once."""
        with self._lock:
            said = dataclasses.replace(self._said, publishers=set(self._said.publishers))
            self._said.left_ready = None
        if said.operating is None or measured is NOTHING:
            silent = f"nothing was heard of {self._arm} yet: see that its console and Zenoh run there"
            return Judged(Readiness.DISABLED, Code.NOT_READY, silent)
        return (
            own_word(said, said.operating, now_ns)
            or self._reading()
            or self._tool_mounted(said)
            or others(said, commanded_ns, now_ns)
            or self._same_place(now_ns)
            or Judged(Readiness.READY)
        )

    @property
    def busy(self) -> bool:
        """Whether the console says that the arm makes a motion of its own."""
        operating = self._said.operating
        return operating is not None and operating.is_busy

    @property
    def instrument(self) -> str:
        """The tool that the console has on the arm; empty where it has not said, or something that is no name."""
        tool = self._said.tool
        return tool if tool.isprintable() else ""

    def reached(self, word: StateWord) -> bool:
        """Whether the console's operating state is the one that a word leads to, and it is not busy."""
        operating = self._said.operating
        if operating is None or operating.is_busy or operating.state != LEADS_TO[word]:
            return False
        return operating.is_homed or word is not StateWord.HOME

    def changeable(self, word: StateWord, now_ns: int) -> str:
        """Why the arm's state must not be changed in this way now; empty where it may."""
        with self._lock:
            said = dataclasses.replace(self._said, publishers=set(self._said.publishers))
        if said.operating is None:
            return f"nothing was heard of {self._arm} yet: see that its console and Zenoh run there"
        return unchangeable(said, said.operating, word, now_ns)

    @property
    def untold(self) -> dict[str, tuple[str, str]]:
        """What a real arm needs to be told and was not, by its name: what that is, and what to do."""
        if self._said.teleoperation is not None:
            return {}
        what = "its console has not said whether its teleoperation is on"
        remedy = "switch teleoperation on and off once, or say has_no = ['teleoperation'] where there is none"
        return {"teleoperation": (what, remedy)}

    def _reading(self) -> Judged | None:
        return Judged(Readiness.FAULT, Code.ERROR_STATE, self._faulty) if self._faulty else None

    def _tool_mounted(self, said: Said) -> Judged | None:
        if not self._tool or said.tool == self._tool:
            return None
        other = f"its tool is {said.tool or 'not told'}, and the kinematics are of {self._tool}"
        return Judged(Readiness.DISABLED, Code.WRONG_TOOL, other)

    def _same_place(self, now_ns: int) -> Judged | None:
        """Whether the console's own pose of the tool is where our kinematics have it."""
        found = list[_Apart]()
        while self._poses and (joints := self._joints_at(self._poses[0][0])) is not None:
            _, at_ns, T = self._poses.popleft()
            if joints is UNKNOWN:
                continue
            ours = self._kinematics.forward(joints)
            apart_m = float(np.linalg.norm(T[:3, 3] - ours[:3, 3]))
            found.append(_Apart(at_ns, apart_m, float(angle_between(T[:3, :3], ours[:3, :3]))))
        # of several since the turn before the worst one counts
        self._apart = max(
            found, key=lambda each: max(each.metres / SAME_M, each.radians / SAME_RAD), default=self._apart
        )
        if now_ns - self._apart.at_ns > POSE_AGE_NS:
            silent = "its local/measured_cp, by which the kinematics are checked, does not come with its measured_js"
            return Judged(Readiness.FAULT, Code.STALE_STATE, silent)
        if self._apart.off() <= 1:
            return None
        where = f"{1e3 * self._apart.metres:.1f} mm and {self._apart.radians:.2f} rad"
        other = f"its console has the tool {where} from where our kinematics do: another arm or tool"
        return Judged(Readiness.FAULT, Code.OTHER_POSE, other)

    def _joints_at(self, stamp_ns: int) -> Float64[np.ndarray, "6"] | None:
        """The joints at a time of the robot's clock: None where they are not known yet, UNKNOWN if they never will."""
        before = next((i for i in reversed(range(len(self._joints))) if self._joints[i][0] <= stamp_ns), -1)
        after = before + 1
        if after == len(self._joints):
            *_, (one_ns, one), (other_ns, other) = ((0, NOTHING.joints), (0, NOTHING.joints), *self._joints)
            stood = other_ns - one_ns > 0 and bool((np.abs(other - one) < STANDS).all())
            return other if stamp_ns - other_ns <= (NEAR_NS if stood else SAME_TIME_NS) else None
        other_ns, other = self._joints[after]
        if after == 0:
            return other if other_ns - stamp_ns <= SAME_TIME_NS else UNKNOWN
        one_ns, one = self._joints[after - 1]
        if other_ns - one_ns > NEAR_NS and not (np.abs(other - one) < STANDS).all():
            return UNKNOWN
        return one + (stamp_ns - one_ns) / (other_ns - one_ns) * (other - one)

    def _read(self, kind: str, newest: Raw) -> None:
        try:
            effort = NO_EFFORT
            if kind == "local/measured_cp":
                stamp_ns, _, values = crtk.pose(newest.data)
            else:
                stamp_ns, values, effort = crtk.joints(newest.data)
                if values.shape != ((6,) if kind == "measured_js" else (1,)) or not np.isfinite(values).all():
                    self._faulty = f"its {kind} has {values.size} joints, or one that is not finite"
                    return
        except RosMessageError as error:
            self._faulty = f"its {kind} cannot be read: {error}"
            return
        before_ns, self._stamps[kind] = self._stamps[kind], stamp_ns
        if stamp_ns < before_ns:
            if before_ns - stamp_ns < CLOCK_SET_NS:
                # it was overtaken: what is known already is newer
                self._stamps[kind] = before_ns
                return
            self._clocks[kind].forget()
            # those of before are of another time
            {"measured_js": self._joints, "local/measured_cp": self._poses}.get(kind, deque()).clear()
        if kind == "jaw/measured_js":
            told = effort.size == 1 and np.isfinite(effort).all()
            self._jaw_effort = float(effort[0]) if told else None
        at_ns = self._clocks[kind].measured_ns(stamp_ns, newest.arrived_ns)
        self._newest[kind] = at_ns, values
        if kind == "measured_js":
            self._joints.append((stamp_ns, values))
        elif kind == "local/measured_cp":
            self._poses.append((stamp_ns, at_ns, values))


def _text(data: bytes) -> str:
    try:
        return crtk.text(data)
    except RosMessageError as error:
        return f"something not readable ({error})"
