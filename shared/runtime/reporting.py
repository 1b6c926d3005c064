"""What is no agent of the dataflow, such as the recorder, tells of itself as agents do: that it is there, its health
once a second, its log, and where it is asked its host's clock, its facts and what lies between."""

import contextlib
import logging
import socket
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from itertools import count
from typing import Any

import zenoh

import schemas
from schemas.messages import AgentHealth, InputHealth, LogLevel, LogRecord
from schemas.topics import HEALTH, LOG, MAIN, key_root
from shared.clock import monotonic_s, now_ns
from shared.runtime.accounts import ProcessorShare, resident_bytes
from shared.runtime.clocks import answer_clock
from shared.runtime.delivery import RouterLinks
from shared.runtime.facts import Surroundings, answer_facts, facts_of, realtime_priority
from shared.runtime.link import answer_link
from shared.runtime.outlets import Outlets
from shared.runtime.replayed_time import AgentClock
from shared.runtime.session import RouterWatch, Session

LEVELS = ((logging.ERROR, LogLevel.ERROR), (logging.WARNING, LogLevel.WARNING), (logging.INFO, LogLevel.INFO))


class LogTopic(logging.Handler):
    """Hands each record of a logger over as a message."""

    def __init__(self, agent: str, instance: str, publish: Callable[[LogRecord], object]) -> None:
        super().__init__()
        self._agent, self._instance, self._publish = agent, instance, publish

    def emit(self, record: logging.LogRecord) -> None:
        """Publish one record; one that cannot be published is only seen on the console."""
        level = next((ours for theirs, ours in LEVELS if record.levelno >= theirs), LogLevel.DEBUG)
        # names of files may hold bytes that are no text, and messages hold text alone
        text = self.format(record).encode(errors="replace").decode()
        with contextlib.suppress(Exception):
            # whoever says something goes on, whether or not it travels: an arm may have to be held next
            self._publish(LogRecord(round(record.created * 1e9), self._agent, self._instance, level, text))

    def await_quiet(self) -> None:
        """Return once no record is being published any more; for when the handler has been removed."""
        self.acquire()
        self.release()


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
    links: RouterLinks | None = None,
    heard: Callable[[], tuple[InputHealth, ...]] = tuple,
) -> Generator[None]:
    """Tell all that for as long as it lasts; `fault` says what is wrong at the moment, or is empty.

    `heard` tells of what it listens to.
    """
    out = Outlets(session, rig, (kind, instance), links or RouterLinks(), AgentClock())
    for topic in (HEALTH, LOG):
        out.declare(topic)
    log_topic = LogTopic(kind, instance, lambda record: out.publish(LOG, record))
    root, surroundings, granted = key_root(rig, instance, kind), around or Surroundings(), realtime_priority()
    kept = [
        session.liveliness().declare_token(root),
        answer_clock(session, rig, kind, instance),
        answer_facts(session, root, lambda: facts_of(session, kind, instance, config_hash, surroundings, granted)),
        answer_link(session, root),
        RouterWatch(session, logger.warning),
    ]
    logger.addHandler(log_topic)
    health = _Health(kind, instance, fault, heard, config_hash)
    stopped = threading.Event()

    def repeat() -> None:
        while not stopped.is_set():
            out.publish(HEALTH, health.now())
            stopped.wait(PERIOD_S)

    thread = threading.Thread(target=repeat, name="health", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join()
        out.publish(HEALTH, health.now())
        logger.removeHandler(log_topic)
        log_topic.await_quiet()
        for declared in (*kept, out):
            declared.undeclare()


class _Health:
    """How a process fares that takes no steps."""

    def __init__(
        self,
        kind: str,
        instance: str,
        fault: Callable[[], str],
        heard: Callable[[], tuple[InputHealth, ...]],
        config_hash: str,
    ) -> None:
        self._fixed: dict[str, Any] = {"agent": kind, "instance": instance, "host": socket.gethostname()}
        self._fixed |= {"version": schemas.__version__, "config_hash": config_hash}
        self._fault, self._heard = fault, heard
        self._began_s, self._beats, self._processor = monotonic_s(), count(1), ProcessorShare()

    def now(self) -> AgentHealth:
        return AgentHealth(
            **self._fixed,
            at_ns=now_ns(),
            uptime_s=monotonic_s() - self._began_s,
            heartbeat=next(self._beats),
            step_ms_p50=None,
            step_ms_p99=None,
            inputs=self._heard(),
            outputs=(),
            fault=self._fault(),
            processor_share=self._processor.since_last(),
            resident_bytes=resident_bytes(),
        )


@contextmanager
def logs_published(
    session: Session, rig: str, kind: str, logger: logging.Logger, links: RouterLinks | None = None
) -> Generator[None]:
    """Publish each record of a logger under the key root of `kind`, for as long as it is needed."""
    out = Outlets(session, rig, (kind, MAIN), links or RouterLinks(), AgentClock())
    out.declare(LOG)
    handler = LogTopic(kind, MAIN, lambda record: out.publish(LOG, record))
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        handler.await_quiet()
        out.undeclare()
