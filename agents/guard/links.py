"""The monitor's two links: to the robot's Zenoh on this computer, and to the rig, from which heartbeats come.

Every key and setting is given as text (`agents/launch/guard_process.py` makes the document). What cannot be read, or
names another key than the one that it came under, is counted and is nothing.
"""

import base64
import contextlib
import itertools
import json
import math
import os
import struct
import threading
from collections.abc import Callable, Generator
from typing import Any

import zenoh
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.unknown_fields import UnknownFieldSet

from agents.guard import cdr
from agents.guard.monitor import Action, Kind, Monitor
from shared.clock import monotonic_ns, now_ns
from shared.ros.guarded import Gate, GuardedError, alive_from, challenge_bytes, set_point_from

RESTS_NS = 1_000_000_000
"""So long after the last heartbeat or set point nothing moves, and few turns are enough."""
_ATTACHMENT = struct.Struct("<qqB16s")
"""What travels beside a message of rmw_zenoh: sequence number, time, length and bytes of its publisher's id."""


class Links:
    """What is heard goes to the monitor, and what that wants done to the console, one after another.

    `refused` counts messages that were none; `broke`: the robot's Zenoh was lost, if only for a moment.
    """

    def __init__(self, monitor: Monitor, document: dict[str, Any], told: Callable[[str, str], None]) -> None:
        """`told` is told of each hold and pause, and why; it must return at once."""
        self._monitor, self._robot, self._rig, self._told = monitor, document["robot"], document["rig"], told
        messages = DescriptorPool()
        messages.AddSerializedFile(base64.b64decode(self._rig["descriptors"]))
        self._heartbeat: Any = GetMessageClass(messages.FindMessageTypeByName(self._rig["message"]))
        self._lock, self._gid, self._sequence = threading.Lock(), os.urandom(16), itertools.count(1)
        self._sessions, self._kept, self._says = list[zenoh.Session](), list[Any](), dict[str, Any]()
        self._newest = list[tuple[Any, Callable[[tuple[float, ...], float], None]]]()
        self._looked_ns = self._stirred_ns = -math.inf
        self.refused, self.broke = 0, False

    def open_robot(self) -> None:
        """Hear and speak on the robot's Zenoh; waits until that is there."""
        session = self._opened(self._robot["settings"])
        self._kept.append(session.info.declare_transport_events_listener(self._changed))
        for token in self._robot["tokens"]:
            self._kept.append(session.liveliness().declare_token(token.replace("{session}", str(session.zid()))))
        drop, first = zenoh.CongestionControl.DROP, zenoh.Priority.REAL_TIME
        for name, key in self._robot["says"].items():
            self._says[name] = session.declare_publisher(key, congestion_control=drop, priority=first, express=True)
        measured = {"measured_js": self._monitor.hear_joints, "jaw/measured_js": self._monitor.hear_jaw}
        for name, key in self._robot["hears"].items():
            if name in measured:
                self._newest.append((session.declare_subscriber(key, zenoh.handlers.RingChannel(1)), measured[name]))
            else:
                self._hear(session, name, key, allowed_origin=zenoh.Locality.REMOTE)

    def open_rig(self) -> None:
        """Hear heartbeats; waits until the rig is there, before which nobody stands by."""
        self._hear(self._opened(self._rig["settings"]), "heartbeat", self._rig["heartbeat"])

    def turn(self) -> bool:
        """What follows from time alone; whether something moves, or is about to."""
        with self._judging():
            self._measure()
        with self._judging():
            self._do(self._monitor.turn(monotonic_ns()))
        return monotonic_ns() - self._stirred_ns < RESTS_NS

    def challenge(self) -> None:
        """Tell the bridge the next challenge."""
        with self._judging():
            told = self._monitor.challenge(monotonic_ns())
            self._says["challenge"].put(challenge_bytes(str(self._says["challenge"].key_expr), told))

    def end(self, why: str) -> None:
        """Have the console hold where something moves; nothing passes after it, for nothing is judged any more."""
        self._lock.acquire()
        if self._monitor.gate is Gate.OPEN:
            self._hold(why)

    def _opened(self, settings: dict[str, Any]) -> zenoh.Session:
        """A session with these settings; it waits until the other end is there."""
        config = zenoh.Config()
        for name, value in settings.items():
            config.insert_json5(name, json.dumps(value))
        self._sessions.append(zenoh.open(config))
        return self._sessions[-1]

    def _changed(self, event: Any) -> None:
        self.broke = self.broke or event.kind == zenoh.SampleKind.DELETE

    def _hear(self, session: zenoh.Session, name: str, key: str, **how: Any) -> None:
        def heard(sample: zenoh.Sample) -> None:
            with self._judging():
                self._do(self._judged(name, sample) or [])

        self._kept.append(session.declare_subscriber(key, heard, **how))

    @contextlib.contextmanager
    def _judging(self) -> Generator[None]:
        """One at a time; whatever goes wrong in it, other than bytes that are no message, has the arm held."""
        with self._lock:
            try:
                yield
            except (GuardedError, cdr.CdrError, DecodeError):
                self.refused += 1
            except Exception as error:
                self._hold(f"the guard failed: {type(error).__name__}: {error}")

    def _hold(self, why: str) -> None:
        """Where not even that can be said, the link is of no use any more."""
        try:
            self._do(self._monitor.hold(why, monotonic_ns()))
        except zenoh.ZError:
            self.broke = True

    def _judged(self, name: str, sample: zenoh.Sample) -> list[Action] | None:
        """What the monitor says to a message."""
        key, data, at_ns = str(sample.key_expr), sample.payload.to_bytes(), monotonic_ns()
        match name:
            case "set_point":
                self._stirred_ns = at_ns
                self._measure()
                return self._monitor.hear_set_point(set_point_from(key, data), at_ns)
            case "heartbeat":
                beat, own = self._heartbeat.FromString(data), (self._rig["heartbeat"], self._rig["encoding"])
                if (key, str(sample.encoding)) != own or len(UnknownFieldSet(beat)):
                    raise GuardedError("it is no heartbeat of this arm and version, or was sent under another key")
                self._stirred_ns = at_ns
                return self._monitor.hear_heartbeat(beat.arm, beat.arming_id, beat.guard_challenge, beat.pressed, at_ns)
            case "alive":
                return self._monitor.hear_alive(alive_from(key, data), at_ns)
            case "pedal":
                return self._monitor.hear_pedal(cdr.pressed(data), at_ns)
            case "hold":
                return self._monitor.hear_hold(at_ns)
            case _:
                return self._monitor.hear_stranger(at_ns)

    def _measure(self) -> None:
        """Read the newest measurements, which came after the last look; as old as that look they count."""
        looked_ns, self._looked_ns = self._looked_ns, monotonic_ns()
        for newest, hear in self._newest:
            if (sample := newest.try_recv()) is not None:
                hear(cdr.joint_positions(sample.payload.to_bytes()), looked_ns)

    def _do(self, actions: list[Action]) -> None:
        for action in actions:
            if action.kind is Kind.PASS:
                self._say("servo_jp", cdr.joint_state(action.positions[:-1], now_ns()))
                self._say("jaw/servo_jp", cdr.joint_state(action.positions[-1:], now_ns()))
            else:
                pause = "state_command", cdr.string_stamped("pause", now_ns())
                self._say(*(pause if action.kind is Kind.PAUSE else ("hold", cdr.EMPTY)))
                self._told(action.kind.value, action.reason)

    def _say(self, name: str, payload: bytes) -> None:
        own = next(self._sequence), now_ns(), len(self._gid), self._gid
        self._says[name].put(payload, attachment=_ATTACHMENT.pack(*own) if self._robot["attachments"] else None)
