"""The safety monitor of one arm: which set points may pass to its console, and when the arm is to be held.

It knows the robot's limits and nothing of plans, poses or cameras. Time is monotonic, in nanoseconds, and passed in.

    SHUT  -- a set point of a new arming that somebody stands by, and that fits -->  OPEN
    OPEN  -- the bridge says that the motion has ended -->  SHUT
    OPEN  -- anything else that is not as it should be -->  HELD: the arm is held, and the arming never passes again
    HELD  -- as SHUT, of another arming -->  OPEN

Who acts asks: it issues a challenge every 20 ms. Whoever stands by echoes it through the bridge, and so does each set
point; both are as young as the challenge that they echo, whatever queues and clocks do on the way.
"""

import enum
import math
import secrets
from collections import OrderedDict
from typing import NamedTuple

from agents.guard.description import (
    AHEAD_S,
    BURST_S,
    FRESH_NS,
    GONE_NS,
    GRACE_NS,
    LINK_NS,
    PRESENCE_NS,
    RATE_MARGIN,
    Description,
)
from shared.ros.guarded import UNKNOWN_MS, Alive, Challenge, Gate, SetPoint

REMEMBERED_NS = 5_000_000_000
BURNT = 1000
AGAIN_NS, HOLDS_NS = 50_000_000, 5_000_000_000
"""How often a hold is said again until the arm stands, and for how long at most."""
STANDS_NS, STANDS = 100_000_000, 2e-3
"""An arm none of whose axes (rad, m) has moved by as much for so long stands."""
OBEYS_NS = 100_000_000
"""So long after a hold no set point of anybody may come."""
ROUNDING = 1e-9
"""By so much (rad, m) a set point at a limit may come out beyond it."""


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
    """One arm. Nothing passes before it is opened, and what it does not know speaks against passing."""

    def __init__(self, description: Description) -> None:
        """Shut."""
        self._robot = description
        self._issued = OrderedDict[int, int]()
        self._answers, self._round_trip_ms = 0, UNKNOWN_MS
        self._gate, self._arming, self._reason = Gate.SHUT, "", ""
        self._burnt = OrderedDict[str, None]()
        self._present = dict[str, int]()
        self._unattended = dict[str, int]()
        self._measured = dict[str, tuple[tuple[float, ...], int]]()
        self._stood = dict[str, tuple[tuple[float, ...], int]]()
        self._pedal_down = False
        self._pedal_anew: bool
        # of the open gate
        self._last: tuple[float, ...]
        self._credit: list[float]
        self._turns_credit: float
        self._passed_ns: int
        self._sequence: int
        # of the last hold
        self._held_ns: int
        self._said_ns: int
        self._paused: bool

    @property
    def gate(self) -> Gate:
        """What is done with set points now."""
        return self._gate

    def challenge(self, now_ns: int) -> Challenge:
        """Issue a challenge; the bridge is told with it how its link and the gate are."""
        newest = secrets.randbits(64) or 1
        self._issued[newest] = now_ns
        while now_ns - next(iter(self._issued.values())) > REMEMBERED_NS:
            self._issued.popitem(last=False)
        state = self._gate, self._pedal(now_ns), self._arming, self._reason
        return Challenge(newest, self._answers, self._round_trip_ms, *state)

    def hear_alive(self, alive: Alive, now_ns: int) -> list[Action]:
        """The bridge sends no set point now; where its motion has ended as it should, the gate is shut."""
        self._answered(alive.sequence, alive.challenge, now_ns)
        if alive.ended and self._gate is Gate.OPEN and alive.arming_id == self._arming:
            self._burn(Gate.SHUT)
        return []

    def hear_heartbeat(self, arm: str, arming_id: str, guard_challenge: int, pressed: bool, now_ns: int) -> None:
        """Somebody stood by when this challenge was issued, or later."""
        issued_ns = self._issued.get(guard_challenge)
        if arm != self._robot.arm or issued_ns is None or not (pressed or self._pedal(now_ns)):
            return
        self._present[arming_id] = max(issued_ns, self._present.get(arming_id, issued_ns))
        while len(self._present) > BURNT:
            del self._present[next(iter(self._present))]

    def hear_joints(self, joints: tuple[float, ...], now_ns: int) -> None:
        """The console's measured joints; any other number of them, or one that is not finite, is no measurement."""
        if len(joints) == len(self._robot.axes) - 1:
            self._measure("joints", joints, now_ns)

    def hear_jaw(self, jaw: tuple[float, ...], now_ns: int) -> None:
        """The console's measured jaw."""
        if len(jaw) == 1:
            self._measure("jaw", jaw, now_ns)

    def hear_pedal(self, pressed: bool, now_ns: int) -> list[Action]:  # noqa: ARG002
        """The console's operator-present pedal; released, nobody stands by any more."""
        self._pedal_anew = pressed and (not self._pedal_down or self._pedal_anew)
        self._pedal_down = pressed
        if not pressed and self._robot.pedal:
            self._present.clear()
        return []

    def hear_stranger(self, now_ns: int) -> list[Action]:
        """Somebody else has sent the console a set point."""
        if self._gate is Gate.OPEN:
            return self._hold("somebody else sends set points too", now_ns)
        if self._gate is Gate.HELD and now_ns - self._held_ns > OBEYS_NS and not self._paused:
            self._paused = True
            return [Action(Kind.PAUSE, reason="set points come although the arm was held")]
        return []

    def hear_hold(self, now_ns: int) -> list[Action]:
        """Somebody else has had the console hold; it is said again where the arm does not stand soon."""
        if self._gate is Gate.OPEN:
            self._hold("somebody said hold", now_ns)
        return []

    def hear_set_point(self, said: SetPoint, now_ns: int) -> list[Action]:
        """Pass a set point on, drop it, or hold the arm."""
        age_ns = self._answered(said.sequence, said.challenge, now_ns)
        arming = said.arming_id
        if arming in self._burnt or not arming:
            return []
        if why := self._unfit(said.positions):
            return self._refuse(arming, why, now_ns)
        overtaken = False
        if self._gate is Gate.OPEN:
            if arming != self._arming:
                return self._refuse(arming, "set points of another arming come in mid-motion", now_ns)
            overtaken = said.sequence <= self._sequence
        if age_ns is None or age_ns > LINK_NS or overtaken:
            return []
        if not self._attended(arming, now_ns):
            return self._alone(arming, now_ns)
        if (measured := self._position(now_ns)) is None:
            return self._refuse(arming, "the arm's joints or jaw are not measured", now_ns)
        if self._gate is not Gate.OPEN:
            self._open(arming, measured, now_ns)
        if why := self._too_far(said.positions, measured, now_ns):
            return self._refuse(arming, why, now_ns)
        self._last, self._sequence, self._passed_ns = said.positions, said.sequence, now_ns
        return [Action(Kind.PASS, said.positions)]

    def turn(self, now_ns: int) -> list[Action]:
        """What follows from time alone."""
        if self._gate is Gate.OPEN:
            if not self._attended(self._arming, now_ns):
                return self._hold("nobody stands by any more", now_ns)
            if now_ns - self._passed_ns > GONE_NS:
                return self._hold("set points have ended, and not as a motion should", now_ns)
            if self._position(now_ns) is None:
                return self._hold("the arm's joints or jaw are not measured any more", now_ns)
        return self._hold_again(now_ns)

    def _answered(self, sequence: int, challenge: int, now_ns: int) -> int | None:
        """How old the challenge is that a message of the bridge echoes; None where that is not known."""
        issued_ns = self._issued.get(challenge)
        self._answers = sequence
        if issued_ns is None:
            self._round_trip_ms = UNKNOWN_MS
            return None
        # challenges come seldom at rest: the way takes as long as the next newer one has been out
        newer_ns = next((at_ns for at_ns in self._issued.values() if at_ns > issued_ns), now_ns)
        self._round_trip_ms = 1e-6 * (now_ns - newer_ns)
        return now_ns - issued_ns

    def _measure(self, what: str, values: tuple[float, ...], now_ns: int) -> None:
        if not all(math.isfinite(value) for value in values):
            return
        self._measured[what] = values, now_ns
        stood, _ = self._stood.setdefault(what, self._measured[what])
        if any(abs(a - b) > STANDS for a, b in zip(stood, values, strict=True)):
            self._stood[what] = values, now_ns

    def _position(self, now_ns: int) -> tuple[float, ...] | None:
        """Where joints and jaw were measured; None where that is too long ago."""
        joints, jaw = self._measured.get("joints"), self._measured.get("jaw")
        if joints is None or jaw is None or now_ns - min(joints[1], jaw[1]) > FRESH_NS:
            return None
        return joints[0] + jaw[0]

    def _pedal(self, now_ns: int) -> bool:
        """Whether the pedal counts: pressed anew since the last motion, by a console that is heard."""
        return self._robot.pedal and self._pedal_down and self._pedal_anew and self._position(now_ns) is not None

    def _attended(self, arming: str, now_ns: int) -> bool:
        issued_ns = self._present.get(arming)
        return issued_ns is not None and now_ns - issued_ns <= PRESENCE_NS

    def _alone(self, arming: str, now_ns: int) -> list[Action]:
        """A set point that nobody stands by: at its beginning, the first heartbeat may still be on its way."""
        if self._gate is Gate.OPEN:
            return self._refuse(arming, "nobody stands by any more", now_ns)
        self._unattended = {arming: self._unattended.get(arming, now_ns)}
        if now_ns - self._unattended[arming] > GRACE_NS:
            return self._refuse(arming, "set points come and nobody stands by", now_ns)
        return []

    def _unfit(self, positions: tuple[float, ...]) -> str:
        axes = self._robot.axes
        if len(positions) != len(axes):
            return f"a set point has {len(positions)} numbers, where the arm has {len(axes)}"
        if not all(math.isfinite(position) for position in positions):
            return "a set point holds a number that is not finite"
        for index, (position, axis) in enumerate(zip(positions, axes, strict=True)):
            if not axis.lower - ROUNDING <= position <= axis.upper + ROUNDING:
                return f"a set point has axis {index + 1} at {position:.4g}, outside {axis.lower:g} to {axis.upper:g}"
        return ""

    def _open(self, arming: str, measured: tuple[float, ...], now_ns: int) -> None:
        self._gate, self._arming, self._reason = Gate.OPEN, arming, ""
        self._last, self._passed_ns = measured, now_ns
        self._credit, self._turns_credit = [math.inf] * len(measured), math.inf

    def _too_far(self, positions: tuple[float, ...], measured: tuple[float, ...], now_ns: int) -> str:
        """Why the arm could not be there: speed times time since the last one, and from where it is measured."""
        elapsed_s, axes = 1e-9 * (now_ns - self._passed_ns), self._robot.axes
        rate = RATE_MARGIN * self._robot.rate_hz
        self._turns_credit = min(self._turns_credit + rate * elapsed_s, max(1.0, rate * BURST_S)) - 1.0
        if self._turns_credit < 0:
            return f"more than {rate:g} set points a second come"
        for index, axis in enumerate(axes):
            travel, ahead = abs(positions[index] - self._last[index]), abs(positions[index] - measured[index])
            credit = min(self._credit[index] + axis.speed * elapsed_s, axis.speed * BURST_S)
            if travel > credit:
                return f"a set point has axis {index + 1} go faster than {axis.speed:g} a second"
            if ahead > axis.speed * AHEAD_S:
                return f"a set point has axis {index + 1} {ahead:.3g} from where it is measured"
            self._credit[index] = credit - travel
        return ""

    def _refuse(self, arming: str, why: str, now_ns: int) -> list[Action]:
        """Hold; neither the arming that moves nor the one that has asked for this passes again."""
        self._forget(arming)
        if self._gate is not Gate.OPEN:
            self._arming = arming
        return self._hold(why, now_ns)

    def _hold(self, why: str, now_ns: int) -> list[Action]:
        self._reason = why
        self._burn(Gate.HELD)
        self._held_ns = self._said_ns = now_ns
        self._paused = False
        return [Action(Kind.HOLD, reason=why)]

    def _hold_again(self, now_ns: int) -> list[Action]:
        """Until the arm is measured to stand."""
        if self._gate is not Gate.HELD or now_ns - self._said_ns < AGAIN_NS or now_ns - self._held_ns > HOLDS_NS:
            return []
        moved_ns = max([self._held_ns, *(since_ns for _, since_ns in self._stood.values())])
        if self._position(now_ns) is not None and now_ns - moved_ns > STANDS_NS:
            return []
        self._said_ns = now_ns
        return [Action(Kind.HOLD, reason=self._reason)]

    def _burn(self, gate: Gate) -> None:
        """The arming that moved never passes again, and the pedal must be pressed anew."""
        self._forget(self._arming)
        self._gate, self._pedal_anew = gate, False

    def _forget(self, arming: str) -> None:
        self._burnt[arming] = None
        self._present.pop(arming, None)
        while len(self._burnt) > BURNT:
            self._burnt.popitem(last=False)
