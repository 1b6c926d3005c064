"""Plays a recording: sends each message when its moment has come, or as fast as consumers take it."""

import threading
from array import array
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from agents.replay.contents import PastCommand
from agents.replay.controls import Controls
from agents.replay.flow import Flow
from agents.replay.items import Item, Message, ReadAhead
from agents.replay.spacing import Spacing, spacing_errors_ms, spacing_of
from agents.replay.timeline import Timeline
from schemas.messages import CommandAnswer
from schemas.topics import Topic
from shared.clock import monotonic_s

TELL_PERIOD_S = 0.05
"""How often the replay's time is told; in between it goes on by itself."""
LOOK_S = 0.1
"""How long nobody looks whether the replay is to be held or stopped."""
FILL_S = 2.0
LEAD_IN_S, LEAD_OUT_S = 0.5, 0.7
"""For agents to take over the replay's time, and for consumers to ask for events that they missed."""


class Outlet(Protocol):
    """Where a replay's messages go."""

    def publish(self, name: str, payload: bytes, published_ns: int) -> int: ...
    def tell_time(self, replayed_ns: int, rate: float) -> None: ...
    def send(self, topic: Topic, instance: str, message: Any) -> CommandAnswer: ...


@dataclass
class Played:
    """What was sent, and when.

    Fields:
        sent: messages by key.
        behind_s: how late the latest one was.
        answers: to the commands, with their topics.
    """

    sent: dict[str, int] = field(default_factory=dict[str, int])
    behind_s: float = 0.0
    answers: list[tuple[Topic, CommandAnswer]] = field(default_factory=list[tuple[Topic, CommandAnswer]])
    _sent_s: "array[float]" = field(default_factory=lambda: array("d"), repr=False)
    _recorded_ns: "array[int]" = field(default_factory=lambda: array("q"), repr=False)
    _run: "array[int]" = field(default_factory=lambda: array("q"), repr=False)
    _runs: dict[tuple[str, int], int] = field(default_factory=dict[tuple[str, int], int], repr=False)

    def note(self, message: Message, at_s: float, stretch: int) -> None:
        """Count a message that was sent; between two stretches the spacing means nothing."""
        self.sent[message.key] = self.sent.get(message.key, 0) + 1
        self._sent_s.append(at_s)
        self._recorded_ns.append(message.at_ns)
        self._run.append(self._runs.setdefault((message.key, stretch), len(self._runs)))

    def spacing(self, rate: float) -> Spacing | None:
        """How well the spacing was kept; None where nothing can be said."""
        run = np.array(self._run, dtype=np.int64)
        order = np.argsort(run, kind="stable")
        sent_s, recorded_ns = np.array(self._sent_s, dtype=np.float64), np.array(self._recorded_ns, dtype=np.int64)
        return spacing_of(spacing_errors_ms(sent_s[order], recorded_ns[order], run[order], rate))


class Player:
    """Plays, until the end or until told to stop."""

    def __init__(self, outlet: Outlet, rate: float, controls: Controls, flow: Flow | None = None) -> None:
        """At a rate, or as fast as a flow of consumers allows."""
        self.played = Played()
        self._outlet, self._rate, self._controls, self._flow = outlet, rate, controls, flow
        self._timeline = Timeline(rate)
        self._stretch = 0

    @contextmanager
    def telling_time(self, begin_ns: int) -> Generator[None]:
        """Tell the replay's time meanwhile, a while before the first message and after the last."""
        ended = threading.Event()
        self._timeline.jump(begin_ns, monotonic_s())
        thread = threading.Thread(target=self._tell_time, args=(ended,), name="replay clock", daemon=True)
        thread.start()
        try:
            self._controls.wait(LEAD_IN_S)
            yield
            self._timeline.hold(monotonic_s())
            self._tell()
            ended.wait(LEAD_OUT_S)
        finally:
            ended.set()
            thread.join()

    def play(self, source: Iterator[Item], begin_ns: int) -> None:
        """Send all of these once.

        Raises:
            StuckError: where a consumer gets no further.
            OSError: where the recording cannot be read any further.
        """
        self._stretch += 1
        self._timeline.hold(monotonic_s())
        self._timeline.jump(begin_ns, monotonic_s())
        ahead = ReadAhead(source)
        try:
            ahead.fill(FILL_S)
            for item in ahead:
                if not self._its_moment(item.at_ns):
                    return
                self._send(item)
        finally:
            ahead.close()

    def _its_moment(self, at_ns: int) -> bool:
        """Wait until a moment has come; whether it did, and nobody said stop."""
        while not self._controls.stopped:
            now_s = monotonic_s()
            if self._controls.held:
                if self._timeline.hold(now_s):
                    self._tell()
                self._controls.wait(LOOK_S)
                continue
            if self._flow is not None:
                self._timeline.jump(at_ns, now_s)
                self._tell()
                return True
            if self._timeline.go_on(now_s):
                self._stretch += 1
                self._tell()
            left_s = self._timeline.due_s(at_ns) - now_s
            if left_s <= 0:
                self.played.behind_s = max(self.played.behind_s, -left_s)
                return True
            self._controls.wait(min(left_s, LOOK_S))
        return False

    def _send(self, item: Item) -> None:
        if isinstance(item, PastCommand):
            self._send_command(item)
            return
        number = self._outlet.publish(item.key, item.payload, item.published_ns)
        self.played.note(item, monotonic_s(), self._stretch)
        if self._flow is not None:
            self._flow.sent(item.key, number)
            if self._flow.must_settle(item.key):
                self._flow.settle(lambda: self._controls.stopped)
        if item.ends_step:
            self._controls.step_done()

    def _send_command(self, command: PastCommand) -> None:
        def send() -> None:
            answer = self._outlet.send(command.topic, command.instance, command.message)
            self.played.answers.append((command.topic, answer))

        if self._flow is not None:
            send()
            return
        # what follows does not wait for the answer
        threading.Thread(target=send, name=f"send {command.topic}", daemon=True).start()

    def _tell(self) -> None:
        self._outlet.tell_time(*self._timeline.now(monotonic_s()))

    def _tell_time(self, ended: threading.Event) -> None:
        self._tell()
        while not ended.wait(TELL_PERIOD_S):
            self._tell()
