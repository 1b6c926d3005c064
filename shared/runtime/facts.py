"""What every agent answers at once, from Zenoh's threads, however long a step takes.

It tells its host's time, where it runs and what it was granted there, how far it has got with each key, and sends as
many bytes as it is asked for: so the way from it is measured, and the way to it by questions that carry as many. Those
bytes are random, so that nothing on the way can make them fewer.

A replay that goes as fast as its consumers asks for their progress after each message, and sends the next one when all
has been handled that follows from it.
"""

import contextlib
import importlib.metadata
import os
import platform
import shutil
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import zenoh

import schemas
from schemas.checks import MessageError
from schemas.codec import decode, encode
from schemas.messages import AgentFacts, ClockReading, Consumed, Progress, RigSection, TopicOverride
from schemas.topics import key_root
from schemas.wire import schemas_hash
from shared.clock import monotonic_s, now_ns, processor_s
from shared.runtime.accounts import resident_bytes
from shared.runtime.attachment import encoding_of, other_key

FACTS, CLOCK, PROGRESS, LINK = "facts", "clock", "progress", "link"
"""The last parts of the keys under which an agent answers; nothing is published there."""
ANSWER_WAIT_S, PROGRESS_WAIT_S = 2.0, 1.0
M = TypeVar("M")


@dataclass(frozen=True)
class Surroundings:
    """What an agent's process knows of its host that its agent does not.

    Fields:
        writes_to: the folder that it writes to, None where it writes nothing.
        calibrated_ns: when the calibration that it uses was made, since 1970; None where nobody knows.
        certificate_expires_ns: None where it runs without a certificate.
        realtime_asked: the real-time priority that it asked for; None for none.
        realtime_refused: why it was not granted; empty where it was, or nothing was asked for.
        overrides: what it was told to do otherwise with topics than their table says.
        rig_sections: of the rig's file that it began with, by a digest of each.
    """

    writes_to: Path | None = None
    calibrated_ns: int | None = None
    certificate_expires_ns: int | None = None
    realtime_asked: int | None = None
    realtime_refused: str = ""
    overrides: tuple[TopicOverride, ...] = ()
    rig_sections: tuple[RigSection, ...] = ()


def ask_for_realtime(priority: int) -> str:
    """Have this thread, and those that it starts from now on, run before all ordinary ones; why not, or empty."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError) as error:
        said = error.strerror if isinstance(error, OSError) else "this system has no such scheduler"
        return f"{said}: allow it, with LimitRTPRIO= in the unit or rtprio in limits.conf"
    return ""


def facts_of(
    session: zenoh.Session, kind: str, instance: str, config_hash: str, around: Surroundings, granted: int | None
) -> AgentFacts:
    """The facts of this process now; `granted` is the real-time priority of its loop."""
    shared_memory, why = _shared_memory(session)
    return AgentFacts(
        agent=kind,
        instance=instance,
        host=socket.gethostname(),
        at_ns=now_ns(),
        version=schemas.__version__,
        schemas_hash=schemas_hash(),
        config_hash=config_hash,
        python=platform.python_version(),
        zenoh=importlib.metadata.version("eclipse-zenoh"),
        shared_memory=shared_memory,
        shared_memory_reason=why,
        realtime_asked=around.realtime_asked,
        realtime_granted=granted,
        realtime_reason=_realtime_reason(around, granted),
        writes_to=str(around.writes_to.absolute()) if around.writes_to is not None else "",
        disk_free_bytes=_free_bytes(around.writes_to) if around.writes_to is not None else None,
        calibrated_ns=around.calibrated_ns,
        certificate_expires_ns=around.certificate_expires_ns,
        processor_s=processor_s(),
        resident_bytes=resident_bytes(),
        overrides=around.overrides,
        rig_sections=around.rig_sections,
    )


def realtime_priority() -> int | None:
    """The real-time priority of the thread that calls, None where it has none."""
    try:
        if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR):
            return os.sched_getparam(0).sched_priority
    except (OSError, AttributeError):
        return None
    return None


def answer_facts(session: zenoh.Session, root: str, facts: Callable[[], AgentFacts]) -> Any:
    """Have the facts told to whoever asks, under the root of an agent's keys; keep what is returned."""
    return _answer(session, f"{root}/{FACTS}", facts)


