"""An arm as its console shows it: what it takes, what it ignores, and how it goes where it was told.

As of a da Vinci research kit: commands are ignored unless it is enabled and homed; joints are clipped to their limits
without a word; a set point is held for ever, for there is no time-out; `move` goes in a straight line in joint space,
busy until it is there. It has no inertia, and goes towards a set point as fast as its joints may.
"""

from collections.abc import Callable

import numpy as np

from agents.emulator.geometry import JAW_LIMITS, JAW_SPEED, LIMITS, SPEEDS

ENABLED, DISABLED, PAUSED, FAULT = "ENABLED", "DISABLED", "PAUSED", "FAULT"
START = (0.18, 0.04, 0.132, 0.0, 0.0, 0.0)
"""Beside the field of view of the simulated rig's camera."""
HOMING_S = 0.5
MOVE_SHARE = 0.3
"""Of the greatest speeds, which trajectories use."""
_ALL_LIMITS = np.vstack((LIMITS, JAW_LIMITS))
_ALL_SPEEDS = np.append(SPEEDS, JAW_SPEED)
ARM, JAW = slice(0, 6), slice(6, 7)


class EmulatedArm:
    """The arm; time passes for it in `step`.

    Fields:
        state, is_homed: as it tells them.
        position: six joints and the jaw, in radians and metres.
        goal: where it heads, which is what it was told last.
        stuck: it is blocked, and does not follow.
    """

    def __init__(self, ready: bool, warn: Callable[[str], None], start: tuple[float, ...] = START) -> None:
        """Stand still; `ready` is enabled and homed."""
        self.state, self.is_homed = (ENABLED, True) if ready else (DISABLED, False)
        self.position = np.array((*start, 0.0))
        self.goal, self.stuck = self.position.copy(), False
        self._warn, self._ratio = warn, 1.0
        self._moves = {"arm": False, "jaw": False}
        self._homing_s = 0.0

    @property
    def takes_commands(self) -> bool:
        """Whether it would follow a set point."""
        return self.state == ENABLED and self.is_homed

    @property
    def is_busy(self) -> bool:
        """Whether it homes, or is on a trajectory of its own."""
        return self._homing_s > 0 or any(self._moves.values())

    @property
    def moves(self) -> bool:
        """Whether its joints, without the jaw, are on a trajectory of their own."""
        return self._moves["arm"]

    def step(self, elapsed_s: float) -> bool:
        """Let time pass; whether it moved."""
        if self._homing_s > 0:
            self._homing_s -= elapsed_s
            self.is_homed = self._homing_s <= 0
        before = self.position
        left = self.goal - before
        if self.stuck or self.state == FAULT or not left.any():
            return False
        reach = _ALL_SPEEDS * elapsed_s
        for part, name in ((ARM, "arm"), (JAW, "jaw")):
            if self._moves[name]:
                # along a line in joint space, as slowly as its slowest joint has to
                slowest = float(np.max(np.abs(left[part]) / (reach[part] * MOVE_SHARE * self._ratio)))
                self._moves[name] = slowest > 1
                left[part] = left[part] / max(1.0, slowest)
        self.position = before + np.clip(left, -reach, reach)
        return True

    def head(self, name: str, values: np.ndarray, moving: bool) -> bool:
        """Head for joints of the `arm` or the `jaw`, by a trajectory of its own where `moving`; whether it does."""
        part = ARM if name == "arm" else JAW
        if not self.takes_commands:
            homed = "homed" if self.is_homed else "not homed"
            self._warn(f"a set point for the {name} was ignored: the arm is {self.state} and {homed}")
            return False
        if values.shape != self.goal[part].shape or not np.isfinite(values).all():
            self._warn(f"a set point for the {name} was ignored: {values.size} positions, or not finite")
            return False
        self.goal[part] = np.clip(values, _ALL_LIMITS[part, 0], _ALL_LIMITS[part, 1])
        self._moves[name] = moving
        return True

    def hold(self) -> None:
        """Stay where it is."""
        self.goal = self.position.copy()
        self._moves = dict.fromkeys(self._moves, False)

    def slow_down(self, ratio: float) -> None:
        """The share of their speed that trajectories have from now on."""
        self._ratio = float(np.clip(ratio, 0.01, 1.0))

    def command(self, word: str) -> None:
        """A command for its state; one that its state does not allow is ignored."""
        following = {
            ("enable", DISABLED): ENABLED,
            ("enable", FAULT): ENABLED,
            ("disable", ENABLED): DISABLED,
            ("disable", PAUSED): DISABLED,
            ("disable", FAULT): DISABLED,
            ("pause", ENABLED): PAUSED,
            ("resume", PAUSED): ENABLED,
        }
        if word == "home" and self.state == ENABLED:
            self._homing_s = HOMING_S
        elif state := following.get((word, self.state)):
            self.state = state
            self.hold()
        else:
            self._warn(f"{word!r} was ignored: the arm is {self.state}")

    def fail(self) -> None:
        """Be at fault, without power, where it is."""
        self.state = FAULT
        self.hold()
