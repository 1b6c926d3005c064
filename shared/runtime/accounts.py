"""An agent's account of itself, of which its health tells: its topics, its steps, its faults, its processor."""

import os
import socket
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

import schemas
from schemas.messages import AgentHealth, InputHealth, OutputHealth
from shared.clock import monotonic_s, processor_s
from shared.runtime.attachment import Attachment

WINDOW_S = 2.0
STEPS_KEPT = 300
MOST = 1 << 62
"""Counts that follow from numbers that others claim are told up to here, and fit their field on the wire."""


@dataclass
class Rate:
    """Events per second over the last moments."""

    times: deque[float] = field(default_factory=deque[float])

    def count(self, now_s: float) -> None:
        """Count an event at that time."""
        self._forget(now_s)
        self.times.append(now_s)

    def hz(self, now_s: float) -> float:
        """The rate over the window that ends now."""
        self._forget(now_s)
        return len(self.times) / WINDOW_S

    def _forget(self, now_s: float) -> None:
        while self.times and self.times[0] < now_s - WINDOW_S:
            self.times.popleft()


@dataclass
class InputAccount:
    """What became of the messages of one input.

    Fields:
        skipped: sequence numbers between messages that came.
        missed: events that are known to be lost.
        unreadable: of those received, which an agent only remembers, and which could not be read when they were needed.
    """

    topic: str
    rate: Rate = field(default_factory=Rate)
    received: int = 0
    skipped: int = 0
    missed: int = 0
    refused: int = 0
    unreadable: int = 0
    age_ms: float | None = None
    _last: dict[str, tuple[int, int]] = field(default_factory=dict[str, tuple[int, int]])

    def came(self, key: str, beside: Attachment) -> None:
        """Count those of its key's sequence that lie between a message that came and the last."""
        epoch, sequence = self._last.get(key, (beside.epoch, beside.sequence - 1))
        self._last[key] = (beside.epoch, beside.sequence)
        if epoch == beside.epoch:
            self.skipped += max(0, beside.sequence - sequence - 1)

    def looked_at(self, beside: Attachment, now_ns: int, now_s: float) -> None:
        """Count a message that somebody has looked at."""
        self.received += 1
        self.rate.count(now_s)
        self.age_ms = (now_ns - beside.published_ns) * 1e-6

    def refuse(self, counted: bool = False) -> None:
        """Count a message that could not be read, which is refused, not missed; `counted`: as received, before."""
        self.refused += 1
        # another thread counts what is received
        self.unreadable += counted

    def health(self, dropped: int, now_s: float) -> InputHealth:
        """This account as a message; `dropped` are those that the inbox replaced."""
        missed = min(max(self.missed, self.skipped), MOST)
        received, rate_hz = self.received - self.unreadable, self.rate.hz(now_s)
        return InputHealth(self.topic, rate_hz, self.age_ms, received, dropped, missed, self.refused)


@dataclass
class OutputAccount:
    """What was published on one output."""

    topic: str
    rate: Rate = field(default_factory=Rate)
    published: int = 0

    def count(self, now_s: float) -> None:
        """Count a message."""
        self.published += 1
        self.rate.count(now_s)

    def health(self, now_s: float) -> OutputHealth:
        """This account as a message."""
        return OutputHealth(self.topic, self.rate.hz(now_s), self.published)


class StepTimes:
    """How long the last steps took."""

    def __init__(self) -> None:
        self._ms: deque[float] = deque(maxlen=STEPS_KEPT)

    def add(self, ms: float) -> None:
        """Count a step."""
        self._ms.append(ms)

    def percentiles(self, *shares: float) -> tuple[float | None, ...]:
        """Milliseconds below which those percentages of the last steps lie, None before the first.

        Between two steps it is interpolated, as NumPy does, which takes ten times as long for so few.
        """
        ordered = sorted(self._ms)
        return tuple(_at(ordered, share / 100 * (len(ordered) - 1)) if ordered else None for share in shares)


def _at(ordered: list[float], place: float) -> float:
    before = int(place)
    after = min(before + 1, len(ordered) - 1)
    return ordered[before] + (place - before) * (ordered[after] - ordered[before])


SHOWN_S = 5.0
"""A fault is told for so long at least: health comes once a second, and people look less often."""
LIKE_PER_LINE = 100
"""After the first, only every so many like failures get a line in the log."""


@dataclass
class Faults:
    """The failures of an agent's steps.

    Fields:
        text: the fault that holds; empty where none does.
        count: how many steps failed since the agent began.
    """

    text: str = ""
    count: int = 0
    _of: str = ""
    _like: int = 0
    _failed_s: float = 0.0
    _is_well: bool = True

    def failed(self, of: str, text: str, now_s: float, alone: bool = False) -> bool:
        """Note that a step failed, and what it was a step of; whether that is to be logged.

        `alone`: nothing of its kind need follow, as of a command, so that the fault holds no longer than it is shown.
        """
        self.count += 1
        self._like = self._like + 1 if text == self.text else 0
        self._of, self.text, self._failed_s, self._is_well = of, text, now_s, alone
        return self._like % LIKE_PER_LINE == 0

    def went_well(self, of: str) -> None:
        """Note that a step of that kind went well."""
        self._is_well = self._is_well or of == self._of

    def ended(self, now_s: float) -> bool:
        """Whether the fault holds no longer; true once."""
        over = bool(self.text) and self._is_well and now_s - self._failed_s > SHOWN_S
        if over:
            self.text = ""
        return over


STATM = Path("/proc/self/statm")


def resident_bytes() -> int:
    """The memory of this process that is in the machine's now; 0 where the system does not tell."""
    try:
        return int(STATM.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


class Vitals:
    """How a process fares, as its health tells.

    Fields:
        heartbeat: turns of its loop.
        steps: how long they took; none of what takes no steps.
    """

    def __init__(self, kind: str, instance: str) -> None:
        self.heartbeat, self.steps = 0, StepTimes()
        self._kind, self._instance, self._host = kind, instance, socket.gethostname()
        self._began_s = self._told_s = monotonic_s()
        self._used_s = processor_s()

    def health(
        self,
        at_ns: int,
        config_hash: str,
        fault: str,
        inputs: tuple[InputHealth, ...],
        outputs: tuple[OutputHealth, ...] = (),
    ) -> AgentHealth:
        """All of that as a message; the share of a processor is since the last one, above 1 where several were busy."""
        now_s, used_s = monotonic_s(), processor_s()
        elapsed_s, spent_s = now_s - self._told_s, used_s - self._used_s
        self._told_s, self._used_s = now_s, used_s
        step_ms_p50, step_ms_p99 = self.steps.percentiles(50, 99)
        return AgentHealth(
            agent=self._kind,
            instance=self._instance,
            host=self._host,
            version=schemas.__version__,
            config_hash=config_hash,
            at_ns=at_ns,
            uptime_s=now_s - self._began_s,
            heartbeat=self.heartbeat,
            step_ms_p50=step_ms_p50,
            step_ms_p99=step_ms_p99,
            inputs=inputs,
            outputs=outputs,
            fault=fault,
            processor_share=spent_s / elapsed_s if elapsed_s > 0 else 0.0,
            resident_bytes=resident_bytes(),
        )
