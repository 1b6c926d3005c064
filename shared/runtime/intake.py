"""What an agent hears: its inputs are subscribed to, counted from Zenoh's threads, and wait in the inbox."""

import logging
from collections.abc import Callable
from typing import Any

import zenoh

from schemas.messages import InputHealth
from schemas.topics import Delivery, Topic, key
from shared.clock import monotonic_s
from shared.runtime.accounts import InputAccount, RingLosses
from shared.runtime.agent import Agent, Input, only_remembers
from shared.runtime.attachment import Attachment, unpack
from shared.runtime.delivery import RouterLinks, ring_room, subscribe_unlooked
from shared.runtime.inbox import Arrival, Inbox
from shared.runtime.own_key import other_key
from shared.runtime.progress import Handled
from shared.runtime.replayed_time import AgentClock
from shared.runtime.unlooked import Unlooked


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
