"""What a console has told of one arm, and what speaks against moving it."""

import threading
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.backend import Readiness
from schemas.messages import StateWord
from shared.kinematics.arm import ArmKinematics
from shared.rigid_transforms import angle_between
from shared.ros import crtk
from shared.ros.far_clock import FarClock
from shared.ros.types import RosMessageError

SECOND_NS = 1_000_000_000
ERROR_NS, OTHERS_NS, OWN_NS = 1 * SECOND_NS, 2 * SECOND_NS, 1 * SECOND_NS
"""How long an error, another's command, and a command of our own count after they came."""
CLOCK_SET_NS = 1 * SECOND_NS
"""A stamp this far before the last one tells that the robot's clock was set, a smaller step that messages overtook."""
POSE_AGE_NS = SECOND_NS // 2
SAME_M, SAME_RAD = 0.003, 0.1
"""How near the console's own pose must be to that of our kinematics: an arm moves meanwhile, and tools differ more."""
KINDS: tuple[str, ...] = ("measured_js", "jaw/measured_js", "local/measured_cp")


class _Raw(NamedTuple):
    data: bytes
    arrived_ns: int


@dataclass
class _Said:
    """What the console has said, and others; each with when it came."""

    raw: dict[str, _Raw] = field(default_factory=dict)
    operating: crtk.OperatingState | None = None
    left_ready: str = ""
    error: tuple[str, int] = ("", 0)
    tool: str = ""
    other: tuple[str, int] = ("", 0)
    publishers: set[str] = field(default_factory=set)


@dataclass(frozen=True, eq=False)
class Measured:
    """The arm as measured; NaN where nothing is known yet.

    Fields:
        measured_ns: when, on this host's clock.
    """

    measured_ns: int
    joints: Float64[np.ndarray, "6"]
    jaw_rad: float


NOTHING = Measured(0, np.full(6, np.nan), float("nan"))


