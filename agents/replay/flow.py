"""A replay as fast as its consumers, that loses nothing: the next message waits until all has followed from the last.

Consumers (agents, and listeners such as the recorder) tell which message of each key they are done with, and what they
have published themselves (shared/runtime/facts.py). All is settled when each is done with the newest message of each
key that it listens to, those of other consumers included. One that publishes unasked is not waited for by others.

How well a replay keeps the spacing is told too: of two messages of one key that follow each other, recorded d apart and
sent at rate r, the error is how much their sending was more or less than d / r apart.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from schemas.messages import Progress
from schemas.topics import Delivery, topic_of
from shared.clock import monotonic_s
from shared.runtime.facts import matches
from shared.runtime.taps import TAP

PATIENCE_S = 30.0
FIRST_LOOK_S, SLOWEST_LOOK_S = 0.001, 0.02
QUICK_S = 0.5
"""Who is not among answers that came so soon is gone; one that hangs makes all wait for its answer."""
UNSETTLED = 32
"""Messages that may be on their way to consumers which queue what they hear; half of the room of their rings."""


class StuckError(RuntimeError):
    """A consumer that gets no further; the text says which, and with what."""


@dataclass(frozen=True)
class Awaited:
    """A message that a consumer is not done with."""

    consumer: str
    key: str
    sequence: int


class Flow:
    """Waits until consumers are done; those who are there at the beginning are waited for, until they leave.

    Fields:
        gone: those who left.
    """

    def __init__(self, ask: Callable[[], dict[str, Progress]], epoch: int) -> None:
        self._ask, self._epoch = ask, epoch
        first = ask()
        self.consumers, self.gone = frozenset(first), frozenset[str]()
        self._before = _published(first)
        self._selectors = [
            (name.startswith(f"{TAP}/"), selector) for name, said in first.items() for selector in said.listens.split()
        ]
        self._sent: dict[str, int] = {}
        self._unsettled = 0

    def sent(self, key: str, sequence: int) -> None:
        """Note a message that was sent."""
        self._sent[key] = sequence
        self._unsettled += 1

    def must_settle(self, key: str) -> bool:
        """Whether the next message has to wait for the consumers of the last one, which was of that key."""
        latest = topic_of(key).delivery is Delivery.LATEST
        agents = any(not tap and matches(selector, key) for tap, selector in self._selectors)
        return (latest and agents) or self._unsettled >= UNSETTLED

    def settle(self, stopped: Callable[[], bool]) -> None:
        """Wait until all is settled, or stopped.

        Raises:
            StuckError: where a consumer gets no further.
        """
        look_s, since_s, last = FIRST_LOOK_S, monotonic_s(), None
        turn = threading.Event()
        while not stopped():
            said = self._answers()
            awaited = awaited_of(said, self._sent, self._epoch, self._before)
            if awaited is None and said.keys() == self.consumers:
                self._unsettled = 0
                return
            if said != last:
                last, since_s = said, monotonic_s()
            if monotonic_s() - since_s > PATIENCE_S:
                raise StuckError(_stuck(awaited, self.consumers - said.keys()))
            turn.wait(look_s)
            look_s = min(2 * look_s, SLOWEST_LOOK_S)

    def _answers(self) -> dict[str, Progress]:
        asked_s = monotonic_s()
        said = {name: progress for name, progress in self._ask().items() if name in self.consumers}
        if monotonic_s() - asked_s < QUICK_S:
            self.gone |= self.consumers - said.keys()
            self.consumers &= said.keys()
        return said


def awaited_of(
    said: Mapping[str, Progress], sent: Mapping[str, int], epoch: int, before: Mapping[tuple[str, int], int]
) -> Awaited | None:
    """The first message that a consumer is not done with; None where all is settled.

    `sent` are the newest numbers of the replay's own keys, in its epoch; `before` what consumers had published before
    it began, by key and epoch, which nobody need have heard.
    """
    newest = {(key, epoch): number for key, number in sent.items()}
    newest |= {place: n for place, n in _published(said).items() if n > before.get(place, -1)}
    for consumer, progress in said.items():
        done = {(c.key, c.epoch): c.sequence for c in progress.handled}
        selectors = progress.listens.split()
        for (key, of), number in newest.items():
            if done.get((key, of), -1) < number and any(matches(selector, key) for selector in selectors):
                return Awaited(consumer, key, number)
    return None


def _published(said: Mapping[str, Progress]) -> dict[tuple[str, int], int]:
    return {(c.key, c.epoch): c.sequence for progress in said.values() for c in progress.published}


def _stuck(awaited: Awaited | None, silent: frozenset[str]) -> str:
    after = f"after {PATIENCE_S:.0f} s"
    if silent or awaited is None:
        return f"{', '.join(sorted(silent))} tells nothing any more {after}"
    return f"{awaited.consumer} is not done with message {awaited.sequence} of {awaited.key} {after}"


@dataclass(frozen=True)
class Spacing:
    """Errors of spacing in milliseconds, over so many pairs."""

    pairs: int
    p50_ms: float
    p99_ms: float
    worst_ms: float


def spacing_errors_ms(
    sent_s: Float64[np.ndarray, "n"], recorded_ns: Int64[np.ndarray, "n"], run: Int64[np.ndarray, "n"], rate: float
) -> Float64[np.ndarray, "m"]:
    """The error of each pair of neighbours that belong to one run: of the same key, and nothing held between."""
    same = run[1:] == run[:-1]
    between_s = np.diff(recorded_ns) * 1e-9 / rate
    return np.abs(np.diff(sent_s) - between_s)[same] * 1e3


def spacing_of(errors_ms: Float64[np.ndarray, "n"]) -> Spacing | None:
    """Percentiles of errors; None where there are none."""
    if not errors_ms.size:
        return None
    p50, p99 = np.percentile(errors_ms, (50, 99))
    return Spacing(errors_ms.size, float(p50), float(p99), float(errors_ms.max()))
