"""What an agent publishes under its key root: a publisher for each topic, the numbers of what went out, and what is
still worked on, which is published under the list of what its step was made from."""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from schemas.messages import Consumed
from schemas.topics import ANY_AGENT, MAIN, Topic, key
from shared.clock import monotonic_s
from shared.runtime.accounts import OutputAccount
from shared.runtime.agent import Later
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import RouterLinks, payload_of
from shared.runtime.progress import Handled
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


@dataclass(frozen=True)
class Expected:
    """An output that is worked on.

    Fields:
        fed: what its step was made from.
        of: what its step was fed, as faults name it.
        began_s: when that began, on the monotonic clock.
    """

    later: Later
    fed: tuple[Consumed, ...]
    of: str
    began_s: float

    def took_ms(self) -> float:
        """How long ago its step began."""
        return 1e3 * (monotonic_s() - self.began_s)


class Coming:
    """Outputs in their order, and the messages that are not done with before they are published; for one thread."""

    def __init__(self, handled: Handled, wake: Callable[[], None]) -> None:
        """`wake` is called, from any thread, when one is there."""
        self._handled, self._wake = handled, wake
        self._expected: deque[Expected] = deque()
        self._done_then: list[Consumed] = []

    def add(self, later: Later, fed: tuple[Consumed, ...], of: str, step_ms: float) -> None:
        """Expect an output of a step that has taken so long until now."""
        self._expected.append(Expected(later, fed, of, monotonic_s() - 1e-3 * step_ms))
        later.coming.add_done_callback(lambda _: self._wake())

    def note(self, key: str, epoch: int, sequence: int) -> None:
        """A message is done with, as soon as all has been published that followed from it and from those before it."""
        self._done_then.append(Consumed(key, epoch, sequence))
        self._note_done()

    def there(self, wait: bool) -> Iterator[Expected]:
        """Each output that can be published now; all of them, where its user will wait for those that are worked on."""
        while self._expected and (wait or self._expected[0].later.coming.done()):
            yield self._expected[0]
            self._expected.popleft()
            self._note_done()

    def _note_done(self) -> None:
        if not self._expected:
            for done in self._done_then:
                self._handled.note(done.key, done.epoch, done.sequence)
            self._done_then.clear()