def ask_facts(session: zenoh.Session, rig: str, kind: str = "*", instance: str = "*") -> dict[str, AgentFacts]:
    """The facts of every agent that answers, by `kind/instance`."""
    return _ask(session, f"{key_root(rig, instance, kind)}/{FACTS}", AgentFacts, ANSWER_WAIT_S)


def answer_clock(session: zenoh.Session, root: str) -> Any:
    """Have this host's clock told to whoever asks; keep what is returned."""
    host = socket.gethostname()
    return _answer(session, f"{root}/{CLOCK}", lambda: ClockReading(host, now_ns()))


class Handled:
    """The newest message of each key that a consumer is done with; any thread notes and reads."""

    def __init__(self) -> None:
        self._newest: dict[str, tuple[int, int]] = {}

    def note(self, key: str, epoch: int, sequence: int) -> None:
        """A message is done with, and whatever followed from it has been published."""
        at = self._newest.get(key)
        if at is None or at[0] != epoch or at[1] < sequence:
            self._newest[key] = epoch, sequence

    def listed(self) -> tuple[Consumed, ...]:
        """What was noted so far."""
        return tuple(Consumed(key, *place) for key, place in dict(self._newest).items())


def answer_progress(
    session: zenoh.Session,
    root: str,
    listens: Iterable[str],
    handled: Handled,
    published: Callable[[], tuple[Consumed, ...]] = lambda: (),
) -> Any:
    """Have it told how far a consumer has got, under the root of its keys; keep what is returned."""
    selectors = " ".join(listens)

    def progress() -> Progress:
        # what follows from a message is published before it is noted: in this order, nothing that followed is missing
        noted = handled.listed()
        return Progress(selectors, noted, published())

    return _answer(session, f"{root}/{PROGRESS}", progress)


def ask_progress(session: zenoh.Session, rig: str) -> dict[str, Progress]:
    """How far every consumer of a rig has got, as `kind/instance`."""
    return _ask(session, f"{key_root(rig, '*', '*')}/{PROGRESS}", Progress, PROGRESS_WAIT_S)


def matches(selector: str, key: str) -> bool:
    """Whether a key is one of those that a consumer listens to; `*` stands for any one part."""
    ours, theirs = selector.split("/"), key.split("/")
    return len(ours) == len(theirs) and all(a in ("*", b) for a, b in zip(ours, theirs, strict=True))


def _answer(session: zenoh.Session, own: str, told: Callable[[], Any]) -> Any:
    def answer(query: zenoh.Query) -> None:
        message = told()
        query.reply(own, encode(message), encoding=encoding_of(type(message), own))
        query.drop()

    return session.declare_queryable(own, answer)


def _ask(session: zenoh.Session, selector: str, message_type: type[M], wait_s: float) -> dict[str, M]:
    """What everybody answers, by `kind/instance`; what cannot be read, or names another key, is left out."""
    everybody, unmerged = zenoh.QueryTarget.ALL, zenoh.ConsolidationMode.NONE
    found: dict[str, M] = {}
    for reply in session.get(selector, target=everybody, consolidation=unmerged, timeout=wait_s):
        if reply.ok is not None and not other_key(reply.ok.encoding, str(reply.ok.key_expr)):
            with contextlib.suppress(MessageError):
                name = "/".join(str(reply.ok.key_expr).split("/")[2:4])
                found[name] = decode(message_type, reply.ok.payload.to_bytes())
    return dict(sorted(found.items()))


def _shared_memory(session: zenoh.Session) -> tuple[bool, str]:
    """Whether what this session sends and receives goes through shared memory, and why or why not."""
    # what Zenoh's type stubs leave out is there where the wheel was built with shared memory
    transports: list[Any] = session.info.transports()
    if not transports:
        return False, "no router is connected"
    if all(transport.is_shm for transport in transports):
        return True, "the router is on this host, and large messages pass through /dev/shm"
    # from one machine to itself both ends have one address, loopback or not
    if any(_address_of(link.src) == _address_of(link.dst) for link in session.info.links()):
        return False, "the router is on this host, and does not share /dev/shm with this process"
    return False, "the router is on another host"


def _address_of(locator: object) -> str:
    """The address in something like tls/10.0.0.11:7447."""
    return str(locator).split("/")[-1].rpartition(":")[0]


