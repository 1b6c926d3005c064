"""What an agent hears: inputs are subscribed to, commands answered, and both wait in the inbox for the agent's loop.

Filling the inbox never waits, so Zenoh's threads are never held up by a slow agent. Events, states and commands are
handed out first and in order; then, of each key of a *latest* topic, the newest message alone. What an agent only
remembers waits aside until the agent acts on something else.

A command that stops an arm stops it here and now, from Zenoh's thread, and goes before all others in the loop, which
answers it. Where many of those wait already, nothing more could follow from another one: it is answered at once.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

from schemas.codec import encode
from schemas.messages import CommandAnswer, InputHealth, Outcome
from schemas.topics import Delivery, Topic, key
from shared.clock import monotonic_s
from shared.runtime.accounts import InputAccount
from shared.runtime.agent import Agent, Input, only_remembers
from shared.runtime.attachment import Attachment, beside_of, encoding_of, other_key
from shared.runtime.clocks import AgentClock
from shared.runtime.commands import STATUS, Answered, accepted, id_of, stops_unread
from shared.runtime.delivery import Rows, as_told, subscribe
from shared.runtime.facts import Handled


class Arrival(NamedTuple):
    """A message as it came, not yet decoded.

    Fields:
        payload: gives the bytes; of what is dropped, they are never copied.
        beside: what travelled with it; None where nothing that can be read did.
        answer: sends the answer of a command; None for anything else.
        named: the key that it names as its own, where it came under another; it is to be refused.
    """

    topic: Topic
    key: str
    payload: Callable[[], bytes]
    beside: Attachment | None = None
    answer: Callable[[CommandAnswer], None] | None = None
    named: str = ""


class Inbox:
    """Arrivals between the threads that receive and the loop that steps."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # a bare lock rings in half the time of a condition; it is held, but for the moment of a ring
        self._bell, self._waits = threading.Lock(), False
        self._bell.acquire()
        self._first: deque[Arrival] = deque()
        self._queue: deque[Arrival] = deque()
        self._newest: dict[str, Arrival] = {}
        self._remembered: dict[str, Arrival] = {}
        self._woken = False
        self._dropped: dict[Any, int] = {}

    def put(self, arrival: Arrival) -> None:
        """Add what must not be lost."""
        with self._lock:
            self._queue.append(arrival)
            self._ring()

    def put_first(self, arrival: Arrival, most: int) -> bool:
        """Add what goes before all else; False, and nothing is added, where so many of it wait already."""
        with self._lock:
            if len(self._first) >= most:
                return False
            self._first.append(arrival)
            self._ring()
            return True

    def put_newest(self, arrival: Arrival) -> None:
        """Add what replaces an older arrival of its key that nobody has looked at; that one counts as dropped."""
        with self._lock:
            if self._newest.pop(arrival.key, None) is not None:
                self._dropped[str(arrival.topic)] = self._dropped.get(str(arrival.topic), 0) + 1
            self._newest[arrival.key] = arrival
            self._ring()

    def remember(self, arrival: Arrival) -> None:
        """Keep what nobody acts on, in place of an older arrival of its key; no `take` wakes up for it."""
        with self._lock:
            self._remembered[arrival.key] = arrival

    def remembered(self) -> list[Arrival]:
        """What was to be remembered since the last call, the newest of each key."""
        if not self._remembered:
            return []
        with self._lock:
            kept, self._remembered = self._remembered, {}
        return list(kept.values())

    def take(self, timeout_s: float) -> Arrival | None:
        """The next arrival; None where none came in time, or where somebody called `wake`. One thread takes."""
        with self._lock:
            if self._first or self._queue or self._newest or self._woken:
                return self._next()
            self._waits = True
        self._bell.acquire(timeout=timeout_s)
        with self._lock:
            if not self._waits:
                # rung, if only just after it was waited for
                self._bell.acquire(blocking=False)
            self._waits = False
            return self._next()

    def wake(self) -> None:
        """Let a waiting `take` return at once."""
        with self._lock:
            self._woken = True
            self._ring()

    def _ring(self) -> None:
        if self._waits:
            self._waits = False
            self._bell.release()

    def _next(self) -> Arrival | None:
        if self._first:
            return self._first.popleft()
        if self._woken:
            self._woken = False
            return None
        if self._queue:
            return self._queue.popleft()
        if self._newest:
            return self._newest.pop(next(iter(self._newest)))
        return None

    def dropped(self, topic: Topic) -> int:
        """How many arrivals of a topic were replaced before anybody looked at them."""
        with self._lock:
            return self._dropped.get(str(topic), 0)


