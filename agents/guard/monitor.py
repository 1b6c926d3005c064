"""The safety monitor of one arm: which set points may pass to its console, and when the arm is to be held.

It knows the robot's limits and nothing of plans, poses or cameras. Time is monotonic, in nanoseconds, and passed in.

    SHUT, HELD  -- a set point of a new arming that somebody stands by, and that fits -->  OPEN
    OPEN        -- the bridge says that the motion has ended -->  SHUT
    OPEN        -- anything else that is not as it should be -->  HELD: and the arming never passes again

What is heard is as young as the challenge of the monitor's own that it echoes (shared/ros/guarded.py).
"""

import enum
import math
import secrets
from collections import deque
from functools import partialmethod
from typing import NamedTuple

from agents.guard.description import Description
from shared.ros.guarded import UNKNOWN_MS, Alive, Challenge, Gate, SetPoint

PRESENCE_NS = 220_000_000
"""Somebody stands by for so long after a challenge was issued that they answered."""
LINK_NS = FRESH_NS = GONE_NS = GRACE_NS = OBEYS_NS = 100_000_000
"""How old a challenge may be that a set point echoes, and a measurement of the arm; for how long a motion may send
nothing; how much later than its set points the first answer may come, and somebody else's set point than a hold."""
SETTLES_NS = PRESENCE_NS + LINK_NS
"""An arming that is heard of so soon after the start never passes: it may have moved before, and been held."""
AHEAD_S, BURST_S, RATE_MARGIN = 0.25, 0.06, 1.5
"""For how long an axis may be ahead of where it is measured, and how much of its travel may come at once, both at its
greatest speed: a PSM follows within 0.02 s, and the ticks of a busy machine come in bursts."""
REMEMBERED_NS, BURNT = 5_000_000_000, 1000
"""For how long challenges are known, and how many armings that never pass again."""
AGAIN_NS, HOLDS_NS, STANDS, ROUNDING = 50_000_000, 5_000_000_000, 2e-3, 1e-9
"""How often a hold is said again until no axis (rad, m) has moved by more in between, and for how long at most; by how
much (rad, m, s) what is at a limit may come out beyond it."""
ENABLES_NS = 5_000_000_000
"""So long after a press somebody who had a foot on the pedal is taken to be there, to have an arm enabled."""
LEFT, NEVER_CAME = "nobody stands by any more", "set points come and nobody stands by"
ALLOWED_NS = {LEFT: PRESENCE_NS, NEVER_CAME: GRACE_NS}


class Kind(enum.Enum):
    """What is to be done."""

    PASS = "pass"  # noqa: S105
    HOLD = "hold"
    PAUSE = "pause"


class Action(NamedTuple):
    """What the console is to be sent: positions of a set point, or a word and why."""

    kind: Kind
    positions: tuple[float, ...] = ()
    reason: str = ""