class Readings:
    """Takes what comes from other threads; `measured` and `judge` are for the bridge's own."""

    def __init__(self, arm: str, tool: str, kinematics: ArmKinematics) -> None:
        """An arm by its console's name, and the type of tool whose kinematics are used; empty for any."""
        self._arm, self._tool, self._kinematics = arm, tool, kinematics
        self._lock, self._said = threading.Lock(), _Said()
        self._clocks = {kind: FarClock() for kind in KINDS}
        self._stamps = dict.fromkeys(KINDS, 0)
        self._decoded = dict.fromkeys(KINDS, _Raw(b"", 0))
        self._newest: dict[str, tuple[int, np.ndarray]] = {}
        self._faulty = ""

    def hear(self, kind: str, data: bytes, arrived_ns: int) -> None:
        """Keep the newest measurement of a kind, unread."""
        with self._lock:
            self._said.raw[kind] = _Raw(data, arrived_ns)

    def hear_state(self, data: bytes, _arrived_ns: int) -> None:
        """Note the operating state, and that the arm was not ready even where it soon is again."""
        try:
            state = crtk.operating_state(data)
        except RosMessageError:
            # what cannot be read may have been anything
            state = crtk.OperatingState("not readable", False, False)
        with self._lock:
            self._said.operating = state
            self._said.left_ready = _unready(state) or self._said.left_ready

    def hear_error(self, data: bytes, arrived_ns: int) -> None:
        """Note an error."""
        with self._lock:
            self._said.error = _text(data), arrived_ns

    def hear_tool(self, data: bytes, _arrived_ns: int) -> None:
        """Note which tool is mounted."""
        with self._lock:
            self._said.tool = _text(data)

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
        return Measured(min(joints[0], jaw[0]), joints[1], float(jaw[1][0]))

    def judge(self, measured: Measured, commanded_ns: int, now_ns: int) -> tuple[Readiness, str]:
        """Whether the arm would follow, and may be moved by us; and if not, why. What is over by now is told once."""
        with self._lock:
            said = self._said
            left, said.left_ready = said.left_ready, ""
            operating, error, tool, other = said.operating, said.error, said.tool, said.other
            publishers = sorted(said.publishers)
        if operating is None or measured is NOTHING:
            return Readiness.DISABLED, f"nothing was heard of {self._arm} yet: see that its console and Zenoh run there"
        if now_ns - error[1] < ERROR_NS:
            return Readiness.FAULT, f"its console says: {error[0]}"
        if why := _unready(operating) or left:
            return (Readiness.FAULT if "FAULT" in why else Readiness.DISABLED), why
        if self._faulty:
            return Readiness.FAULT, self._faulty
        if self._tool and tool != self._tool:
            return Readiness.DISABLED, f"its tool is {tool or 'not told'}, and the kinematics are of {self._tool}"
        if publishers:
            return Readiness.DISABLED, f"somebody else could command it: {publishers[0]}; have one owner only"
        if now_ns - other[1] < OTHERS_NS:
            return Readiness.DISABLED, f"somebody else commands it by {other[0]}; have one owner only"
        if operating.is_busy and now_ns - commanded_ns > OWN_NS:
            return Readiness.DISABLED, "it is busy with a motion that is not ours"
        return self._same_place(measured, now_ns)

    def changeable(self, word: StateWord, now_ns: int) -> str:
        """Why the arm's state must not be changed in this way now; empty where it may."""
        with self._lock:
            said = self._said
            operating, other, publishers = said.operating, said.other, sorted(said.publishers)
        if operating is None:
            return f"nothing was heard of {self._arm} yet: see that its console and Zenoh run there"
        if word is StateWord.PAUSE or word is StateWord.DISABLE:
            return ""
        if publishers or now_ns - other[1] < OTHERS_NS:
            return f"somebody else has to do with it: {publishers[0] if publishers else other[0]}; have one owner only"
        allowed = {StateWord.ENABLE: ("DISABLED", "FAULT"), StateWord.RESUME: ("PAUSED",), StateWord.HOME: ("ENABLED",)}
        if operating.state not in allowed[word]:
            needed = " or ".join(allowed[word])
            return f"its operating state is {operating.state}, where {word.name.lower()} needs {needed}"
        return "it is busy with another motion" if operating.is_busy else ""

    def _same_place(self, measured: Measured, now_ns: int) -> tuple[Readiness, str]:
        """Whether the console's own pose of the tool is where our kinematics have it."""
        at_ns, T = self._newest.get("local/measured_cp", (0, np.eye(4)))
        if now_ns - at_ns > POSE_AGE_NS:
            return Readiness.FAULT, "its local/measured_cp does not come, by which the kinematics are checked"
        ours = self._kinematics.forward(measured.joints)
        apart_m = float(np.linalg.norm(T[:3, 3] - ours[:3, 3]))
        apart_rad = float(angle_between(T[:3, :3], ours[:3, :3]))
        if apart_m > SAME_M or apart_rad > SAME_RAD:
            where = f"{1e3 * apart_m:.1f} mm and {apart_rad:.2f} rad"
            return (
                Readiness.FAULT,
                f"its console has the tool {where} from where our kinematics do: another arm or tool",
            )
        return Readiness.READY, ""

    def _read(self, kind: str, newest: _Raw) -> None:
        try:
            if kind == "local/measured_cp":
                stamp_ns, _, values = crtk.pose(newest.data)
            else:
                stamp_ns, values = crtk.joints(newest.data)
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
        self._newest[kind] = self._clocks[kind].measured_ns(stamp_ns, newest.arrived_ns), values


def _unready(state: crtk.OperatingState) -> str:
    """Why an arm in this state takes no commands; empty where it does."""
    if state.state != "ENABLED":
        return f"its operating state is {state.state}, not ENABLED"
    return "" if state.is_homed else "it is not homed"


def _text(data: bytes) -> str:
    try:
        return crtk.text(data)
    except RosMessageError as error:
        return f"something not readable ({error})"
