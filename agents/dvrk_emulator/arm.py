"""An arm as its console shows it: what it takes, what it ignores, and how it goes where it was told.

As of a da Vinci research kit: commands are ignored unless it is enabled and homed; joints are clipped to their limits
without a word; a set point is held for ever, for there is no time-out; `move` goes in a straight line in joint space,
busy until it is there. Without a lag it has no inertia, and goes towards a set point as fast as its joints may. With
one each joint follows what it is told as a critically damped mass on a spring does,

    x'' = ω² (told - x) - 2 ω x',    ω = 2 / lag,

so that it comes behind a steady motion by the lag; solved as if what it is told stood still for each step.

An instrument whose fingers touch at an angle of their own is measured there at least, and its effort grows with how far
it would be beyond.
"""

from collections.abc import Callable

import numpy as np

from agents.dvrk_emulator.geometry import JAW_LIMITS, JAW_SPEED, LIMITS, SPEEDS

ENABLED, DISABLED, PAUSED, FAULT = "ENABLED", "DISABLED", "PAUSED", "FAULT"
START = (0.18, 0.04, 0.132, 0.0, 0.0, 0.0)
"""Beside the field of view of the simulated rig's camera."""
HOMING_S = 0.5
_STILL = 1e-12
_ARRIVED = 1e-3
"""A trajectory is over where the joints, lagging behind it, are as near as that to its end (rad, m)."""
MOVE_SHARE = 0.3
"""Of the greatest speeds, which trajectories use."""
_ALL_LIMITS = np.vstack((LIMITS, JAW_LIMITS))
_ALL_SPEEDS = np.append(SPEEDS, JAW_SPEED)
ARM, JAW = slice(0, 6), slice(6, 7)
JAW_STIFFNESS = 0.5
"""N m for each rad that the jaw is told beyond where its fingers touch."""
HAND_RAD_S = 1.0
"""How fast somebody at the console opens and closes the jaw."""


def start_of(name: str) -> tuple[float, ...]:
    """Joints to begin with of an arm of that name: the second stands on the other side of the endoscope."""
    yaw, *others = START
    return (-yaw if name.endswith("2") else yaw, *others)


class EmulatedArm:
    """The arm; time passes for it in `step`.

    Fields:
        state, is_homed: as it tells them.
        position: six joints and the jaw as measured, in radians and metres.
        goal: where it heads, which is what it was told last.
        stuck: it is blocked, and does not follow.
        jaw_effort: in N m, with the sign of its direction.
    """

    def __init__(
        self,
        ready: bool,
        warn: Callable[[str], None],
        start: tuple[float, ...] = START,
        lag_s: float = 0.0,
        jaw_stop_rad: float = JAW_LIMITS[0],
    ) -> None:
        """Stand still; `ready` is enabled and homed, and the fingers touch at `jaw_stop_rad`."""
        self.state, self.is_homed = (ENABLED, True) if ready else (DISABLED, False)
        self.position = np.array((*start, max(0.0, jaw_stop_rad)))
        self._stops, self.jaw_effort = np.append(np.full(6, -np.inf), jaw_stop_rad), 0.0
        self._jaw_by_hand: float | None = None
        self.goal, self.stuck = self.position.copy(), False
        self._told, self._velocity, self._lag_s = self.position.copy(), np.zeros(len(self.position)), lag_s
        self._warn, self._ratio = warn, 1.0
        self._moves = {"arm": False, "jaw": False}
        self._homing_s, self._limits = 0.0, _ALL_LIMITS

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
        if self.stuck or self.state == FAULT:
            self._velocity[:] = 0.0
            return False
        before = self.position
        if self._jaw_by_hand is not None:
            left = self._jaw_by_hand - self.goal[6]
            self.goal[6] += np.clip(left, -HAND_RAD_S * elapsed_s, HAND_RAD_S * elapsed_s)
        self._told = self._told + self._on_the_way(elapsed_s)
        self.position = self._stopped(self._following(elapsed_s) if self._lag_s > 0 else self._told)
        return bool((np.abs(self.position - before) > _STILL).any())

    def _on_the_way(self, elapsed_s: float) -> np.ndarray:
        """How far what the joints are told goes towards the goal in that time."""
        left, reach = self.goal - self._told, _ALL_SPEEDS * elapsed_s
        for part, name in ((ARM, "arm"), (JAW, "jaw")):
            if self._moves[name]:
                # along a line in joint space, as slowly as its slowest joint has to
                slowest = float(np.max(np.abs(left[part]) / (reach[part] * MOVE_SHARE * self._ratio + _STILL)))
                there = np.maximum(self.goal[part], self._stops[part])
                arrived = slowest <= 1 and np.abs(self.position[part] - there).max() <= _ARRIVED
                self._moves[name] = not arrived
                left[part] = left[part] / max(1.0, slowest)
        return np.clip(left, -reach, reach)

    def _following(self, elapsed_s: float) -> np.ndarray:
        """Where mass and spring bring the joints while what they are told stays."""
        omega, away = 2 / self._lag_s, self.position - self._told
        push, left = self._velocity + omega * away, np.exp(-omega * elapsed_s)
        self._velocity = (self._velocity - omega * push * elapsed_s) * left
        return self._told + (away + push * elapsed_s) * left

    def _stopped(self, position: np.ndarray) -> np.ndarray:
        """Where the joints come with fingers that touch."""
        self.jaw_effort = JAW_STIFFNESS * min(0.0, float(self._told[6] - self._stops[6]))
        return np.maximum(position, self._stops)

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
        self.goal[part] = np.clip(values, self._limits[part, 0], self._limits[part, 1])
        self._moves[name] = moving
        self._jaw_by_hand = None
        return True

    def hold(self) -> None:
        """Stay where it is."""
        self.goal, self._told, self._jaw_by_hand = self.position.copy(), self.position.copy(), None
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
            self.state, self._homing_s = state, 0.0
            self.hold()
        else:
            self._warn(f"{word!r} was ignored: the arm is {self.state}")

    def drift(self, angle_rad: float) -> None:
        """Head for another yaw, as somebody at the console has it."""
        self.goal[0] += angle_rad

    def jaw_by_hand(self, angle_rad: float) -> None:
        """Have its jaw open or close to that angle, slowly, as somebody at the console has it."""
        self._jaw_by_hand = float(np.clip(angle_rad, *JAW_LIMITS))

    def narrow(self, about_rad: float) -> None:
        """Have limits of its own for its jaw, so far about where that is."""
        here = self.position[JAW] + np.array((-about_rad, about_rad))
        self._limits = np.vstack((_ALL_LIMITS[ARM], np.clip(here, *JAW_LIMITS)))

    def fail(self) -> None:
        """Be at fault, without power, where it is."""
        self.state = FAULT
        self.hold()
