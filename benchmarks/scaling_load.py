"""What a rig sends through its router and who hears it, from payloads that were recorded: the load of the scaling runs.

    python -m benchmarks.scaling_load '{"role": "hear", "endpoint": "tcp/127.0.0.1:7447", "rig": "lab", ...}'

is one end: `send` plays all agents of one rig, `hear` all that read it. Each agent has a session of its own, with its
own certificate where the router asks for one. An end says `ready`, is given a line with the seconds that count, and
prints what it sent or heard. Frames are those of a camera as JPEG; payloads are not decoded, which costs no router.
"""

import contextlib
import functools
import json
import os
import sys
import threading
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from schemas.topics import (
    CALIBRATION,
    COMMANDS,
    EXECUTION,
    FRAMES,
    HEALTH,
    HEARTBEAT,
    MAIN,
    OBSERVATIONS,
    PLAN,
    ROBOT_STATE,
    SURFACE,
    THREAD,
    Delivery,
    Topic,
    key,
    topic_of,
)
from shared.clock import monotonic_s, now_ns
from shared.recording.mcap_file import read_recording
from shared.runtime.access import common_name
from shared.runtime.accounts import RingLosses
from shared.runtime.attachment import Attachment, pack, unpack
from shared.runtime.delivery import declare_publisher, ring_room, subscribe
from shared.runtime.identity import identity_in
from shared.runtime.process import keep_freed_memory
from shared.runtime.session import SessionSettings, open_session

EXAMPLE = Path(__file__).parents[1] / "docs" / "example" / "session.mcap"
SESSION = "SUTUREGRASP_SCALING_SESSION"
"""Environment: another recording whose payloads are sent, for all processes of a run."""
EVENT_HZ = 2.0
"""Of each event: a grasp has about ten of all kinds together, in a few seconds."""
HEALTH_HZ = 1.0
AGENTS = ("camera", "perception", "reconstruction", "planner", "robot_bridge")
WARM_UP_S, ARRIVE_S = 2.0, 1.5
OPERATOR = "operator"
HEARERS: dict[str, tuple[Topic, ...]] = {
    "perception": (FRAMES, CALIBRATION),
    "reconstruction": (OBSERVATIONS,),
    "planner": (THREAD, ROBOT_STATE),
    "robot_bridge": (PLAN, HEARTBEAT),
    OPERATOR: (HEALTH, EXECUTION, COMMANDS),
}
"""The agents of a rig, and an operator's status. The surface is the viewer's alone."""
EVERYTHING: dict[str, tuple[Topic, ...]] = {
    "viewer": tuple({t for topics in HEARERS.values() for t in topics} | {SURFACE})
}
"""A viewer or a recorder."""
FOLLOWED: dict[str, tuple[Topic, ...]] = {"viewer": (THREAD, HEALTH, EXECUTION, PLAN)}
"""Somebody elsewhere who follows what is going on."""
AUDIENCES = {"agents": HEARERS, "everything": EVERYTHING, "followed": FOLLOWED}


@dataclass(frozen=True)
class End:
    """One end of a rig's load.

    Fields:
        instance, arm, operator: in the keys of this rig's agents, of its arm, and of its operator.
        audience: who hears, one of AUDIENCES.
        certificates: folder; empty where the router asks for none.
        phase: share of a period by which this rig is behind the others.
    """

    role: str
    endpoint: str
    rig: str
    instance: str = MAIN
    arm: str = "psm1"
    operator: str = "desk"
    audience: str = "agents"
    certificates: str = ""
    phase: float = 0.0

    def to_json(self) -> str:
        """As it is handed to the process."""
        return json.dumps(asdict(self))

    def instance_of(self, kind: str) -> str:
        """Of an agent of this rig."""
        return {"robot_bridge": self.arm, OPERATOR: self.operator, "viewer": self.operator}.get(kind, self.instance)

    def session_of(self, kind: str) -> SessionSettings:
        """How an agent of this rig reaches the router."""
        name = common_name(kind, self.instance_of(kind))
        return SessionSettings(
            self.rig, self.endpoint, identity_in(Path(self.certificates), name) if self.certificates else None
        )


@dataclass(frozen=True)
class Stream:
    """One key: its payloads in turn, so many a second (0: once)."""

    topic: Topic
    agent: str
    payloads: tuple[bytes, ...]
    rate_hz: float

    @property
    def bytes(self) -> float:
        """Of a payload, the mean."""
        return sum(map(len, self.payloads)) / len(self.payloads)


