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
from shared.runtime.accounts import InputAccount, RingLosses
from shared.runtime.agent import Agent, Input, only_remembers
from shared.runtime.attachment import Attachment, encoding_of, other_key, unpack
from shared.runtime.clocks import AgentClock
from shared.runtime.commands import STATUS, Answered, accepted, id_of, stops_unread
from shared.runtime.delivery import RouterLinks, Unlooked, ring_room, subscribe_unlooked
from shared.runtime.progress import Handled


class Arrival(NamedTuple):
    """A message as it came, not yet decoded.

    Fields:
        payload: gives the bytes; of what is dropped, they are never copied.
        answer: sends the answer of a command; None for anything else.
        named: the key that it names as its own, where it came under another; it is to be refused.
    """

    topic: Topic
    key: str
    payload: Callable[[], bytes]
    attachment: bytes
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
        self.inbox, self.handled = Inbox(), Handled(self._look)
        self._unlooked: list[Unlooked] = []
        self._agent, self._inputs, self._clock, self._log = agent, agent.inputs, clock, log
        self._accounts = {str(i.topic): InputAccount(str(i.topic)) for i in agent.inputs}

    def listen(self, session: zenoh.Session, rig: str, links: RouterLinks) -> list[Any]:
        """Subscribe to every input; what is returned is undeclared in the end."""
        declared: list[Any] = []
        for wanted in self._inputs:
            selector, account = key(rig, wanted.topic, wanted.instance), self.account(wanted.topic)
            if wanted.topic.delivery is Delivery.LATEST:
                account.ring = RingLosses(ring_room(selector))
                if wanted.only_remembered:
                    declared += subscribe_unlooked(session, selector, self._waiting(wanted, account.ring))
                    continue
            ways = self._receiver(wanted), self._miss_counter(wanted.topic), account.ring, self._refuser(wanted.topic)
            declared += links.subscribe(session, selector, wanted.topic, *ways)
        return declared

    def account(self, topic: Topic) -> InputAccount:
        """The counts of one input."""
        return self._accounts[str(topic)]

    def arrived(self, topic: Topic, key: str, beside: Attachment) -> None:
        """Count a message that is looked at."""
        self.account(topic).arrived(key, beside, self._clock.now_ns(), monotonic_s())

    def remembered(self) -> list[Arrival]:
        """What was to be remembered since the last call, the newest of each key."""
        self._look()
        return self.inbox.remembered()

    def health(self, now_s: float) -> tuple[InputHealth, ...]:
        """How every input does."""
        self._look()
        return tuple(self.account(i.topic).health(self.inbox.dropped(i.topic), now_s) for i in self._inputs)

    def _receiver(self, wanted: Input) -> Callable[[zenoh.Sample], None]:
        latest = wanted.topic.delivery is Delivery.LATEST
        put = self.inbox.put_newest if latest else self.inbox.put

        def receive(sample: zenoh.Sample) -> None:
            key, beside = str(sample.key_expr), sample.attachment
            # one message for many keys is none of any of them
            attachment = beside.to_bytes() if beside is not None and "*" not in key else b""
            arrival = Arrival(wanted.topic, key, sample.payload.to_bytes, attachment)
            put(arrival)

        return receive

    def _look(self) -> None:
        """Look at all that waits."""
        for unlooked in self._unlooked:
            unlooked.look()

    def _waiting(self, wanted: Input, ring: RingLosses) -> Unlooked:
        """Where samples wait of what is only remembered."""
        refuse = self._refuser(wanted.topic)

        def look_at(sample: zenoh.Sample, came_s: float) -> None:
            key, beside = str(sample.key_expr), sample.attachment
            if named := other_key(sample.encoding, key):
                ring.taken(key, None)
                refuse(key, named)
                return
            attachment = beside.to_bytes() if beside is not None else b""
            ring.taken(key, unpack(attachment))
            # one message for many keys is none of any of them
            arrival = Arrival(wanted.topic, key, sample.payload.to_bytes, b"" if "*" in key else attachment)
            if only_remembers(self._agent, wanted):
                self._remember(arrival, came_s)
            else:
                self.inbox.put_newest(arrival)

        unlooked = Unlooked(look_at, ring.emptied, lambda: not only_remembers(self._agent, wanted))
        self._unlooked.append(unlooked)
        return unlooked

    def _remember(self, arrival: Arrival, came_s: float) -> None:
        """Keep what the agent only remembers; nothing follows from it until it acts on something else."""
        beside = unpack(arrival.attachment)
        if beside is None:
            # it will be refused, and must be counted even where another one takes its place
            self.inbox.put(arrival)
            return
        self.inbox.remember(arrival)
        came_ns = self._clock.now_ns() - round((monotonic_s() - came_s) * 1e9)
        self.account(arrival.topic).arrived(arrival.key, beside, came_ns, came_s)
        self.handled.note(arrival.key, beside.epoch, beside.sequence)

    def _refuser(self, topic: Topic) -> Callable[[str, str], None]:
        def refuse(key: str, named: str) -> None:
            self.inbox.put(Arrival(topic, key, bytes, b"", named=named))

        return refuse

    def _miss_counter(self, topic: Topic) -> Callable[[int], None]:
        account = self.account(topic)

        def count(missed: int) -> None:
            account.missed += missed
            self._log.error("%d messages of %s were lost", missed, topic)

        return count


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
        arrival = Arrival(topic, key, lambda: payload, b"", answer, other_key(query.encoding, key))
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