def _realtime_reason(around: Surroundings, granted: int | None) -> str:
    if around.realtime_asked is None:
        return "" if granted is None else "given by whoever started it"
    if granted is None:
        return around.realtime_refused or "it was taken away again"
    return ""


def _free_bytes(folder: Path) -> int | None:
    there = next((p for p in (folder.absolute(), *folder.absolute().parents) if p.exists()), None)
    try:
        return shutil.disk_usage(there).free if there is not None else None
    except OSError:
        return None


BYTES = "bytes"
MOST_BYTES = 4 << 20
FRAME_BYTES = 1_500_000
"""As many as a raw stereo pair has, of 960x540 pixels with half of the colours left out."""
LEAST_BYTES = 1 << 16
GROWTH, TRIED = 4, 3
LONG_ENOUGH_S = 0.025
"""More is sent at once until it takes so long. An arm holds where its operator's heartbeat is 200 ms late, and what
measures a link must not be why."""
ROUND_TRIPS, FRAMES = 50, 8
MEASURED_S = 1.0
"""How long a slow link is kept busy in either direction."""
LINK_WAIT_S = 2.0


@dataclass(frozen=True)
class Link:
    """What was measured to one agent and back.

    Fields:
        latency_ms, latency_ms_p99: the median and the 99th percentile of round trips of a few bytes.
        bytes_per_s, bytes_per_s_there: how fast large answers come from it, and large questions reach it, the time of
            a round trip left out; at most so fast where one took too long to be waited for.
    """

    latency_ms: float
    latency_ms_p99: float
    bytes_per_s: float
    bytes_per_s_there: float


def answer_link(session: zenoh.Session, root: str) -> Any:
    """Have bytes sent to whoever asks, under the root of an agent's keys; keep what is returned."""
    own, said = f"{root}/{LINK}", os.urandom(1 << 16)

    def answer(query: zenoh.Query) -> None:
        asked = query.parameters.get(BYTES) or "0"
        count = min(int(asked), MOST_BYTES) if asked.isascii() and asked.isdigit() and len(asked) < 12 else 0
        query.reply(own, (said * (count // len(said) + 1))[:count])
        query.drop()

    return session.declare_queryable(own, answer)


def measure_link(session: zenoh.Session, rig: str, kind: str, instance: str) -> Link | None:
    """What lies between here and an agent; None where it gives no answer."""
    key, said = f"{key_root(rig, instance, kind)}/{LINK}", os.urandom(FRAME_BYTES)
    short: list[float] = []
    for _ in range(ROUND_TRIPS):
        took_s = _trip_s(session, key, 1)
        if took_s is None:
            return None
        short.append(took_s)
    latency_s = float(np.median(short))
    from_there = throughput(lambda count: _trip_s(session, key, count), latency_s)
    there = throughput(lambda count: _trip_s(session, key, 1, said[:count]), latency_s)
    return Link(latency_s * 1e3, float(np.percentile(short, 99)) * 1e3, from_there, there)


def throughput(trip_s: Callable[[int], float | None], latency_s: float) -> float:
    """Bytes that pass in a second.

    `trip_s` tells how long a round trip with so many bytes took, None where it was waited for in vain; `latency_s` is
    what one without any takes.
    """
    count, taken_s = LEAST_BYTES, list[float]()
    while len(taken_s) < FRAMES and sum(taken_s) < MEASURED_S:
        took_s = trip_s(count)
        if took_s is None:
            return count / LINK_WAIT_S
        taken_s.append(took_s)
        # one that was held up by something else tells nothing
        if count < FRAME_BYTES and len(taken_s) == TRIED and np.median(taken_s) - latency_s < LONG_ENOUGH_S:
            count, taken_s = min(GROWTH * count, FRAME_BYTES), []
    # no faster than what a clock can tell
    return count / max(float(np.median(taken_s)) - latency_s, 1e-6)


def _trip_s(session: zenoh.Session, key: str, asked: int, said: bytes = b"") -> float | None:
    """Seconds that a round trip took, None where its answer did not come."""
    began_s = monotonic_s()
    blocks = zenoh.CongestionControl.BLOCK
    selector = f"{key}?{BYTES}={asked}"
    replies = session.get(selector, payload=said, congestion_control=blocks, timeout=LINK_WAIT_S)
    came = sum(len(reply.ok.payload) for reply in replies if reply.ok is not None)
    return monotonic_s() - began_s if came == asked else None
