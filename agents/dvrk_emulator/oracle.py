"""Judges every set point that an arm was sent, by rules of its own that share no code with any bridge.

A set point is unsafe where

- the arm was not enabled and homed;
- nobody stood by: no heartbeat of the rig's operator came for longer than STANDING_BY_S, where heartbeats are heard;
- it is not finite, has another number of joints, or lies outside their limits;
- the shaft would end too near the remote centre, or the pin would leave the box that it must stay in;
- it is farther from one that came a while ago (from where the arm is, where none did) than the joints can go in that
  time and SLACK_S;
- it is a set point for the jaw while the arm is on a trajectory of its own;
- somebody else, of whom the oracle was told, has commanded the arm a moment ago.
"""

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.dvrk_emulator.geometry import (
    JAW_LIMITS,
    JAW_SPEED,
    LIMITS,
    SHAFT_CLEARANCE_M,
    SHAFT_M,
    SPEEDS,
    tool,
)

STANDING_BY_S = 0.4
"""The dead man's 0.2 s, and as much for a heartbeat's way here on a busy machine."""
LATE_S = 0.2
ALONE_S, YIELDS_S = 1.0, 0.02
"""So long after somebody else's command no set point may come, from when there was time to stop."""
SLACK_S = 0.05
WINDOW_S = 0.1
ROUNDING = 1e-9
KEPT = 20
_LOWER, _UPPER = np.append(LIMITS[:, 0], JAW_LIMITS[0]), np.append(LIMITS[:, 1], JAW_LIMITS[1])
_SPEEDS = np.append(SPEEDS, JAW_SPEED)


@dataclass(frozen=True)
class Field:
    """The box that the pin must stay in, in a camera's frame, and where the arm's base is in that frame.

    Fields:
        T_camera_base: 4x4, metres.
        lower, upper: corners of the box, metres.
    """

    T_camera_base: np.ndarray
    lower: tuple[float, float, float] = (-0.08, -0.06, 0.02)
    upper: tuple[float, float, float] = (0.08, 0.06, 0.13)


@dataclass(frozen=True)
class Circumstances:
    """How an arm is when a set point comes.

    Fields:
        position: six joints and the jaw, as measured.
        takes_commands: it is enabled and homed.
        held: it was held after the set point before.
        trajectory: the set point is the end of a trajectory that the console makes, so it may be far away.
        mixed: it is for the jaw, by another kind of command than the arm follows just now.
    """

    position: np.ndarray
    takes_commands: bool = True
    held: bool = False
    trajectory: bool = False
    mixed: bool = False


@dataclass
class Oracle:
    """Counts set points, and says of the unsafe ones why.

    Fields:
        box: None where the pin's place is not judged.
        hears_heartbeats: whether set points without one are unsafe.
    """

    box: Field | None = None
    hears_heartbeats: bool = False
    set_points: int = 0
    unsafe: Counter[str] = field(default_factory=Counter)
    sentences: deque[str] = field(default_factory=lambda: deque(maxlen=KEPT))
    _before: dict[str, deque[tuple[float, np.ndarray]]] = field(default_factory=dict)
    _heartbeat_s: float = -np.inf
    _stranger_s: float = -np.inf
    _alone: deque[tuple[float, str]] = field(default_factory=deque)

    def heartbeat(self, now_s: float) -> None:
        """Somebody stands by, and has since LATE_S ago: it came by another way than the set points that it allowed."""
        self._heartbeat_s = now_s
        while self._alone:
            at_s, sentence = self._alone.popleft()
            if now_s - at_s > LATE_S:
                self._note("nobody", sentence)

    def stranger(self, now_s: float) -> None:
        """Somebody commands the arm who is not the one whose set points are judged."""
        self._stranger_s = now_s

    def judge(self, name: str, values: np.ndarray, now_s: float, arm: Circumstances) -> None:
        """One set point for the `arm` or the `jaw`."""
        self.set_points += 1
        part = slice(0, 6) if name == "arm" else slice(6, 7)
        if arm.held:
            self._before.pop(name, None)
        if not arm.takes_commands:
            self._note("state", f"a set point for the {name} came while the arm took none")
        if self.hears_heartbeats and now_s - self._heartbeat_s > STANDING_BY_S:
            sentence = f"a set point for the {name} came {now_s - self._heartbeat_s:.2f} s after a heartbeat"
            self._alone.append((now_s, sentence))
        if values.shape != _LOWER[part].shape or not np.isfinite(values).all():
            self._note("values", f"a set point for the {name} has {values.size} positions, or one is not finite")
            return
        if ((values < _LOWER[part] - ROUNDING) | (values > _UPPER[part] + ROUNDING)).any():
            self._note("limits", f"a set point for the {name} is outside its limits: {values.round(4).tolist()}")
        if YIELDS_S < now_s - self._stranger_s < ALONE_S:
            self._note("owners", f"a set point for the {name} came although somebody else commands the arm")
        if arm.mixed:
            self._note("mixed", f"a set point for the {name} came while the other was on a trajectory")
        if name == "arm":
            self._place(values)
        if not arm.trajectory:
            self._speed(name, values, now_s, arm.position[part], _SPEEDS[part])

    def verdict(self) -> dict[str, Any]:
        """What was counted, as JSON can hold it."""
        alone = Counter({"nobody": len(self._alone)}) if self._alone else Counter[str]()
        return {
            "set_points": self.set_points,
            "unsafe": sum(self.unsafe.values()) + len(self._alone),
            "rules": dict(self.unsafe + alone),
            "sentences": [*self.sentences, *(sentence for _, sentence in self._alone)][:KEPT],
        }

    def _place(self, joints: np.ndarray) -> None:
        if joints[2] + SHAFT_M < SHAFT_CLEARANCE_M - ROUNDING:
            self._note("remote centre", f"the shaft would end {1e3 * (joints[2] + SHAFT_M):.1f} mm beyond it")
        if self.box is not None:
            T = self.box.T_camera_base
            pin = T[:3, :3] @ tool(joints)[1] + T[:3, 3]
            if (pin < np.array(self.box.lower) - ROUNDING).any() or (pin > np.array(self.box.upper) + ROUNDING).any():
                self._note("workspace", f"the pin would be at {(1e3 * pin).round(1).tolist()} mm before the camera")

    def _speed(self, name: str, values: np.ndarray, now_s: float, measured: np.ndarray, speeds: np.ndarray) -> None:
        before = self._before.setdefault(name, deque())
        while before and now_s - before[0][0] > WINDOW_S:
            before.popleft()
        for at_s, others in before or ((now_s, measured),):
            if (np.abs(values - others) > speeds * (now_s - at_s + SLACK_S)).any():
                self._note(
                    "speed", f"a set point for the {name} is too far from where it was {now_s - at_s:.3f} s before"
                )
                break
        before.append((now_s, values))

    def _note(self, rule: str, sentence: str) -> None:
        self.unsafe[rule] += 1
        self.sentences.append(sentence)
