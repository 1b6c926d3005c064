"""Whether what a plan stands on has moved: the camera, the set-up joints, or the arm in somebody's hands.

A thread that was seen before is then elsewhere, and so are plan and arming. What a console publishes of it:

- `{arm}/measured_cp` and `{arm}/local/measured_cp` are one pose in two frames, so that T_reference_base =
  measured · local⁻¹ changes where set-up joints move, or an ECM that it is told from;
- `ECM/local/measured_cp`, the endoscope's tip; with a base that is told from the ECM (`Reference.ECM_BASE`),
  T_camera_base follows it, and without one the registration holds no longer;
- buttons: the pedals of camera and clutch, and those on the arms that let go of the arm or of its set-up joints.

What has moved since the arm was registered is kept in a file: a bridge that begins anew holds it against the same
registration still. What was told once and does not come any more speaks against moving, as what never came does.

Topics: jhu-dvrk/sawIntuitiveResearchKit, API 2.x; a button's message is sensor_msgs/Joy, 1 where it is pressed.
"""

import itertools
import json
import threading
from collections import deque
from pathlib import Path
from typing import Any, NamedTuple

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
RECENT = 4
"""So many poses of a kind are kept: those of two topics come one after the other, and a turn may fall between."""
ECM = "ECM"
CLUTCHES = ("footpedals/clutch", "console/clutch")
PEDALS = ("footpedals/camera", "footpedals/clutch", "console/camera", "console/clutch")
MEASURED, LOCAL, TIP = "measured_cp", "local/measured_cp", "tip"
BESIDE_ECM = "base beside the ECM"


class _Raw(NamedTuple):
    data: bytes
    arrived_ns: int

    def is_fresh(self, now_ns: int) -> bool:
        """Whether it came lately; where the clock was set back, what came before it did not."""
        return abs(now_ns - self.arrived_ns) < ECM_AGE_NS


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