class Intake:
    """The inputs of one agent and what became of their messages.

    Fields:
        inbox: what has arrived and has not been looked at.
        handled: how far each key has been worked off.
    """

    def __init__(self, agent: Agent, clock: AgentClock, log: logging.Logger) -> None:
        self.inbox, self.handled = Inbox(), Handled()
        self._agent, self._clock, self._log = agent, clock, log
        self._accounts = {str(i.topic): InputAccount(str(i.topic)) for i in agent.inputs}

    def listen(self, session: zenoh.Session, rig: str, otherwise: Rows = ()) -> list[Any]:
        """Subscribe to every input; what is returned is undeclared in the end."""
        return [
            subscribe(session, key(rig, wanted.topic, wanted.instance), as_told(wanted.topic, otherwise), *ways)
            for wanted, ways in ((wanted, self._ways(wanted)) for wanted in self._agent.inputs)
        ]

    def account(self, topic: Topic) -> InputAccount:
        """The counts of one input."""
        return self._accounts[str(topic)]

    def looked_at(self, topic: Topic, beside: Attachment) -> None:
        """Count a message that is looked at."""
        self.account(topic).looked_at(beside, self._clock.now_ns(), monotonic_s())

    def health(self, now_s: float) -> tuple[InputHealth, ...]:
        """How every input does."""
        return tuple(self.account(i.topic).health(self.inbox.dropped(i.topic), now_s) for i in self._agent.inputs)

    def _ways(self, wanted: Input) -> tuple[Callable[[zenoh.Sample], None], Callable[[int], None], Any]:
        """What is done with a message of an input, with the number of those that were lost, and with a wrong key."""
        topic, account = wanted.topic, self.account(wanted.topic)
        put = self.inbox.put_newest if topic.delivery is Delivery.LATEST else self.inbox.put

        def receive(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr)
            beside = beside_of(sample, key)
            arrival = Arrival(topic, key, sample.payload.to_bytes, beside)
            if beside is not None:
                account.came(key, beside)
                if only_remembers(self._agent, wanted):
                    self.inbox.remember(arrival)
                    self.looked_at(topic, beside)
                    self.handled.note(key, beside.epoch, beside.sequence)
                    return
            put(arrival)

        def missed(count: int) -> None:
            account.missed += count
            self._log.error("%d messages of %s were lost", count, topic)

        def refused(key: str, named: str) -> None:
            self.inbox.put(Arrival(topic, key, bytes, named=named))

        return receive, missed, refused


STOPS_WAITING = 8
"""Commands that stop, of several people say, of which each is stepped and written down by itself."""
LOG = logging.getLogger("suturegrasp.commands")


def taking(
    topic: Topic, inbox: Inbox, answered: Answered, halt: Callable[[], None] = lambda: None
) -> Callable[[zenoh.Query], None]:
    """What a queryable of a command does with a query; it is called from Zenoh's threads, one query after another.

    `halt` stops what the agent moves at once.
    """

    def take(query: zenoh.Query) -> None:
        key = str(query.key_expr)

        def answer(reply: CommandAnswer) -> None:
            query.reply(query.key_expr, encode(reply), encoding=encoding_of(CommandAnswer, key))
            query.drop()

        asked = query.parameters.get(STATUS)
        if asked:
            unknown = CommandAnswer(asked, Outcome.UNKNOWN, "unknown_id", "no command of this id was carried out here")
            answer(answered.recall(asked) or unknown)
            return
        payload = query.payload.to_bytes() if query.payload is not None else b""
        arrival = Arrival(topic, key, lambda: payload, None, answer, other_key(query.encoding, key))
        if not stops_unread(topic, payload):
            inbox.put(arrival)
            return
        try:
            halt()
        except Exception:
            LOG.exception("%s could not be halted at once; its loop holds it next", key)
        if arrival.named:
            # meant for another arm, which its sender has to tell again; this one stands too, which harms nobody
            inbox.put(arrival)
        elif not inbox.put_first(arrival, STOPS_WAITING):
            if topic.good_when_late:
                # those that wait hold as well as it would
                answer(accepted(id_of(topic.message, payload)))
            else:
                inbox.put(arrival)

    return take
