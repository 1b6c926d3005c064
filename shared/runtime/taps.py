"""Listening to many topics, and telling how one fares, without being an agent of the dataflow: recorder, viewer, `up`.

Losses are counted per key from sequence numbers: a recording is complete, or says where it is not. What was refused is
told in the health of whoever listens, as agents tell it of inputs. Beside health once a second there are, as of agents,
presence, a log, and where it is asked the host's clock, facts and what lies between.
"""

import contextlib
import functools
import logging
import os
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import zenoh

from schemas.messages import InputHealth, LogLevel, LogRecord
from schemas.topics import ANY_AGENT, HEALTH, LOG, MAIN, Delivery, Topic, key, key_root
from shared.clock import monotonic_s, now_ns
from shared.runtime.accounts import LIKE_PER_LINE, InputAccount, Vitals
from shared.runtime.attachment import Attachment, beside_of, why_refused
from shared.runtime.clocks import AgentClock
from shared.runtime.delivery import Rows, as_told, subscribe
from shared.runtime.facts import (
    Handled,
    Surroundings,
    answer_clock,
    answer_facts,
    answer_link,
    answer_progress,
    facts_of,
    realtime_priority,
)
from shared.runtime.outlets import Outlets
from shared.runtime.session import RouterWatch, Session

LOGGER = logging.getLogger("suturegrasp.taps")


class TapAccounts:
    """What one process hears, as its health tells of it where any of it was refused."""

    def __init__(self) -> None:
        self._accounts: list[InputAccount] = []

    def of(self, topic: Topic) -> InputAccount:
        """A new account of a topic."""
        self._accounts.append(InputAccount(str(topic)))
        return self._accounts[-1]

    def health(self) -> tuple[InputHealth, ...]:
        """Of topics of which a message was refused; where several listen to one, as the one with most has it."""
        refused = sorted((one for one in self._accounts if one.refused), key=lambda one: one.refused)
        most = {one.topic: one for one in refused}
        return tuple(most[topic].health(0, monotonic_s()) for topic in sorted(most))


TAP = "tap"
"""In the place of an agent, where a listener that is none tells how far it has got."""


@dataclass(frozen=True)
class Tapped:
    """A message as it travelled, with what came beside it (None where a foreign publisher sent none)."""

    topic: Topic
    key: str
    payload: bytes
    beside: Attachment | None


def tap(
    session: zenoh.Session,
    rig: str,
    topics: tuple[Topic, ...],
    receive: Callable[[Tapped], None],
    missed: Callable[[Topic, int], None],
    otherwise: Rows = (),
    accounts: TapAccounts | None = None,
) -> list[Any]:
    """Have every message of these topics, of all instances, handed over; keep what is returned.

    `receive` and `missed` are called from other threads and must only put things away; `otherwise` are rows of the
    table as this rig has them, where it has them otherwise; `accounts` count what comes. Commands are no topic to
    listen to; they are recorded through `command`.
    """
    kept: list[Any] = []
    handled, selectors, counted = Handled(), list[str](), accounts or TapAccounts()
    for topic in topics:
        if topic.delivery is Delivery.COMMAND:
            continue
        selectors.append(key(rig, topic, "*", "*" if topic.agent == ANY_AGENT else topic.agent))
        account, row = counted.of(topic), as_told(topic, otherwise)
        hand_over, refuse = _receiver(topic, receive, handled, account), functools.partial(_refuse, account)
        kept.append(subscribe(session, selectors[-1], row, hand_over, functools.partial(missed, topic), refuse))
    kept.append(answer_progress(session, key_root(rig, os.urandom(7).hex(), TAP), selectors, handled))
    return kept


def _receiver(
    topic: Topic, receive: Callable[[Tapped], None], handled: Handled, account: InputAccount
) -> Callable[[zenoh.Sample], None]:
    def hand_over(sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        beside = beside_of(sample, key)
        receive(Tapped(topic, key, sample.payload.to_bytes(), beside))
        if beside is not None:
            account.came(key, beside)
            account.looked_at(beside, now_ns(), monotonic_s())
            handled.note(key, beside.epoch, beside.sequence)

    return hand_over


def _refuse(account: InputAccount, key: str, named: str) -> None:
    """Count a message that came under another key than its own, and say so now and then."""
    if account.refused % LIKE_PER_LINE == 0:
        LOGGER.warning("a message on %s was refused: %s", key, why_refused(named))
    account.refuse()


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


@contextmanager
def logs_published(
    session: Session, rig: str, kind: str, logger: logging.Logger, otherwise: Rows = (), instance: str = MAIN
) -> Generator[Outlets]:
    """Publish each record of a logger under the key root of a process, for as long as it is needed."""
    out = Outlets(session, rig, (kind, instance), AgentClock(), otherwise)
    out.declare(LOG)
    handler = LogTopic(kind, instance, lambda record: out.publish(LOG, record))
    logger.addHandler(handler)
    try:
        yield out
    finally:
        logger.removeHandler(handler)
        handler.await_quiet()
        out.undeclare()


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
    otherwise: Rows = (),
    heard: Callable[[], tuple[InputHealth, ...]] = tuple,
) -> Generator[None]:
    """Tell all that for as long as it lasts; `fault` says what is wrong at the moment, or is empty.

    `heard` tells of what it listens to.
    """
    root, surroundings, granted = key_root(rig, instance, kind), around or Surroundings(), realtime_priority()
    vitals, stopped = Vitals(kind, instance), threading.Event()
    with logs_published(session, rig, kind, logger, otherwise, instance) as out:
        out.declare(HEALTH)
        kept = [
            session.liveliness().declare_token(root),
            answer_clock(session, root),
            answer_facts(session, root, lambda: facts_of(session, kind, instance, config_hash, surroundings, granted)),
            answer_link(session, root),
            RouterWatch(session, logger.warning),
        ]

        def tell() -> None:
            vitals.heartbeat += 1
            out.publish(HEALTH, vitals.health(now_ns(), config_hash, fault(), heard()))

        def repeat() -> None:
            while not stopped.is_set():
                tell()
                stopped.wait(PERIOD_S)

        thread = threading.Thread(target=repeat, name="health", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stopped.set()
            thread.join()
            tell()
            for declared in kept:
                declared.undeclare()