class SinceRegistration:
    """Where frames were first since an arm was registered, and who let go of its set-up joints; in a file, if any.

    Fields:
        first: by kind.
        let_go: the button; empty where none did.
        unknown: why that is not known; empty where it is.
        unwritten: why the file has not all of it; empty where it has.
    """

    def __init__(self, file: Path | None = None) -> None:
        """As the file of a registration has it."""
        self._file = file
        self.first: dict[str, Float64[np.ndarray, "4 4"]] = {}
        self.let_go, self.unknown, self.unwritten = "", "", ""
        if file is None or not file.exists():
            return
        try:
            kept: dict[str, Any] = json.loads(file.read_text())
            self.first = {kind: np.array(T, dtype=float).reshape(4, 4) for kind, T in kept["first"].items()}
            self.let_go = str(kept["let_go"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            self.unknown = f"{file} cannot be read: register anew, remove it, and start the bridge again"

    def begins(self, kind: str, T: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"]:
        """Where a frame of this kind was first, which is here where it was not told before."""
        if kind not in self.first:
            self.first[kind] = T
            self._keep()
        return self.first[kind]

    def lets_go(self, button: str) -> None:
        """Somebody let go of the set-up joints."""
        if button != self.let_go:
            self.let_go = button
            self._keep()

    def write_again(self) -> None:
        """Write what could not be written; a bridge that begins anew would not know of it."""
        if self.unwritten:
            self._keep()

    def _keep(self) -> None:
        if self._file is None or self.unknown:
            return
        first = {kind: T.tolist() for kind, T in self.first.items()}
        text = json.dumps({"first": first, "let_go": self.let_go})
        beside = self._file.with_suffix(".new")
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            beside.write_text(text)
            beside.replace(self._file)
            self.unwritten = ""
        except OSError as error:
            self.unwritten = f"{self._file} cannot be written ({error.strerror})"


class FramesWatch:
    """Hears frames and buttons from other threads; `judge` is for the bridge's own.

    Fields:
        still_since_ns: what was seen before is elsewhere now.
        T_camera_base: as it follows from where the ECM is; None where it does not depend on that, or is not known yet.
    """

    def __init__(self, arm: str, base: HandEye | None, since: SinceRegistration | None = None) -> None:
        """An arm by its console's name; with a `base` that is told from the ECM, it is followed."""
        self._since = SinceRegistration() if since is None else since
        self._arm, self._base = arm, base if base is not None and base.reference is Reference.ECM_BASE else None
        self.still_since_ns, self.T_camera_base = 0, None
        self._lock = threading.Lock()
        self._raw: dict[str, deque[_Raw]] = {}
        self._pressed: set[str] = set()
        self._touched: str = ""
        self._heard_of = set[str]()
        self._let_go = ""
        self._last: dict[str, Float64[np.ndarray, "4 4"]] = {}
        self._what = ""
        self._paired_ns: int | None = None
        self._read: dict[str, deque[tuple[_Raw, crtk.Pose | None]]] = {}

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
        if MEASURED not in self._raw:
            what = "whether the arm's base stands still was never told (measured_cp)"
            remedy = "let it through, or say has_no = ['set_up_joints'] where it is fixed to the table"
            found["set_up_joints"] = what, remedy
        return found

    def hear_pose(self, kind: str, data: bytes, arrived_ns: int) -> None:
        """Keep the newest poses of a kind, unread."""
        with self._lock:
            self._raw.setdefault(kind, deque(maxlen=RECENT)).append(_Raw(data, arrived_ns))

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
            if pressed and topic.endswith("suj_clutch"):
                # a release alone is what a console says as it starts; a base that moved shows in its pose
                self._let_go = topic

    def judge(self, now_ns: int) -> str:
        """Why nothing must move now; empty where all stands where it stood."""
        with self._lock:
            raw = {kind: tuple(newest) for kind, newest in self._raw.items()}
            pressed, touched, let_go = sorted(self._pressed), self._touched, self._let_go
            self._touched = ""
        if pressed or touched:
            self._moved(now_ns, f"{(pressed or [touched])[0]} was pressed")
        # where the clock was set back, nothing is so young that it was taken before this
        self.still_since_ns = min(self.still_since_ns, now_ns)
        stands = self._tip(raw, now_ns) or self._reference(raw, now_ns)
        if let_go:
            self._since.lets_go(let_go)
        self._since.write_again()
        if self._since.unknown:
            return f"what has moved since the arm was registered is not known: {self._since.unknown}"
        if self._since.unwritten:
            return f"{self._since.unwritten}, so that a new start would forget what has moved: see to the disk first"
        if self._since.let_go:
            return f"{self._since.let_go} let go of set-up joints: register the base anew, then start the bridge again"
        if stands:
            return stands
        return f"{self._what}: wait, then plan again" if now_ns - self.still_since_ns < SETTLED_NS else ""

    def _tip(self, raw: dict[str, tuple[_Raw, ...]], now_ns: int) -> str:
        """What the endoscope's own arm says."""
        newest, tip = self._poses(TIP, raw)[-1] if TIP in raw else (None, None)
        fresh = newest is not None and tip is not None and newest.is_fresh(now_ns)
        if self._base is not None and not fresh:
            return "its base is told from the ECM, whose local/measured_cp does not come"
        if TIP not in raw:
            return ""
        if tip is None or not fresh:
            return "where the camera's arm is (ECM/local/measured_cp) comes no more: see that its console runs"
        from_first = self._compared(TIP, tip.T, now_ns, "the camera (ECM) moved")
        if self._base is not None:
            self.T_camera_base = self._base.before_camera(tip.T)
            return ""
        return _elsewhere("the camera (ECM)", from_first)

    def _reference(self, raw: dict[str, tuple[_Raw, ...]], now_ns: int) -> str:
        """What the arm's pose in two frames says; it holds an ECM's motion too, where the ECM itself is not told."""
        if MEASURED not in raw:
            return ""
        paired = self._paired(raw, now_ns)
        if paired is not None:
            self._paired_ns = paired[2]
        self._paired_ns = now_ns if self._paired_ns is None else min(self._paired_ns, now_ns)
        if now_ns - self._paired_ns > ECM_AGE_NS:
            return "whether the base stands still (measured_cp with local/measured_cp) is told no more: see its console"
        if paired is None:
            return ""
        measured, local, _ = paired
        T_reference_base = measured.T @ inverse(local.T)
        if self._base is not None:
            return self._beside_ecm(T_reference_base, raw, now_ns)
        from_first = self._compared(MEASURED, T_reference_base, now_ns, "set-up joints or the camera moved")
        return _elsewhere("the base, by its set-up joints or the camera's,", from_first)

    def _beside_ecm(
        self, T_reference_base: Float64[np.ndarray, "4 4"], raw: dict[str, tuple[_Raw, ...]], now_ns: int
    ) -> str:
        """Whether the base stands in a fixed frame or in that of an ECM that is followed, whichever it is told in."""
        tip = self._poses(TIP, raw)[-1][1]
        if tip is None or now_ns - self.still_since_ns < SETTLED_NS:
            # while the camera moves, its pose and the arm's are of different times
            return ""
        told = {MEASURED: T_reference_base, BESIDE_ECM: tip.T @ T_reference_base}
        from_first = [apart(self._since.begins(kind, T), T) for kind, T in told.items()]
        return _elsewhere("the base, by its set-up joints,", min(from_first, key=lambda each: each.moved))

    def _paired(self, raw: dict[str, tuple[_Raw, ...]], now_ns: int) -> tuple[crtk.Pose, crtk.Pose, int] | None:
        """The newest poses in both frames that are of one time, and when they came: one after the other."""
        newest, other = (
            [(one, pose) for one, pose in self._poses(kind, raw) if pose is not None and one.is_fresh(now_ns)][::-1]
            for kind in (MEASURED, LOCAL)
        )
        for (one, measured), (two, local) in itertools.product(newest, other):
            if abs(measured.stamp_ns - local.stamp_ns) <= SAME_TIME_NS:
                return measured, local, min(one.arrived_ns, two.arrived_ns)
        return None

    def _poses(self, kind: str, raw: dict[str, tuple[_Raw, ...]]) -> deque[tuple[_Raw, crtk.Pose | None]]:
        """The newest poses of a kind, the newest last; None for one that cannot be read, which others report."""
        known = self._read.setdefault(kind, deque(maxlen=RECENT))
        for one in raw.get(kind, ()):
            if not any(one is each for each, _ in known):
                known.append((one, _read(one)))
        return known

    def _compared(self, kind: str, T: Float64[np.ndarray, "4 4"], now_ns: int, what: str) -> Apart:
        """Note a motion; how far it is from where it was first."""
        if apart(self._last.setdefault(kind, T), T).moved:
            self._last[kind] = T
            self._moved(now_ns, what)
        return apart(self._since.begins(kind, T), T)

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
