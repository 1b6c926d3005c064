"""What a robot bridge and the guard beside the console say to each other, on keys of their own on the robot's Zenoh.

Each message begins with the key that it was sent under, since Zenoh has handed over messages under wrong keys
(docs/decisions.md, 29): what names another key is none. Nothing here needs NumPy, so that the guard does without it.

    bridge -> guard    guarded/PSM1/set_point    one set point of all joints and the jaw
    bridge -> guard    guarded/PSM1/alive        nothing moves; or the motion has ended as it should
    guard -> bridge    guarded/PSM1/challenge    a number that the bridge's messages, and heartbeats, must echo

A challenge is a random number. The guard alone knows when it issued which, by its own monotonic clock, so that the age
of whatever echoes one needs no clock of anybody else's.
"""

import enum
import math
import struct
from dataclasses import dataclass

GUARDED = "guarded"
SET_POINT, ALIVE, CHALLENGE = "set_point", "alive", "challenge"
MAGIC = b"SG1"
UNKNOWN_MS = -1.0
LONGEST_TEXT = 300
_ECHO = struct.Struct("<QQ32s")
"""Sequence number, the guard's newest challenge, the arming's id as 32 bytes of text padded with zeros."""
_ALIVE = struct.Struct("<?")
_CHALLENGE = struct.Struct("<QQBBd32s")


class GuardedError(ValueError):
    """Bytes that are no message of this link, or one that was sent under another key; the text says which."""


class Gate(enum.Enum):
    """What the guard does with set points: SHUT until one comes that may pass, OPEN, or HELD until armed anew."""

    SHUT = 0
    OPEN = 1
    HELD = 2


@dataclass(frozen=True)
class SetPoint:
    """Where an arm is to go next.

    Fields:
        sequence: counts all that one run of a bridge says.
        challenge: the guard's newest that the bridge has heard.
        arming_id: of the Arm command that the motion belongs to.
        positions: joints (rad, the third of a PSM in m), then the jaw (rad).
    """

    sequence: int
    challenge: int
    arming_id: str
    positions: tuple[float, ...]


@dataclass(frozen=True)
class Alive:
    """A bridge that sends no set point now; fields as in SetPoint.

    Fields:
        ended: the motion of `arming_id` has ended as it should.
    """

    sequence: int
    challenge: int
    arming_id: str = ""
    ended: bool = False


@dataclass(frozen=True)
class Challenge:
    """What a guard says.

    Fields:
        challenge: the newest number, never 0.
        answers: the sequence number of the newest message of the bridge that was heard; 0 before the first.
        round_trip_ms: for how long a newer challenge had been out than the one that it echoed: how long the way there
            and back takes, 0 where it echoed the newest; UNKNOWN_MS where it echoed none that is known.
        gate, arming_id: what it does with set points, and of which arming; `reason` why, where they are held.
        pedal: the console's operator-present pedal is down, was pressed anew since the last motion, and its console
            is heard.
    """

    challenge: int
    answers: int
    round_trip_ms: float
    gate: Gate
    pedal: bool
    arming_id: str = ""
    reason: str = ""


def key_of(console: str, topic: str) -> str:
    """The key of a message, such as `guarded/PSM1/alive`."""
    return f"{GUARDED}/{console}/{topic}"


def set_point_bytes(key: str, said: SetPoint) -> bytes:
    """A set point as it travels.

    Raises:
        GuardedError: where a position is not finite, or the arming has no id that fits.
    """
    if not said.positions or not all(math.isfinite(position) for position in said.positions):
        raise GuardedError("a set point needs positions, all of them finite")
    return _head(key) + _echo(said) + struct.pack(f"<{len(said.positions)}d", *said.positions)


def alive_bytes(key: str, said: Alive) -> bytes:
    """That a bridge is there, as it travels."""
    return _head(key) + _echo(said) + _ALIVE.pack(said.ended)


def challenge_bytes(key: str, said: Challenge) -> bytes:
    """A challenge as it travels."""
    fixed = said.challenge, said.answers, said.gate.value, said.pedal, said.round_trip_ms, _id_bytes(said.arming_id)
    return _head(key) + _CHALLENGE.pack(*fixed) + said.reason[:LONGEST_TEXT].encode(errors="replace")


def set_point_from(key: str, data: bytes) -> SetPoint:
    """The set point that came under this key; its positions may be anything, and any number of them.

    Raises:
        GuardedError: where it is none, or was sent under another key.
    """
    echo, rest = _split(_body(key, data))
    if not rest or len(rest) % 8:
        raise GuardedError(f"a set point ends in {len(rest)} bytes, which are no numbers")
    return SetPoint(*echo, struct.unpack(f"<{len(rest) // 8}d", rest))


def alive_from(key: str, data: bytes) -> Alive:
    """What came under this key.

    Raises:
        GuardedError: as for a set point.
    """
    echo, rest = _split(_body(key, data))
    if len(rest) != _ALIVE.size or rest not in (b"\0", b"\1"):
        raise GuardedError("what a bridge says of being alive has another length")
    return Alive(*echo, rest == b"\1")


def challenge_from(key: str, data: bytes) -> Challenge:
    """The challenge that came under this key.

    Raises:
        GuardedError: as for a set point.
    """
    body = _body(key, data)
    if len(body) < _CHALLENGE.size:
        raise GuardedError("a challenge is cut off")
    challenge, answers, gate, pedal, round_trip_ms, arming = _CHALLENGE.unpack_from(body)
    if gate > Gate.HELD.value or pedal > 1 or challenge == 0 or not math.isfinite(round_trip_ms):
        raise GuardedError("a challenge has a value that it cannot have")
    reason = body[_CHALLENGE.size :][: 4 * LONGEST_TEXT].decode(errors="replace")
    return Challenge(challenge, answers, round_trip_ms, Gate(gate), pedal == 1, _id_from(arming), reason)


def _head(key: str) -> bytes:
    named = key.encode()
    return MAGIC + bytes((len(named),)) + named


def _body(key: str, data: bytes) -> bytes:
    head = _head(key)
    if data[: len(head)] != head:
        raise GuardedError("it is no message of a bridge and its guard, or was sent under another key")
    return data[len(head) :]


def _echo(said: SetPoint | Alive) -> bytes:
    return _ECHO.pack(said.sequence, said.challenge, _id_bytes(said.arming_id))


def _split(body: bytes) -> tuple[tuple[int, int, str], bytes]:
    if len(body) < _ECHO.size:
        raise GuardedError("a message of a bridge to its guard is cut off")
    sequence, challenge, arming = _ECHO.unpack_from(body)
    return (sequence, challenge, _id_from(arming)), body[_ECHO.size :]


def _id_bytes(arming_id: str) -> bytes:
    named = arming_id.encode(errors="replace")
    if len(named) > 32 or b"\0" in named:
        raise GuardedError("the id of an arming has at most 32 bytes, none of them zero")
    return named


def _id_from(padded: bytes) -> str:
    named = padded.rstrip(b"\0")
    try:
        if b"\0" not in named:
            return named.decode()
    except UnicodeDecodeError:
        pass
    raise GuardedError("the id of an arming is no text")