@functools.cache
def streams() -> tuple[Stream, ...]:
    """What one rig publishes, with the sizes of the recorded session and the rates of the topic table."""
    recorded: defaultdict[tuple[Topic, str], list[bytes]] = defaultdict(list)
    for entry in read_recording(Path(os.environ.get(SESSION, EXAMPLE))):
        topic, agent = topic_of(entry.key), entry.key.split("/")[2]
        # no rig of a lab has a simulator
        if agent != "simulator":
            recorded[topic, agent].append(entry.payload)
    return tuple(Stream(t, agent, tuple(payloads), rate_hz(t)) for (t, agent), payloads in recorded.items())


def rate_hz(topic: Topic) -> float:
    """How often a rig says something of a topic; 0 for once."""
    if topic.delivery is Delivery.STATE:
        return 0.0
    return EVENT_HZ if topic.delivery is Delivery.EVENT else topic.rate_hz or HEALTH_HZ


def key_of(end: End, topic: Topic, agent: str) -> str:
    """Where a rig's agent publishes a topic; that of an operator is the arm's."""
    return key(end.rig, topic, end.arm if topic.per_arm else end.instance_of(agent), agent)


def main() -> None:
    """Be the end that the first argument describes; what was sent or heard is printed as one line of JSON."""
    keep_freed_memory()
    end = End(**json.loads(sys.argv[1]))
    with contextlib.ExitStack() as stack:
        done = (hear if end.role == "hear" else send)(end, stack)
        print(json.dumps(done), flush=True)


def send(end: End, stack: contextlib.ExitStack) -> dict[str, list[int]]:
    """Publish everything; by key, the first sequence number that counts and the one after the last."""
    sessions = {agent: stack.enter_context(open_session(end.session_of(agent))) for agent in (*AGENTS, OPERATOR)}
    mine = streams()
    keys = [key_of(end, stream.topic, stream.agent) for stream in mine]
    publishers = [declare_publisher(sessions[s.agent], k, s.topic) for s, k in zip(mine, keys, strict=True)]
    print("ready", flush=True)
    seconds, pause = float(sys.stdin.readline()), threading.Event()
    begin_s = monotonic_s() + WARM_UP_S
    due_s = [monotonic_s() + (end.phase / s.rate_hz if s.rate_hz else 0.0) for s in mine]
    counts, first = [0] * len(mine), [0] * len(mine)
    while (at_s := monotonic_s()) < begin_s + seconds:
        for number, stream in enumerate(mine):
            if at_s < due_s[number]:
                continue
            if at_s < begin_s and stream.rate_hz:
                first[number] = counts[number] + 1
            payload = stream.payloads[counts[number] % len(stream.payloads)]
            publishers[number].put(payload, attachment=pack(Attachment(1, counts[number], now_ns(), 0.0)))
            counts[number] += 1
            due_s[number] = due_s[number] + 1.0 / stream.rate_hz if stream.rate_hz else begin_s + 2.0 * seconds
        pause.wait(max(0.0, min(due_s) - monotonic_s()))
    pause.wait(ARRIVE_S)
    return {k: [one, count] for k, one, count in zip(keys, first, counts, strict=True)}


def hear(end: End, stack: contextlib.ExitStack) -> dict[str, Any]:
    """Hear what the audience hears; by key, numbers and milliseconds on the way, and what it counts as lost."""
    heard: defaultdict[str, list[tuple[int, float]]] = defaultdict(list)
    rings, missed, kept = dict[str, RingLosses](), defaultdict[str, int](int), list[Any]()

    def put_away(sample: Any) -> None:
        at_ns, beside = now_ns(), unpack(sample.attachment.to_bytes())
        # copied as every agent copies it
        sample.payload.to_bytes()
        if beside is not None:
            heard[str(sample.key_expr)].append((beside.sequence, 1e-6 * (at_ns - beside.published_ns)))

    for kind, topics in AUDIENCES[end.audience].items():
        session = stack.enter_context(open_session(end.session_of(kind)))
        for stream in streams():
            if stream.topic not in topics:
                continue
            where = key_of(end, stream.topic, stream.agent)
            ring = rings.setdefault(where, RingLosses(ring_room(where)))

            def miss(count: int, where: str = where) -> None:
                missed[where] += count

            kept += subscribe(session, where, stream.topic, put_away, miss, ring)
    print("ready", flush=True)
    seconds = float(sys.stdin.readline())
    threading.Event().wait(WARM_UP_S + seconds + ARRIVE_S)
    for declared in kept:
        declared.undeclare()
    lost = {where: ring.lost + ring.overwritten + missed[where] for where, ring in rings.items()}
    return {"heard": {where: heard[where] for where in rings}, "lost": lost}


if __name__ == "__main__":
    main()
