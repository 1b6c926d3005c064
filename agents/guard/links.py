"""The monitor's two links: to the robot's Zenoh on this computer, and to the rig, from which heartbeats come.

Every key and setting is given as text (`agents/cli/running/guard.py` makes the document). What cannot be read, or names
another key than the one that it came under, is counted and is nothing.
"""

import contextlib
import itertools
import json
import os
import struct
import threading
from collections.abc import Callable
from typing import Any

import zenoh
from google.protobuf.message import DecodeError
from google.protobuf.unknown_fields import UnknownFieldSet

from agents.guard import cdr
from agents.guard.monitor import Action, Kind, Monitor
from schemas.generated.suturegrasp_pb2 import Heartbeat
from shared.clock import monotonic_ns, now_ns
from shared.ros.guarded import GuardedError, alive_from, challenge_bytes, set_point_from

MEASURED = ("measured_js", "jaw/measured_js")
RESTS_NS = 1_000_000_000
"""So long after the last heartbeat or set point nothing moves, and few turns are enough."""
_ATTACHMENT = struct.Struct("<qqB16s")
"""What travels beside a message of rmw_zenoh: sequence number, time, length and bytes of its publisher's id."""


def opened(settings: dict[str, Any]) -> zenoh.Session:
    """A session with these settings; it waits until the other end is there."""
    config = zenoh.Config()
    for name, value in settings.items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


