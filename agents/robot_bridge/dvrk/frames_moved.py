"""Whether what a plan stands on has moved: the camera, the set-up joints, or the arm in somebody's hands.

A thread that was seen before is then elsewhere, and so are plan and arming. What a console publishes of it:

- `{arm}/measured_cp` and `{arm}/local/measured_cp` are one pose in two frames, so that T_reference_base =
  measured · local⁻¹ changes where set-up joints move, or an ECM that it is told from;
- `ECM/local/measured_cp`, the endoscope's tip; with a base that is told from the ECM (`Reference.ECM_BASE`),
  T_camera_base follows it, and without one the registration holds no longer;
- buttons: the pedals of camera and clutch, and those on the arms that let go of the arm or of its set-up joints.

Topics: jhu-dvrk/sawIntuitiveResearchKit, API 2.x; a button's message is sensor_msgs/Joy, 1 where it is pressed.
"""

import threading
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from shared.calibration.hand_eye.file import HandEye, Reference
from shared.rigid_transforms import angle_between, inverse
from shared.ros import crtk
from shared.ros.link import Heard
from shared.ros.types import JOY, POSE_STAMPED, RosMessageError

MOVED_M, MOVED_RAD = 1e-3, 5e-3
"""A frame that is farther from where it was has moved; 5 mrad are 1 mm at the end of a shaft."""
SAME_TIME_NS = 2_000_000
"""Two poses of one arm are compared where they are of the same time: it moves 0.4 mm meanwhile at most."""
SETTLED_NS = 500_000_000
"""So long after it moved last, a frame stands still."""
ECM_AGE_NS = 1_000_000_000
ECM = "ECM"
CLUTCHES = ("footpedals/clutch", "console/clutch")
PEDALS = ("footpedals/camera", "footpedals/clutch", "console/camera", "console/clutch")
MEASURED, LOCAL, TIP = "measured_cp", "local/measured_cp", "tip"


class _Raw(NamedTuple):
    data: bytes
    arrived_ns: int


class Apart(NamedTuple):
    """How far two poses of a frame are from each other."""

    metres: float
    radians: float

    @property
    def moved(self) -> bool:
        """Whether that is more than noise."""
        return self.metres > MOVED_M or self.radians > MOVED_RAD

    def __str__(self) -> str:
        return f"{1e3 * self.metres:.1f} mm and {np.degrees(self.radians):.1f} degrees"


def apart(one: Float64[np.ndarray, "4 4"], other: Float64[np.ndarray, "4 4"]) -> Apart:
    """The distance of the origins, and the angle between the axes."""
    turned = float(angle_between(one[:3, :3], other[:3, :3]))
    return Apart(float(np.linalg.norm(one[:3, 3] - other[:3, 3])), turned)


