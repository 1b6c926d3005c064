"""What is no agent of the dataflow, such as the recorder, tells of itself as agents do: that it is there, its health
once a second, its log, and where it is asked its host's clock, its facts and what lies between."""

import logging
import os
import socket
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from itertools import count
from typing import Any

import zenoh

import schemas
from schemas.codec import encode
from schemas.messages import AgentHealth, LogRecord
from schemas.topics import HEALTH, LOG, Topic, key, key_root
from shared.clock import monotonic_s, now_ns
from shared.runtime.attachment import Attachment, pack
from shared.runtime.clocks import answer_clock
from shared.runtime.delivery import declare_publisher
from shared.runtime.facts import Surroundings, answer_facts, facts_of, realtime_priority
from shared.runtime.link import answer_link
from shared.runtime.log_topic import LogTopic
from shared.runtime.router_watch import RouterWatch
from shared.runtime.usage import ProcessorShare, resident_bytes

PERIOD_S = 1.0


@contextmanager
def reporting(
    session: zenoh.Session,
    rig: str,
    kind: str,
    instance: str,
    logger: logging.Logger,
    fault: Callable[[], str],
    config_hash: str = "",
    around: Surroundings | None = None,
) -> Generator[None]:
    """Tell all that for as long as it lasts; `fault` says what is wrong at the moment, or is empty."""
    tell_health, tell_log = (_Teller(session, rig, topic, kind, instance) for topic in (HEALTH, LOG))
    log_topic = LogTopic(kind, instance, tell_log)
    root, surroundings, granted = key_root(rig, instance, kind), around or Surroundings(), realtime_priority()
    kept = [
        session.liveliness().declare_token(root),
        answer_clock(session, rig, kind, instance),
        answer_facts(session, root, lambda: facts_of(session, kind, instance, config_hash, surroundings, granted)),
        answer_link(session, root),
        RouterWatch(session, logger.warning),
    ]
    logger.addHandler(log_topic)
    health = _Health(kind, instance, fault, config_hash)
    stopped = threading.Event()

    def repeat() -> None:
        while not stopped.is_set():
            tell_health(health.now())
            stopped.wait(PERIOD_S)

    thread = threading.Thread(target=repeat, name="health", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join()
        tell_health(health.now())
        logger.removeHandler(log_topic)
        for declared in (*kept, tell_health, tell_log):
            declared.undeclare()


class _Teller:
    """Publishes messages of a topic, numbered, whichever thread they come from."""

    def __init__(self, session: zenoh.Session, rig: str, topic: Topic, kind: str, instance: str) -> None:
        self._publisher = declare_publisher(session, key(rig, topic, instance, kind), topic)
        self._epoch, self._numbers, self._lock = int.from_bytes(os.urandom(7), "big"), count(), threading.Lock()

    def __call__(self, message: AgentHealth | LogRecord) -> None:
        with self._lock:
            beside = Attachment(self._epoch, next(self._numbers), now_ns(), 0.0)
            self._publisher.put(encode(message), attachment=pack(beside))

    def undeclare(self) -> None:
        self._publisher.undeclare()


class _Health:
    """How a process fares that takes no steps."""

    def __init__(self, kind: str, instance: str, fault: Callable[[], str], config_hash: str) -> None:
        self._fixed: dict[str, Any] = {"agent": kind, "instance": instance, "host": socket.gethostname()}
        self._fixed |= {"version": schemas.__version__, "config_hash": config_hash}
        self._fault, self._began_s, self._beats, self._processor = fault, monotonic_s(), count(1), ProcessorShare()

    def now(self) -> AgentHealth:
        return AgentHealth(
            **self._fixed,
            at_ns=now_ns(),
            uptime_s=monotonic_s() - self._began_s,
            heartbeat=next(self._beats),
            step_ms_p50=None,
            step_ms_p99=None,
            inputs=(),
            outputs=(),
            fault=self._fault(),
            processor_share=self._processor.since_last(),
            resident_bytes=resident_bytes(),
        )