class Monitor:
    """One arm; `gate` is what is done with set points now. What it does not know speaks against passing."""

    def __init__(self, description: Description) -> None:
        """Shut."""
        self._robot = description
        self._issued, self._settled_ns = dict[int, int](), math.inf
        self._answers, self._round_trip_ms, self._stopped_ns = 0, UNKNOWN_MS, -math.inf
        self.gate, self._arming, self._reason = Gate.SHUT, "", ""
        self._burnt, self._present, self._unattended = deque[str](maxlen=BURNT), dict[str, int](), dict[str, int]()
        self._measured: list[tuple[tuple[float, ...], float]] = [((), -math.inf), ((), -math.inf)]
        self._pedal_up = self._pedal_counts = False
        self._pressed_ns = -math.inf
        # of the open gate, and of the last hold
        self._last, self._credit_s, self._there = (), list[float](), ()
        self._sequence = self._passed_ns = self._held_ns = self._said_ns = self._obeys_ns = math.inf

    def challenge(self, now_ns: int) -> Challenge:
        """Issue a challenge; the bridge is told with it how its link and the gate are."""
        self._settled_ns = min(self._settled_ns, now_ns + SETTLES_NS)
        newest = secrets.randbits(64) or 1
        self._issued[newest] = now_ns
        while now_ns - self._issued[oldest := next(iter(self._issued))] > REMEMBERED_NS:
            del self._issued[oldest]
        state = self.gate, self._pedal(now_ns) or self._just_pressed(now_ns), self._arming, self._reason
        return Challenge(newest, self._answers, self._round_trip_ms, *state)

    def hear_alive(self, alive: Alive, now_ns: int) -> None:
        """The bridge sends no set point now; where its motion has ended as it should, the gate is shut."""
        self._answered(alive.sequence, alive.challenge, now_ns)
        if alive.ended and self.gate is Gate.OPEN and alive.arming_id == self._arming:
            self._burnt.append(self._arming)
            self.gate, self._pedal_counts = Gate.SHUT, False

    def hear_heartbeat(self, arm: str, arming: str, challenge: int, pressed: bool, now_ns: int) -> list[Action]:
        """Somebody stood by when this challenge was issued; where that is told too late, the hold for it says so."""
        if now_ns <= self._settled_ns:
            self._burnt.append(arming)
        issued_ns = self._issued.get(challenge)
        if arm != self._robot.arm or issued_ns is None or not (pressed or self._pedal(now_ns)):
            return []
        self._present[arming] = max(issued_ns, self._present.get(arming, issued_ns))
        self._present = {each: at_ns for each, at_ns in self._present.items() if now_ns - at_ns <= PRESENCE_NS}
        age_ns, allowed_ns = now_ns - issued_ns, ALLOWED_NS.get(self._reason, math.inf)
        if arming != self._arming or age_ns <= allowed_ns:
            return []
        took = f"the operator's answers take {1e-6 * age_ns:.0f} ms to the guard"
        self._reason = f"{took}, and {1e-6 * allowed_ns:.0f} ms are allowed"
        return [Action(Kind.HOLD, reason=self._reason)]

    def _hear(self, part: int, values: tuple[float, ...], now_ns: float) -> None:
        """The console's measured joints, or jaw: one finite number for each axis, or it is no measurement."""
        axes = (self._robot.axes[:-1], self._robot.axes[-1:])[part]
        if len(values) == len(axes) and all(math.isfinite(value) for value in values):
            if now_ns - self._measured[part][1] > FRESH_NS:
                # a release of the pedal may have been lost with the rest
                self._pedal_up = self._pedal_counts = False
            self._measured[part] = values, now_ns

    hear_joints, hear_jaw = partialmethod(_hear, 0), partialmethod(_hear, 1)

    def hear_pedal(self, pressed: bool, now_ns: int) -> None:
        """The console's operator-present pedal, which counts once pressed after a release that was heard."""
        if pressed and self._pedal_up:
            self._pressed_ns = now_ns
        self._pedal_counts = pressed and (self._pedal_up or self._pedal_counts)
        self._pedal_up = not pressed
        if not pressed and self._robot.pedal:
            self._present.clear()

    def hear_stranger(self, now_ns: int) -> list[Action]:
        """Somebody else has sent the console a set point."""
        if self.gate is Gate.OPEN:
            return self.hold("somebody else sends set points too", now_ns)
        if self.gate is Gate.SHUT or now_ns <= self._obeys_ns:
            return []
        self._obeys_ns = math.inf
        return [Action(Kind.PAUSE, reason="set points come although the arm was held")]

    def hear_hold(self, now_ns: int) -> list[Action]:
        """Somebody else has had the console hold; what was armed before, and has not begun yet, never passes."""
        if self.gate is Gate.OPEN:
            self.hold("somebody said hold", now_ns)
        self._burnt.extend(self._present)
        self._stopped_ns = now_ns
        return []

    def hear_set_point(self, said: SetPoint, now_ns: int) -> list[Action]:
        """Pass a set point on, drop it, or hold the arm."""
        age_ns, arming = self._answered(said.sequence, said.challenge, now_ns), said.arming_id
        if arming in self._burnt or not arming:
            return []
        if why := self._unfit(said, now_ns):
            return self.hold(why, now_ns, arming)
        opens = self.gate is not Gate.OPEN
        # what opens the gate comes from a bridge that has heard of the last hold
        overtaken = now_ns - (age_ns or 0) <= self._stopped_ns if opens else said.sequence <= self._sequence
        if age_ns is None or age_ns > LINK_NS or overtaken:
            return []
        if holds := self.turn(now_ns):
            return holds
        if opens:
            if not self._attended(arming, now_ns):
                # the first answer may still be on its way
                self._unattended = {arming: self._unattended.get(arming, now_ns)}
                waits = now_ns - self._unattended[arming] <= GRACE_NS
                return [] if waits else self.hold(NEVER_CAME, now_ns, arming)
            if not (measured := self._position(now_ns)):
                return self.hold("the arm's joints or jaw are not measured", now_ns, arming)
            self.gate, self._arming, self._reason = Gate.OPEN, arming, ""
            self._last, self._passed_ns, self._credit_s = measured, now_ns, [BURST_S, *[BURST_S] * len(measured)]
        if why := self._too_far(said.positions, now_ns):
            return self.hold(why, now_ns)
        self._last, self._sequence, self._passed_ns = said.positions, said.sequence, now_ns
        return [Action(Kind.PASS, said.positions)]

    def turn(self, now_ns: int) -> list[Action]:
        """What follows from time alone."""
        if self.gate is Gate.OPEN:
            if not self._attended(self._arming, now_ns):
                return self.hold(LEFT, now_ns)
            if now_ns - self._passed_ns > GONE_NS:
                return self.hold("set points have ended, and not as a motion should", now_ns)
            if not self._position(now_ns):
                return self.hold("the arm's joints or jaw are not measured any more", now_ns)
        if self.gate is not Gate.HELD or now_ns - self._said_ns < AGAIN_NS or now_ns - self._held_ns > HOLDS_NS:
            return []
        there = self._position(now_ns)
        if there and self._there and all(abs(a - b) <= STANDS for a, b in zip(there, self._there, strict=True)):
            return []
        self._said_ns, self._there = now_ns, there
        return [Action(Kind.HOLD, reason=self._reason)]

    def hold(self, why: str, now_ns: int, arming: str = "") -> list[Action]:
        """Hold; neither the arming that moves nor the one that has asked for this passes again."""
        if self.gate is not Gate.OPEN:
            self._arming = arming
        self._burnt.extend((self._arming, arming))
        self.gate, self._pedal_counts = Gate.HELD, False
        self._reason, self._there, self._obeys_ns = why, self._position(now_ns), now_ns + OBEYS_NS
        self._held_ns = self._said_ns = now_ns
        return [Action(Kind.HOLD, reason=why)]

    def _answered(self, sequence: int, challenge: int, now_ns: int) -> int | None:
        """How old the challenge is that a message of the bridge echoes; None where that is not known."""
        issued_ns, self._answers = self._issued.get(challenge), sequence
        if issued_ns is None or now_ns <= self._settled_ns:
            self._round_trip_ms = UNKNOWN_MS
            return None
        # challenges come seldom at rest: the way takes as long as the next newer one has been out
        newer_ns = next((at_ns for at_ns in self._issued.values() if at_ns > issued_ns), now_ns)
        self._round_trip_ms = 1e-6 * (now_ns - newer_ns)
        return now_ns - issued_ns

    def _position(self, now_ns: int) -> tuple[float, ...]:
        """Where joints and jaw were measured; empty where either is too long ago."""
        (joints, joints_ns), (jaw, jaw_ns) = self._measured
        return joints + jaw if now_ns - min(joints_ns, jaw_ns) <= FRESH_NS else ()

    def _pedal(self, now_ns: int) -> bool:
        """Whether the pedal counts: pressed anew since the last motion, by a console that is heard."""
        return self._robot.pedal and self._pedal_counts and bool(self._position(now_ns))

    def _just_pressed(self, now_ns: int) -> bool:
        """Whether it was pressed anew a moment ago: an arm without power, which is to be enabled, is not measured."""
        return self._robot.pedal and self._pedal_counts and now_ns - self._pressed_ns <= ENABLES_NS

    def _attended(self, arming: str, now_ns: int) -> bool:
        return now_ns - self._present.get(arming, -math.inf) <= PRESENCE_NS

    def _unfit(self, said: SetPoint, now_ns: int) -> str:
        """Why a set point is none for this arm now, wherever that is and whoever stands by."""
        axes, positions = self._robot.axes, said.positions
        if now_ns <= self._settled_ns:
            return "the guard has begun anew while set points came"
        if len(positions) != len(axes):
            return f"a set point has {len(positions)} numbers, where the arm has {len(axes)}"
        for index, (position, axis) in enumerate(zip(positions, axes, strict=True)):
            if not axis.lower - ROUNDING <= position <= axis.upper + ROUNDING:
                return f"a set point has axis {index + 1} at {position:.4g}, outside {axis.lower:g} to {axis.upper:g}"
        if self.gate is Gate.OPEN and said.arming_id != self._arming:
            return "set points of another arming come in mid-motion"
        return ""

    def _too_far(self, positions: tuple[float, ...], now_ns: int) -> str:
        """Why the arm could not be there: speed times time since the last one, and from where it is measured."""
        elapsed_s, rate = 1e-9 * (now_ns - self._passed_ns), RATE_MARGIN * self._robot.rate_hz
        each = zip(self._robot.axes, positions, self._last, self._position(now_ns), strict=True)
        for index, (axis, at, last, seen) in enumerate(each):
            self._credit_s[index] = min(self._credit_s[index] + elapsed_s, BURST_S) - abs(at - last) / axis.speed
            if self._credit_s[index] < -ROUNDING:
                return f"a set point has axis {index + 1} go faster than {axis.speed:g} a second"
            if abs(at - seen) > axis.speed * AHEAD_S:
                return f"a set point has axis {index + 1} {abs(at - seen):.3g} from where it is measured"
        self._credit_s[-1] = min(self._credit_s[-1] + elapsed_s, BURST_S) - 1 / rate
        return f"more than {rate:g} set points a second come" if self._credit_s[-1] < -ROUNDING else ""
