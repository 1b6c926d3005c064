"""Whether a console heads for what it was sent, by what it says of its own set points.

A console clips joints to limits of its own without a word, and its own teleoperation moves an arm by no topic at all.
Both show in `setpoint_js` and `jaw/setpoint_js`: while we send, what they say is one of those that were sent a while
ago; while we do not, they stay where they are. What a console does not tell is not watched.
"""

import threading
from collections import deque

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.backend import Readiness
from agents.robot_bridge.dvrk.readings import OTHERS_NS, SECOND_NS, Judged, Raw
from agents.robot_bridge.plans import Code
from shared.ros import crtk
from shared.ros.link import Heard
from shared.ros.types import JOINT_STATE, RosMessageError

WINDOW_NS = SECOND_NS // 2
"""A console says within that what it was sent; and what it said longer ago says nothing."""
SETTLES_NS = SECOND_NS // 2
"""So long after a hold, a change of its state or a clutch a console may head for where the arm is."""
SAME = {"setpoint_js": np.array((5e-3, 5e-3, 5e-4, 5e-3, 5e-3, 5e-3)), "jaw/setpoint_js": np.array((2e-2,))}
"""How far (rad, the third m) a set point may come out from how it was sent: a millimetre of the tip or so."""


class SetPointsWatch:
    """One arm's; hears from other threads, everything else is for the bridge's own."""

    def __init__(self, arm: str) -> None:
        """An arm by its console's name."""
        self._arm, self._lock, self._raw = arm, threading.Lock(), dict[str, Raw]()
        self._parts = {kind: _Part(same) for kind, same in SAME.items()}
        self._free_ns, self._other = 0, ("", 0)

    def heard(self) -> tuple[Heard, ...]:
        """The topics to hear."""
        return tuple(
            Heard(f"{self._arm}/{kind}", JOINT_STATE, lambda data, at, k=kind: self.hear(k, data, at)) for kind in SAME
        )

    def hear(self, kind: str, data: bytes, arrived_ns: int) -> None:
        """Keep the newest of a kind, unread."""
        with self._lock:
            self._raw[kind] = Raw(data, arrived_ns)

    def sent(self, joints: Float64[np.ndarray, "6"], jaw_rad: float, now_ns: int) -> None:
        """Note a set point of ours."""
        self._parts["setpoint_js"].sent(joints, now_ns)
        self._parts["jaw/setpoint_js"].sent(np.array([jaw_rad]), now_ns)

    def let_go(self, now_ns: int) -> None:
        """For a while the console may head elsewhere: it was told to hold, or is not ready."""
        self._free_ns = now_ns

    @property
    def jaw_rad(self) -> float | None:
        """Where the console has the jaw head, as it was told last; None where it does not tell, or cannot be read."""
        with self._lock:
            newest = self._raw.get("jaw/setpoint_js")
        told = None if newest is None else _read(newest)
        return float(told[0]) if told is not None and told.size == 1 and np.isfinite(told).all() else None

    def judge(self, now_ns: int) -> Judged | None:
        """Why nothing must move: the console heads for something else than it was sent."""
        with self._lock:
            raw = dict(self._raw)
        for kind, newest in raw.items():
            told = _read(newest) if now_ns - newest.arrived_ns < WINDOW_NS else None
            if told is None or told.shape != SAME[kind].shape:
                continue
            if not self._parts[kind].ours(told, now_ns) and now_ns - self._free_ns > SETTLES_NS:
                self._other = kind, now_ns
        kind, at_ns = self._other
        if now_ns - at_ns >= OTHERS_NS:
            return None
        why = f"by its {kind} it heads for something else than it was sent"
        return Judged(
            Readiness.DISABLED,
            Code.OTHER_SET_POINT,
            f"{why}: it has other joint limits, or its teleoperation moves it; see to that, and have one owner only",
        )


class _Part:
    """The arm's joints, or its jaw."""

    def __init__(self, same: Float64[np.ndarray, "n"]) -> None:
        self._same, self._sent = same, deque[tuple[int, np.ndarray]]()
        self._since_ns = 0
        self._stands: np.ndarray | None = None

    def sent(self, values: Float64[np.ndarray, "n"], now_ns: int) -> None:
        if not self._sent:
            self._since_ns = now_ns
        self._sent.append((now_ns, values))
        self._forget(now_ns)

    def ours(self, told: Float64[np.ndarray, "n"], now_ns: int) -> bool:
        """Whether what the console says is one of those that were sent, or where it stood before."""
        self._forget(now_ns)
        stood = self._stands is None or self._near(told, self._stands)
        if not stood or self._stands is None:
            self._stands = told
        if stood and not (self._sent and now_ns - self._since_ns > WINDOW_NS):
            return True
        return any(self._near(told, values) for _, values in self._sent)

    def _near(self, one: Float64[np.ndarray, "n"], other: Float64[np.ndarray, "n"]) -> bool:
        return bool((np.abs(one - other) <= self._same).all())

    def _forget(self, now_ns: int) -> None:
        while self._sent and now_ns - self._sent[0][0] > WINDOW_NS:
            self._sent.popleft()


def _read(raw: Raw) -> Float64[np.ndarray, "n"] | None:
    """Joints; None where they cannot be read, which says nothing."""
    try:
        return crtk.joints(raw.data).position
    except RosMessageError:
        return None
