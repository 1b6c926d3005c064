"""What an agent publishes under its key root, with the list of what each output was made from.

A list holds, in the order in which they were fed, every message and every tick since the output before, and the newest
of each key of which nothing else counts; a replay feeds it again. An agent of which more counts than the newest of each
input also names its output before, as the state that it went on from: so the lists of a run are a chain, and one that
was lost is noticed. An agent whose output holds all of that state (`goes_on_from`) names it too, and a replay can go on
from there. What is still worked on when its step is over is published under the list of that step.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from schemas.messages import Consumed
from schemas.topics import ANY_AGENT, MAIN, Topic, key, key_root
from shared.clock import monotonic_s
from shared.runtime.accounts import OutputAccount
from shared.runtime.agent import Agent, Later
from shared.runtime.attachment import Attachment, pack
from shared.runtime.clocks import AgentClock
from shared.runtime.delivery import Rows, as_told, declare_publisher, payload_of
from shared.runtime.facts import Handled
from shared.runtime.session import Session

TICK, OMITTED = "tick", "omitted"
"""The last parts of keys under which nothing is published. A tick's number is its time in nanoseconds; the number under
`omitted` says how many entries a list left out."""
MOST_LISTED = 1000
"""Entries of one list. An agent that is fed and says nothing leaves out the oldest, and a replay knows."""


def adds_up(agent: Agent) -> bool:
    """Whether what an agent says follows from more than the newest of each input: from all that it was ever fed.

    Of one that goes on from its last output, all that counts of earlier inputs lies there.
    """
    if agent.goes_on_from is not None:
        return False
    return agent.tick_hz is not None or not all(i.only_newest_counts for i in agent.inputs)


def is_tick(key: str) -> bool:
    """Whether a list's key stands for a tick of the agent's own clock, which is in no recording but in the list."""
    return key.endswith(f"/{TICK}")


class Fed:
    """The list of one run of one agent."""

    def __init__(self, agent: Agent, rig: str, epoch: int) -> None:
        self._root, self._epoch = key_root(rig, agent.instance, agent.kind), epoch
        self._names_output = adds_up(agent) or agent.goes_on_from is not None
        self._idle_ticks_count = not agent.only_newest_tick_counts
        self._newest_only: set[str] = set()
        self._entries: list[Consumed] = []
        self._omitted = 0

    def message(self, key: str, epoch: int, sequence: int, only_newest_counts: bool = False) -> None:
        """Add a message that is about to be fed."""
        if only_newest_counts:
            self._newest_only.add(key)
            self._remove(key)
        self._add(Consumed(key, epoch, sequence))

    def tick(self, now_ns: int) -> None:
        """Add a tick that is about to be fed."""
        if not self._idle_ticks_count:
            self._remove(f"{self._root}/{TICK}")
        self._add(Consumed(f"{self._root}/{TICK}", self._epoch, now_ns))

    def listed(self) -> tuple[Consumed, ...]:
        """What an output that follows now was made from."""
        omitted = [Consumed(f"{self._root}/{OMITTED}", self._epoch, self._omitted)] if self._omitted else []
        return (*omitted, *self._entries)

    def published(self, key: str, sequence: int) -> None:
        """Begin the next list, after an output that carries this one."""
        self._entries = [c for c in self._entries if c.key in self._newest_only]
        self._omitted = 0
        if self._names_output:
            self._entries.append(Consumed(key, self._epoch, sequence))

    def _remove(self, key: str) -> None:
        self._entries = [c for c in self._entries if c.key != key]

    def _add(self, entry: Consumed) -> None:
        self._entries.append(entry)
        if len(self._entries) > MOST_LISTED:
            oldest = next((i for i, c in enumerate(self._entries) if c.key not in self._newest_only), 0)
            del self._entries[oldest]
            self._omitted += 1


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
        clock: AgentClock,
        otherwise: Rows = (),
    ) -> None:
        self.epoch = int.from_bytes(os.urandom(7), "big")
        self._session, self._rig, self._clock, self._otherwise = session, rig, clock, otherwise
        self._kind, self._instance = own
        self._accounts: dict[str, OutputAccount] = {}
        self._publishers: dict[str, Any] = {}
        # log records come from other threads too, and must not share a sequence number
        self._publishing = threading.Lock()

    def declare(self, topic: Topic) -> None:
        """Have a topic ready to be published."""
        row = as_told(topic, self._otherwise)
        self._publishers[str(topic)] = declare_publisher(self._session, self.key(topic), row)
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
