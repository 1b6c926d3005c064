"""Listening to many topics at once without being an agent of the dataflow: for the recorder, the viewer, `up`.

Losses are counted per key from sequence numbers: a recording is complete, or says where it is not. What was refused is
told in the health of whoever listens, as agents tell it of inputs.
"""

import logging
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import zenoh

from schemas.messages import InputHealth
from schemas.topics import ANY_AGENT, Delivery, Topic, key, key_root
from shared.clock import monotonic_s, now_ns
from shared.runtime.accounts import LIKE_PER_LINE, InputAccount
from shared.runtime.attachment import Attachment, unpack, why_refused
from shared.runtime.delivery import as_told, subscribe
from shared.runtime.progress import Handled, answer_progress

LOG = logging.getLogger("suturegrasp.taps")


@dataclass(frozen=True)
class TapAccount:
    """One topic as one listener hears it."""

    counts: InputAccount

    def arrived(self, key: str, beside: Attachment) -> None:
        """Count a message that was handed over."""
        self.counts.arrived(key, beside, now_ns(), monotonic_s())

    def refuse(self, key: str, named: str) -> None:
        """Count a message that came under another key than its own, and say so now and then."""
        if self.counts.refused % LIKE_PER_LINE == 0:
            LOG.warning("a message on %s was refused: %s", key, why_refused(named))
        self.counts.refuse(key, None)


class TapAccounts:
    """Those of all that one process listens to."""

    def __init__(self) -> None:
        self._accounts: list[TapAccount] = []

    def of(self, topic: Topic) -> TapAccount:
        """A new account of a topic."""
        account = TapAccount(InputAccount(str(topic)))
        self._accounts.append(account)
        return account

    def health(self) -> tuple[InputHealth, ...]:
        """Of topics of which a message was refused; where several listen to one, as one of them has it."""
        refused = [account.counts for account in self._accounts if account.counts.refused]
        most = {counts.topic: counts for counts in sorted(refused, key=lambda counts: counts.refused)}
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


@dataclass
class KeyLosses:
    """How many messages of one key came, and how many of its sequence did not."""

    received: int = 0
    lost: int = 0
    _last: tuple[int, int] | None = field(default=None, repr=False)

    def count(self, beside: Attachment) -> None:
        """Count a message by its sequence number; a publisher that restarted begins a new sequence."""
        if self._last is not None and self._last[0] == beside.epoch:
            self.lost += max(0, beside.sequence - self._last[1] - 1)
        self._last = (beside.epoch, beside.sequence)
        self.received += 1


def tap(
    session: zenoh.Session,
    rig: str,
    topics: tuple[Topic, ...],
    receive: Callable[[Tapped], None],
    missed: Callable[[Topic, int], None],
    otherwise: tuple[Topic, ...] = (),
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
        ways = _receiver(topic, receive, handled, account), lambda count, topic=topic: missed(topic, count)
        kept += subscribe(session, selectors[-1], row, *ways, refused=account.refuse)
    kept.append(answer_progress(session, key_root(rig, os.urandom(7).hex(), TAP), selectors, handled))
    return kept


def _receiver(
    topic: Topic, receive: Callable[[Tapped], None], handled: Handled, account: TapAccount
) -> Callable[[zenoh.Sample], None]:
    def hand_over(sample: zenoh.Sample) -> None:
        key, attachment = str(sample.key_expr), sample.attachment
        # one message for many keys has a number in the sequence of none of them
        beside = unpack(attachment.to_bytes()) if attachment is not None and "*" not in key else None
        receive(Tapped(topic, key, sample.payload.to_bytes(), beside))
        if beside is not None:
            account.arrived(key, beside)
            handled.note(key, beside.epoch, beside.sequence)

    return hand_over
