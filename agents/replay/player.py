"""Plays a recording: sends each message when its moment has come, or as fast as consumers take it.

Whoever sits before it may hold it, let it go on, step to the next frame, and end it. The recording's time t goes on at
a rate r with this machine's s: t = t0 + r (s − s0). While held, r is 0.
"""

import threading
from array import array
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from agents.replay.contents import PastCommand
from agents.replay.flow import Flow, Spacing, spacing_errors_ms, spacing_of
from agents.replay.items import Item, Message, ReadAhead
from schemas.messages import CommandAnswer
from schemas.topics import Topic
from shared.clock import monotonic_s


class Controls:
    """Shared between the thread that plays and those that listen to people and signals."""

    def __init__(self, held: bool = False) -> None:
        self._condition = threading.Condition()
        self._held, self._steps = held, 0
        self._stopped = self._leaving = False

    def toggle(self) -> None:
        """Hold, or go on."""
        with self._condition:
            self._held, self._steps = not (self._held and self._steps == 0), 0
            self._condition.notify_all()

    def step(self) -> None:
        """Go on until one more frame has been sent, then hold."""
        with self._condition:
            self._held = True
            self._steps += 1
            self._condition.notify_all()

    def stop(self) -> None:
        """End the replay."""
        with self._condition:
            self._stopped = True
            self._condition.notify_all()

    def stop_when_done(self) -> None:
        """End the replay after the steps that are still to be done."""
        with self._condition:
            self._leaving = True
            self._stopped = self._stopped or self._steps == 0
            self._condition.notify_all()

    def step_done(self) -> None:
        """A frame was sent: one step is done."""
        with self._condition:
            self._steps = max(0, self._steps - 1)
            self._stopped = self._stopped or (self._leaving and self._steps == 0)

    @property
    def stopped(self) -> bool:
        """Whether the replay is to end."""
        return self._stopped

    @property
    def held(self) -> bool:
        """Whether nothing is to be sent now."""
        return self._held and self._steps == 0

    def wait(self, seconds: float | None) -> None:
        """Until somebody does something, or so many seconds have passed."""
        with self._condition:
            if not self._stopped:
                self._condition.wait(seconds)


class Timeline:
    """The recording's time, in nanoseconds, by seconds of a clock that never jumps; any thread may ask."""

    def __init__(self, rate: float) -> None:
        """Stand at no moment yet; `rate` holds while not held, and is 0 where only jumps pass time."""
        self._lock = threading.Lock()
        self._rate, self._at_ns, self._since_s = rate, 0, 0.0
        self._held = True

    def jump(self, at_ns: int, now_s: float) -> None:
        """It is that moment now."""
        with self._lock:
            self._at_ns, self._since_s = at_ns, now_s

    def hold(self, now_s: float) -> bool:
        """Let no time pass; whether it did before."""
        with self._lock:
            if self._held:
                return False
            self._at_ns, self._since_s, self._held = self._moment(now_s), now_s, True
            return True

    def go_on(self, now_s: float) -> bool:
        """Let time pass from here; whether it was held before."""
        with self._lock:
            if not self._held:
                return False
            self._since_s, self._held = now_s, False
            return True

    def now(self, now_s: float) -> tuple[int, float]:
        """Which moment it is, and at which rate it goes on."""
        with self._lock:
            return self._moment(now_s), 0.0 if self._held else self._rate

    def due_s(self, at_ns: int) -> float:
        """When a moment comes, if time is not held until then; rates above 0 only."""
        with self._lock:
            return self._since_s + (at_ns - self._at_ns) * 1e-9 / self._rate

    def _moment(self, now_s: float) -> int:
        gone_s = 0.0 if self._held else max(0.0, now_s - self._since_s)
        return self._at_ns + round(gone_s * self._rate * 1e9)


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
