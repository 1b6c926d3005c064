"""What a bridge knows of the guard beside its console, and how its set points go there (shared/ros/guarded.py).

Without a guard that is alive, and heard within LINK_S there and back, a real arm is neither armed nor moved on. How
long the way is the guard tells by its own clock; that what it tells is of now, the bridge does by its own.
"""

import struct
import threading
from collections import OrderedDict
from collections.abc import Callable

from agents.robot_bridge.backend import Readiness
from agents.robot_bridge.dvrk.readings import Judged
from agents.robot_bridge.plans import Code
from shared.ros.guarded import (
    ALIVE,
    CHALLENGE,
    SET_POINT,
    Alive,
    Challenge,
    Gate,
    GuardedError,
    SetPoint,
    alive_bytes,
    challenge_from,
    key_of,
    set_point_bytes,
)

LINK_S = 0.1
"""How old a challenge may be that a set point echoes: the guard's own bound."""
SILENCE_NS = 250_000_000
"""A guard that has said nothing for so long is gone: it speaks every 20 ms, and every 80 ms at rest."""
IDLE_NS = 20_000_000
"""So long after the last set point the bridge says that it is alive."""
TAIL = 8
"""Bytes behind the positions of a JointState that has nothing else: two empty lists."""
REMEMBERED = 2000
"""Messages of which it is known when they were sent: ten seconds of them."""


class GuardLink:
    """One arm's guard; hears from other threads, all else is for the bridge's own but `say`."""

    def __init__(self, console: str, say: Callable[[str, bytes], bool], monotonic_ns: Callable[[], int]) -> None:
        """`say` speaks on a key; False where that cannot be."""
        self._keys = {topic: key_of(console, topic) for topic in (SET_POINT, ALIVE, CHALLENGE)}
        self._say, self._monotonic_ns = say, monotonic_ns
        self._lock = threading.Lock()
        self._heard: tuple[Challenge, int] | None = None
        self._sequence, self._sent = 0, OrderedDict[int, int]()
        self._moved_ns, self._ended = 0, ""
        self._ours = OrderedDict[bytes, None]()
        self.refused = 0

    @property
    def keys(self) -> dict[str, str]:
        """The keys of what is said and heard, by topic."""
        return self._keys

    def hear(self, data: bytes, _arrived_ns: int) -> None:
        """Take what the guard says; what names another key is none of it."""
        try:
            told = challenge_from(self._keys[CHALLENGE], data)
        except GuardedError:
            self.refused += 1
            return
        now_ns = self._monotonic_ns()
        with self._lock:
            self._heard = told, now_ns

    @property
    def told(self) -> Challenge | None:
        """The newest that the guard said; None before it has, and once it has been silent."""
        with self._lock:
            heard = self._heard
        return heard[0] if heard is not None and self._monotonic_ns() - heard[1] <= SILENCE_NS else None

    def move(self, positions: tuple[float, ...], arming_id: str) -> None:
        """Send a set point of joints and jaw."""
        told = self.told
        said = SetPoint(self._number(), told.challenge if told else 0, arming_id, positions)
        self._moved_ns, self._ended = self._monotonic_ns(), ""
        with self._lock:
            for part in (positions[:-1], positions[-1:]):
                packed = struct.pack(f"<{len(part)}d", *part)
                self._ours[packed] = None
                # a jaw that stands has one position for long, which is the newest each time
                self._ours.move_to_end(packed)
            while len(self._ours) > REMEMBERED:
                self._ours.popitem(last=False)
        self._say(self._keys[SET_POINT], set_point_bytes(self._keys[SET_POINT], said))

    def ours(self, data: bytes, count: int) -> bool:
        """Whether so many positions that a console was sent (sensor_msgs/JointState) are what we sent the guard."""
        with self._lock:
            return data[-TAIL - 8 * count : -TAIL] in self._ours

    def finish(self, arming_id: str) -> None:
        """Tell that a motion has ended as it should; it is told again for as long as nothing else moves."""
        self._ended = arming_id
        self._tell_alive()

    def turn(self) -> None:
        """Tell that the bridge is there, where no set point does."""
        if self._monotonic_ns() - self._moved_ns > IDLE_NS:
            self._tell_alive()

    def judge(self, commanded_arming: str) -> Judged | None:
        """Why nothing may move: no guard, one that is too far away, or one that holds the arming that moves."""
        told = self.told
        if told is None:
            gone = "no guard stands by this arm: run suturegrasp guard on the robot's computer (docs/dvrk.md)"
            return Judged(Readiness.DISABLED, Code.NO_GUARD, gone)
        if told.gate is Gate.HELD and commanded_arming and told.arming_id == commanded_arming:
            held = f"the guard holds the arm: {told.reason}; arm again"
            return Judged(Readiness.DISABLED, Code.HOLD_COMMAND, held)
        taken_ms = max(told.round_trip_ms, self._behind_ms(told.answers))
        if told.round_trip_ms < 0 or told.answers > self._sequence:
            unknown = "how long the way to the guard and back takes is not known yet: wait a moment, then arm"
            return Judged(Readiness.DISABLED, Code.ROUND_TRIP, unknown)
        if taken_ms > 1e3 * LINK_S:
            took = f"the way to the guard and back takes {taken_ms:.0f} ms, and {1e3 * LINK_S:.0f} ms are allowed"
            return Judged(Readiness.DISABLED, Code.ROUND_TRIP, f"{took}: see to the robot's link")
        return None

    def _behind_ms(self, answers: int) -> float:
        """For how long something newer has been on its way than what the guard says that it heard last."""
        with self._lock:
            first = next(iter(self._sent), 0)
            sent_ns = self._sent.get(max(answers + 1, first))
        return 0.0 if sent_ns is None else 1e-6 * (self._monotonic_ns() - sent_ns)

    def _tell_alive(self) -> None:
        told = self.told
        said = Alive(self._number(), told.challenge if told else 0, self._ended, bool(self._ended))
        self._say(self._keys[ALIVE], alive_bytes(self._keys[ALIVE], said))

    def _number(self) -> int:
        self._sequence += 1
        with self._lock:
            self._sent[self._sequence] = self._monotonic_ns()
            while len(self._sent) > REMEMBERED:
                self._sent.popitem(last=False)
        return self._sequence
