"""Agents in step, without router and clocks: every message reaches whoever listens before the next tick.

What comes of it is a recording like those of live sessions, and the same every time.
"""

import dataclasses
from collections import Counter, deque

from schemas.codec import decode, encode, encoding_name
from schemas.messages import CommandAnswer, CommandRecord
from schemas.topics import COMMANDS, MAIN, key, topic_of
from shared.recording.mcap_file import Entry
from shared.runtime.agent import Command, Output, Received, Tick
from shared.runtime.fed import Fed, state_topic

RIG = "golden"
STEP_NS = 10_000_000
BEGAN_NS = 1_767_225_600_000_000_000
"""The first moment of 2026."""


class Seat:
    """One agent, what it was fed since its last output, and when it ticks."""

    def __init__(self, agent, epoch):
        self.agent, self.epoch, self.fed = agent, epoch, Fed(agent, RIG, epoch)
        self.due_ns = BEGAN_NS

    def listens(self, topic, instance):
        return [i for i in self.agent.inputs if i.topic is topic and i.instance in ("*", instance)]


class Lockstep:
    """A session; `entries` is what a recorder would have written."""

    def __init__(self, *agents):
        self.seats = [Seat(agent, epoch) for epoch, agent in enumerate(agents, start=1)]
        self.entries = []
        self.now_ns = BEGAN_NS
        self._numbers = Counter()
        self._waiting = deque()

    def run(self, seconds):
        """Let time pass."""
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.now_ns += STEP_NS
            for seat in self.seats:
                if seat.agent.tick_hz is not None and self.now_ns >= seat.due_ns:
                    seat.due_ns += round(1e9 / seat.agent.tick_hz)
                    seat.fed.tick(self.now_ns)
                    self._step(seat, Tick(self.now_ns))

    def command(self, topic, message):
        """Have a command carried out; its answer."""
        (seat,) = [seat for seat in self.seats if topic in seat.agent.commands]
        name = key(RIG, COMMANDS, seat.agent.instance, seat.agent.kind)
        seat.fed.message(name, seat.epoch, self._numbers[name])
        replies = list(seat.agent.step(Command(topic, seat.agent.instance, message, self.now_ns)))
        (answer,) = [reply for reply in replies if isinstance(reply, CommandAnswer)]
        self._publish(
            seat, name, CommandRecord(str(topic), encoding_name(type(message)), encode(message), self.now_ns, answer)
        )
        self._publish_all(seat, [reply for reply in replies if isinstance(reply, Output)])
        self._deliver()
        return answer

    def _step(self, seat, arrived):
        self._publish_all(seat, list(seat.agent.step(arrived)))
        self._deliver()

    def _publish_all(self, seat, outputs):
        listed, last = seat.fed.listed(), None
        for output in outputs:
            instance = seat.agent.instance if output.topic.per_arm else MAIN
            name = key(RIG, output.topic, instance)
            place = name, self._publish(seat, name, dataclasses.replace(output.message, consumed=listed))
            last = place if output.topic is (state_topic(seat.agent) or output.topic) else last
        if last is not None:
            seat.fed.published(*last)

    def _publish(self, seat, name, message):
        number = self._numbers[name]
        self._numbers[name] += 1
        entry = Entry(name, seat.epoch, number, encode(message), self.now_ns, self.now_ns)
        self.entries.append(entry)
        self._waiting.append(entry)
        return number

    def _deliver(self):
        while self._waiting:
            sent = self._waiting.popleft()
            topic = topic_of(sent.key)
            for seat in self.seats:
                for wanted in seat.listens(topic, sent.key.split("/")[3]):
                    seat.fed.message(sent.key, sent.epoch, sent.sequence, wanted.only_newest_counts)
                    # as it would arrive: arrays that lie otherwise in memory are added up otherwise
                    message = decode(topic.message, sent.payload)
                    self._step(seat, Received(topic, sent.key, sent.sequence, message))