class FramesWatch:
    """Hears frames and buttons from other threads; `judge` is for the bridge's own.

    Fields:
        still_since_ns: what was seen before is elsewhere now.
        T_camera_base: as it follows from where the ECM is; None where it does not depend on that, or is not known yet.
    """

    def __init__(self, arm: str, base: HandEye | None) -> None:
        """An arm by its console's name; with a `base` that is told from the ECM, it is followed."""
        self._arm, self._base = arm, base if base is not None and base.reference is Reference.ECM_BASE else None
        self.still_since_ns, self.T_camera_base = 0, None
        self._lock = threading.Lock()
        self._raw: dict[str, _Raw] = {}
        self._pressed: set[str] = set()
        self._touched: str = ""
        self._heard_of = set[str]()
        self._let_go = ""
        self._last: dict[str, Float64[np.ndarray, "4 4"]] = {}
        self._first: dict[str, Float64[np.ndarray, "4 4"]] = {}
        self._what = ""
        self._read: dict[str, tuple[_Raw, crtk.Pose | None]] = {}

    def heard(self) -> tuple[Heard, ...]:
        """The topics to hear; that there are none of them says nothing."""
        poses = {MEASURED: f"{self._arm}/{MEASURED}", LOCAL: f"{self._arm}/{LOCAL}", TIP: f"{ECM}/{LOCAL}"}
        io = (f"{arm}/io/{button}" for arm in (self._arm, ECM) for button in ("manip_clutch", "suj_clutch"))
        return (
            *(
                Heard(t, POSE_STAMPED, lambda data, at, k=kind: self.hear_pose(k, data, at))
                for kind, t in poses.items()
            ),
            *(Heard(t, JOY, lambda data, _, t=t: self.hear_button(t, data)) for t in (*PEDALS, *io)),
        )

    @property
    def untold(self) -> dict[str, tuple[str, str]]:
        """What a real arm needs to be told and was not, by its name: what that is, and what to do."""
        found: dict[str, tuple[str, str]] = {}
        if TIP not in self._raw:
            what = "where the endoscope's arm is was never told (ECM/local/measured_cp)"
            remedy = "power it and let it through, or say has_no = ['endoscope_arm'] where there is none"
            found["endoscope_arm"] = what, remedy
        if not self._heard_of & set(CLUTCHES):
            what = "the clutch was never heard of"
            remedy = "press the clutch once, or say has_no = ['clutch'] where there is none"
            found["clutch"] = what, remedy
        return found

    def hear_pose(self, kind: str, data: bytes, arrived_ns: int) -> None:
        """Keep the newest pose of a kind, unread."""
        with self._lock:
            self._raw[kind] = _Raw(data, arrived_ns)

    def hear_button(self, topic: str, data: bytes) -> None:
        """Note a button that is pressed or let go, even where it was so for a moment only."""
        try:
            pressed = crtk.button(data)
        except RosMessageError:
            pressed = True
        with self._lock:
            (self._pressed.add if pressed else self._pressed.discard)(topic)
            self._touched = topic
            self._heard_of.add(topic)
            if topic.endswith("suj_clutch"):
                self._let_go = topic

    def judge(self, now_ns: int) -> str:
        """Why nothing must move now; empty where all stands where it stood."""
        with self._lock:
            raw, pressed, touched, let_go = dict(self._raw), sorted(self._pressed), self._touched, self._let_go
            self._touched = ""
        if pressed or touched:
            self._moved(now_ns, f"{(pressed or [touched])[0]} was pressed")
        stands = self._tip(raw, now_ns) or self._reference(raw, now_ns)
        if let_go:
            return f"{let_go} let go of set-up joints: register the base anew, then start the bridge again"
        if stands:
            return stands
        return f"{self._what}: wait, then plan again" if now_ns - self.still_since_ns < SETTLED_NS else ""

    def _tip(self, raw: dict[str, _Raw], now_ns: int) -> str:
        """What the endoscope's own arm says."""
        tip = self._pose(TIP, raw)
        fresh = tip is not None and now_ns - raw[TIP].arrived_ns < ECM_AGE_NS
        if self._base is not None and not fresh:
            return "its base is told from the ECM, whose local/measured_cp does not come"
        if tip is None:
            return ""
        from_first = self._compared(TIP, tip.T, now_ns, "the camera (ECM) moved")
        if self._base is not None:
            self.T_camera_base = self._base.before_camera(tip.T)
            return ""
        return _elsewhere("the camera (ECM)", from_first)

    def _reference(self, raw: dict[str, _Raw], now_ns: int) -> str:
        """What the arm's pose in two frames says; it holds an ECM's motion too, where the ECM itself is not told."""
        measured, local = self._pose(MEASURED, raw), self._pose(LOCAL, raw)
        if measured is None or local is None or abs(measured.stamp_ns - local.stamp_ns) > SAME_TIME_NS:
            return ""
        if self._base is not None:
            # it changes with the ECM, which is followed
            return ""
        T_reference_base = measured.T @ inverse(local.T)
        from_first = self._compared(MEASURED, T_reference_base, now_ns, "set-up joints or the camera moved")
        return _elsewhere("the base, by its set-up joints or the camera's,", from_first)

    def _pose(self, kind: str, raw: dict[str, _Raw]) -> crtk.Pose | None:
        """The newest pose of a kind; None where there is none, or it cannot be read, which others report."""
        newest = raw.get(kind)
        if newest is None:
            return None
        if kind not in self._read or self._read[kind][0] is not newest:
            self._read[kind] = newest, _read(newest)
        return self._read[kind][1]

    def _compared(self, kind: str, T: Float64[np.ndarray, "4 4"], now_ns: int, what: str) -> Apart:
        """Note a motion; how far it is from where it was first."""
        if apart(self._last.setdefault(kind, T), T).moved:
            self._last[kind] = T
            self._moved(now_ns, what)
        return apart(self._first.setdefault(kind, T), T)

    def _moved(self, now_ns: int, what: str) -> None:
        self.still_since_ns, self._what = now_ns, what


def _elsewhere(what: str, from_first: Apart) -> str:
    if not from_first.moved:
        return ""
    return f"{what} is {from_first} from where it was: put it back, or register anew and start the bridge again"


def _read(raw: _Raw) -> crtk.Pose | None:
    try:
        return crtk.pose(raw.data)
    except RosMessageError:
        return None
