"""The only module that reads a clock."""

import time
from collections.abc import Generator
from contextlib import contextmanager


def now_ns() -> int:
    """Nanoseconds since 1970: the time that travels in messages."""
    return time.time_ns()


def monotonic_s() -> float:
    """Seconds that never jump: for intervals within one process."""
    return time.monotonic()


def monotonic_ns() -> int:
    """The same in nanoseconds."""
    return time.monotonic_ns()


def processor_s() -> float:
    """Seconds that processors have spent on this process: what others do on the machine hardly counts."""
    return time.process_time()


def thread_s() -> float:
    """Seconds for which the thread that asks has had a processor."""
    return time.thread_time()


class Stopwatch:
    """Milliseconds spent per named step; a step that was never taken counts 0."""

    def __init__(self, *steps: str) -> None:
        self.ms: dict[str, float] = dict.fromkeys(steps, 0.0)

    @contextmanager
    def step(self, name: str) -> Generator[None]:
        """Add the time spent inside to one of the named steps."""
        started = time.perf_counter_ns()
        try:
            yield
        finally:
            self.ms[name] += (time.perf_counter_ns() - started) * 1e-6
