"""One at the switch who hears everything, and notes when it came by a clock that nobody sets."""

import threading
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from agents.diagnostics.status.health_watch import HealthWatch
from agents.operator.operator import SENDER
from schemas.codec import decode
from schemas.messages import GraspGoal, LogLevel, Outcome, Policy
from schemas.topics import (
    COMMANDS,
    EXECUTION,
    GOAL,
    HEALTH,
    JUDGEMENT,
    LOG,
    PLAN,
    ROBOT_STATE,
    THREAD,
    Delivery,
    Topic,
)
from shared.clock import monotonic_s
from shared.runtime.commands import new_header
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped
from tests.rigs.faults.rig import ARM

HEARD = (HEALTH, LOG, COMMANDS, THREAD, PLAN, EXECUTION, JUDGEMENT, ROBOT_STATE)
GRAVE = (LogLevel.WARNING, LogLevel.ERROR)
PRESENT_S, ASK_S = 0.5, 0.25
PLACES = (0.5, 0.4, 0.6, 0.3, 0.7)


@dataclass
class Heard:
    """A message, and when it came."""

    at_s: float
    tapped: Tapped
    _message: Any = None

    @property
    def message(self) -> Any:
        """The message itself, decoded once."""
        if self._message is None:
            self._message = decode(self.tapped.topic.message, self.tapped.payload)
        return self._message


@dataclass
class Observer:
    """Everything that was heard, by topic, in the order in which it came."""

    connection: Connection
    _heard: defaultdict[str, list[Heard]] = field(default_factory=lambda: defaultdict(list))
    _told: list[tuple[float, str]] = field(default_factory=list[tuple[float, str]])
    _asked: int = 0
    _next_s: float = 0.0

    def __post_init__(self) -> None:
        self._watch, self._restarts = HealthWatch(self.connection), defaultdict[str, int](int)
        self.connection.listen(HEARD, self._take, self._missed)
        self._closed = threading.Event()
        self._asking = threading.Thread(target=self._ask_who_is_there, name="present", daemon=True)
        self._asking.start()

    def close(self) -> None:
        """Ask nobody any more."""
        self._closed.set()
        self._asking.join()

    def _ask_who_is_there(self) -> None:
        while not self._closed.wait(PRESENT_S):
            self._watch.note_present(self.connection.present())

    def _take(self, tapped: Tapped) -> None:
        self._heard[str(tapped.topic)].append(Heard(monotonic_s(), tapped))

    def _missed(self, topic: Topic, count: int) -> None:
        self.note(f"{count} messages of {topic} were lost on the way here")

    def messages(self, topic: Topic, since_s: float = 0.0) -> Iterator[Heard]:
        """Those of a topic that came since."""
        heard = self._heard[str(topic)]
        first = len(heard)
        while first > 0 and heard[first - 1].at_s >= since_s:
            first -= 1
        return iter(heard[first:])

    def look(self) -> None:
        """Note what those who watch health would be told now."""
        for sentence in self._watch.changes():
            self.note(sentence)
        for fare in self._watch.fares():
            before, self._restarts[fare.name] = self._restarts[fare.name], fare.restarts
            if fare.restarts > before:
                self.note(f"{fare.name}: was started again")

    def told(self, since_s: float) -> list[tuple[float, str]]:
        """What people were told since: of agents' health, and in their logs."""
        logged = [
            (heard.at_s, f"{heard.message.agent}: {heard.message.text}")
            for heard in self.messages(LOG, since_s)
            if heard.message.level in GRAVE
        ]
        return sorted([said for said in self._told if said[0] >= since_s] + logged)

    def ask(self) -> str | None:
        """Every now and then name a goal as an operator does who does not wait; its id, where one was named.

        The plan is heard as everything is, and a refusal is among what is told.
        """
        if monotonic_s() < self._next_s:
            return None
        self._next_s, self._asked = monotonic_s() + ASK_S, self._asked + 1
        place = PLACES[self._asked % len(PLACES)]
        goal = GraspGoal(new_header(SENDER), ARM, Policy.CAPTURE_SLIDE_GRASP, place, None, None)

        def answered() -> None:
            answer = self.connection.command(GOAL, goal)
            if answer.outcome is not Outcome.ACCEPTED:
                self.note(f"goal: {answer.reason}")

        threading.Thread(target=answered, daemon=True).start()
        return goal.header.id

    def note(self, sentence: str) -> None:
        """Have something be among what is told."""
        self._told.append((monotonic_s(), sentence))

    def lost_events(self) -> dict[str, int]:
        """By key, how many events lie between those that were heard, or before the first of a publisher's run."""
        numbers: defaultdict[tuple[str, int], list[int]] = defaultdict(list)
        for topic in HEARD:
            if topic.delivery is Delivery.EVENT:
                for heard in list(self._heard[str(topic)]):
                    if heard.tapped.beside is not None:
                        numbers[heard.tapped.key, heard.tapped.beside.epoch].append(heard.tapped.beside.sequence)
        lost: defaultdict[str, int] = defaultdict(int)
        for (name, _), came in numbers.items():
            lost[name] += max(came) + 1 - len(set(came))
        return {name: count for name, count in lost.items() if count}
