"""What becomes of messages that listeners hear who are no agents, told in their health as agents tell it of inputs."""

import logging
from dataclasses import dataclass

from schemas.messages import InputHealth
from schemas.topics import Topic
from shared.clock import monotonic_s, now_ns
from shared.runtime.accounts import InputAccount
from shared.runtime.attachment import Attachment
from shared.runtime.faults import LIKE_PER_LINE
from shared.runtime.own_key import why_refused

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