class Links:
    """What is heard goes to the monitor, and what that wants done to the console, one after another.

    Fields:
        refused: how many messages were no messages.
        broke: the link to the robot's Zenoh was lost, if only for a moment.
    """

    def __init__(self, monitor: Monitor, document: dict[str, Any], told: Callable[[str, str], None]) -> None:
        """`told` is told of each hold and pause, and why; it must return at once."""
        self._monitor, self._document, self._told = monitor, document, told
        self._lock, self._says = threading.Lock(), dict[str, Any]()
        self._gid, self._sequence, self.refused = os.urandom(16), itertools.count(1), 0
        self._kept: list[Any] = []
        self._robot: zenoh.Session | None = None
        self._newest, self._looked_ns, self._stirred_ns = dict[str, Any](), 0, 0
        self.broke = False

    def open_robot(self) -> None:
        """Hear and speak on the robot's Zenoh; waits until that is there."""
        robot = self._document["robot"]
        session = self._robot = opened(robot["settings"])
        self._kept.append(session.info.declare_transport_events_listener(self._changed))
        for token in robot["tokens"]:
            self._kept.append(session.liveliness().declare_token(token.replace("{session}", str(session.zid()))))
        drop, first = zenoh.CongestionControl.DROP, zenoh.Priority.REAL_TIME
        for name, key in robot["says"].items():
            publisher = session.declare_publisher(key, congestion_control=drop, priority=first, express=True)
            self._says[name] = publisher
        hears = {
            "set_point": self._hear_set_point,
            "alive": lambda key, data: self._monitor.hear_alive(alive_from(key, data), monotonic_ns()),
            "pedal": lambda _, data: self._monitor.hear_pedal(cdr.pressed(data), monotonic_ns()),
            "servo_jp": lambda _key, _data: self._monitor.hear_stranger(monotonic_ns()),
            "jaw/servo_jp": lambda _key, _data: self._monitor.hear_stranger(monotonic_ns()),
            "hold": lambda _key, _data: self._monitor.hear_hold(monotonic_ns()),
        }
        for name, key in robot["hears"].items():
            if name in MEASURED:
                newest = session.declare_subscriber(key, zenoh.handlers.RingChannel(1))
                self._newest[name] = newest
                continue
            heard = self._heard(hears[name])
            self._kept.append(session.declare_subscriber(key, heard, allowed_origin=zenoh.Locality.REMOTE))

    def open_rig(self) -> None:
        """Hear heartbeats; waits until the rig is there."""
        rig = self._document["rig"]
        session = opened(rig["settings"])

        def hear(key: str, data: bytes, encoding: str) -> None:
            if key != rig["heartbeat"] or encoding != rig["encoding"]:
                raise GuardedError("it is no heartbeat of this arm, or was sent under another key")
            beat = Heartbeat.FromString(data)
            if len(UnknownFieldSet(beat)):
                raise GuardedError("it is of a version that this guard does not know")
            said = beat.arm, beat.arming_id, beat.guard_challenge, beat.pressed
            self._stirred_ns = monotonic_ns()
            self._monitor.hear_heartbeat(*said, monotonic_ns())

        def heard(sample: zenoh.Sample) -> None:
            with self._judging():
                hear(str(sample.key_expr), sample.payload.to_bytes(), str(sample.encoding))

        self._kept += [session, session.declare_subscriber(rig["heartbeat"], heard)]

    def turn(self) -> bool:
        """What follows from time alone; whether something moves, or is about to."""
        with self._judging():
            self._measure()
            self._do(self._monitor.turn(monotonic_ns()))
        return monotonic_ns() - self._stirred_ns < RESTS_NS

    def challenge(self) -> None:
        """Tell the bridge the next challenge."""
        with self._judging():
            told = self._monitor.challenge(monotonic_ns())
            self._say("challenge", challenge_bytes(str(self._says["challenge"].key_expr), told))

    def hold(self, why: str) -> None:
        """Have the console hold, whatever the monitor makes of it."""
        with self._lock:
            self._do([Action(Kind.HOLD, reason=why)])

    def _changed(self, event: Any) -> None:
        self.broke = self.broke or event.kind == zenoh.SampleKind.DELETE

    def _heard(self, hear: Callable[[str, bytes], list[Action] | None]) -> Callable[[zenoh.Sample], None]:
        def heard(sample: zenoh.Sample) -> None:
            with self._judging():
                self._do(hear(str(sample.key_expr), sample.payload.to_bytes()) or [])

        return heard

    @contextlib.contextmanager
    def _judging(self) -> Any:
        """One at a time; whatever goes wrong in it, other than bytes that are no message, has the arm held."""
        with self._lock:
            try:
                yield
            except (GuardedError, cdr.CdrError, DecodeError):
                self.refused += 1
            except Exception as error:
                self._hold_failing(error)

    def _hold_failing(self, error: Exception) -> None:
        """Where not even that can be said, the link is of no use any more."""
        try:
            self._do([Action(Kind.HOLD, reason=f"the guard failed: {type(error).__name__}: {error}")])
        except zenoh.ZError:
            self.broke = True

    def _hear_set_point(self, key: str, data: bytes) -> list[Action]:
        said = set_point_from(key, data)
        self._stirred_ns = monotonic_ns()
        self._measure()
        return self._monitor.hear_set_point(said, monotonic_ns())

    def _measure(self) -> None:
        """Read the newest measurements, which came after the last look; as old as that look they count."""
        looked_ns, self._looked_ns = self._looked_ns, monotonic_ns()
        for name, hear in (("measured_js", self._monitor.hear_joints), ("jaw/measured_js", self._monitor.hear_jaw)):
            newest = self._newest.get(name)
            if newest is not None and (sample := newest.try_recv()) is not None:
                hear(cdr.joint_positions(sample.payload.to_bytes()), looked_ns)

    def _do(self, actions: list[Action]) -> None:
        for action in actions:
            if action.kind is Kind.PASS:
                stamp_ns = now_ns()
                self._say("servo_jp", cdr.joint_state(action.positions[:-1], stamp_ns))
                self._say("jaw/servo_jp", cdr.joint_state(action.positions[-1:], stamp_ns))
            else:
                if action.kind is Kind.HOLD:
                    self._say("hold", cdr.EMPTY)
                else:
                    self._say("state_command", cdr.string_stamped(action.kind.value, now_ns()))
                self._told(action.kind.value, action.reason)

    def _say(self, name: str, payload: bytes) -> None:
        beside = None
        if self._document["robot"]["attachments"] and name != "challenge":
            beside = _ATTACHMENT.pack(next(self._sequence), now_ns(), len(self._gid), self._gid)
        self._says[name].put(payload, attachment=beside)
