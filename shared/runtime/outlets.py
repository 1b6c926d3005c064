"""What an agent publishes under its key root: a publisher for each topic, and the numbers of what went out."""

import os
import threading
from typing import Any

from schemas.topics import ANY_AGENT, MAIN, Topic, key
from shared.clock import monotonic_s
from shared.runtime.accounts import OutputAccount
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import RouterLinks, payload_of
from shared.runtime.replayed_time import AgentClock
from shared.runtime.session import Session


class Outlets:
    """The publishers of one agent.

    Fields:
        epoch: of this process, told beside every message, so that a restart is no loss.
    """

    def __init__(
        self,
        session: Session,
        rig: str,
        own: tuple[str, str],
        links: RouterLinks,
        clock: AgentClock,
    ) -> None:
        self.epoch = int.from_bytes(os.urandom(7), "big")
        self._session, self._rig, self._links, self._clock = session, rig, links, clock
        self._kind, self._instance = own
        self._accounts: dict[str, OutputAccount] = {}
        self._publishers: dict[str, Any] = {}
        # log records come from other threads too, and must not share a sequence number
        self._publishing = threading.Lock()

    def declare(self, topic: Topic) -> None:
        """Have a topic ready to be published."""
        self._publishers[str(topic)] = self._links.publisher(self._session, self.key(topic), topic)
        self._accounts[str(topic)] = OutputAccount(str(topic))

    def key(self, topic: Topic) -> str:
        """The key under which this agent publishes a topic."""
        instance = self._instance if topic.per_arm or topic.agent == ANY_AGENT else MAIN
        return key(self._rig, topic, instance, self._kind)

    def account(self, topic: Topic) -> OutputAccount:
        """What went out of a topic."""
        return self._accounts[str(topic)]

    def publish(self, topic: Topic, message: Any, step_ms: float = 0.0) -> int:
        """Publish a message; its number in the sequence of its key.

        Raises:
            MessageError: where it is none that may travel; then nothing is published and no number used.
        """
        account, payload = self.account(topic), payload_of(topic, message)
        with self._publishing:
            beside = Attachment(self.epoch, account.published, self._clock.now_ns(), step_ms)
            account.count(monotonic_s())
            self._publishers[str(topic)].put(payload, attachment=pack(beside))
            return beside.sequence

    def undeclare(self) -> None:
        """End all publishers."""
        for publisher in self._publishers.values():
            publisher.undeclare()
