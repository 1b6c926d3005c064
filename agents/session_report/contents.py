"""What a recording holds by key: how much, how often, and where something is missing."""

import itertools
from array import array
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Int64

from schemas.topics import HEARTBEAT, Delivery, known_topic
from shared.recording.entry import Entry

SILENT_PERIODS, SILENT_S = 5.0, 0.1
"""A key is silent where nothing came for so many of its median intervals, and for so long."""
RESTING_PERIODS = 2.0
"""And where its publisher rests between motions, for so many of the intervals that it keeps then."""
SEQUENCE_RANGE = 1 << 32
LATEST_NS = (1 << 63) - 1
"""The year 2262; a file may claim later ones."""


@dataclass(frozen=True)
class Gap:
    """Between two messages of one run: numbers that are missing, or a silence in what comes regularly."""

    from_ns: int
    to_ns: int
    lost: int


@dataclass(frozen=True)
class KeyContents:
    """What lies under one key.

    Fields:
        topic: as in the table of topics; empty where this version has no such topic.
        is_regular: its messages come at regular intervals for as long as its publisher runs.
        runs: of its publisher.
        first_ns, last_ns: when the first and the last message were published.
        rate_hz: between the first and the last message of each run; 0 for single messages.
        lost: numbers missing from the sequences.
        unreadable: messages that this version refuses, the first of them for this reason.
        received_ns: of each, which tells it from others under its key.
    """

    key: str
    topic: str
    is_regular: bool
    count: int
    payload_bytes: int
    runs: int
    first_ns: int
    last_ns: int
    rate_hz: float
    gaps: tuple[Gap, ...]
    lost: int
    unreadable: int = 0
    unreadable_reason: str = ""
    received_ns: "array[int]" = field(default_factory=lambda: array("q"), repr=False)


@dataclass
class _Run:
    published_ns: "array[int]" = field(default_factory=lambda: array("q"))
    sequence: "array[int]" = field(default_factory=lambda: array("q"))


@dataclass
class _Key:
    runs: dict[int, _Run] = field(default_factory=dict[int, _Run])
    payload_bytes: int = 0
    unreadable: int = 0
    unreadable_reason: str = ""
    received_ns: "array[int]" = field(default_factory=lambda: array("q"))


class ContentsCollector:
    """Counts messages one by one; keeps 24 bytes of each."""

    def __init__(self) -> None:
        self._keys: dict[str, _Key] = {}

    def add(self, entry: Entry) -> None:
        """Count a message."""
        one = self._keys.setdefault(entry.key, _Key())
        one.payload_bytes += len(entry.payload)
        one.received_ns.append(min(entry.received_ns, LATEST_NS))
        run = one.runs.setdefault(entry.epoch, _Run())
        run.published_ns.append(min(entry.published_ns, LATEST_NS))
        run.sequence.append(entry.sequence)

    def refuse(self, entry: Entry, reason: str) -> None:
        """Note that a message that was counted cannot be read."""
        one = self._keys[entry.key]
        one.unreadable += 1
        one.unreadable_reason = one.unreadable_reason or reason

    def contents(self) -> tuple[KeyContents, ...]:
        """What was counted, by key in alphabetical order."""
        return tuple(_contents(key, one) for key, one in sorted(self._keys.items()))


def _contents(key: str, one: _Key) -> KeyContents:
    topic, is_regular, resting_s = _topic(key)
    runs = [(np.array(run.published_ns, np.int64), np.array(run.sequence, np.int64)) for run in one.runs.values()]
    within = [gap for run in runs for gap in gaps_of(*run, is_regular, resting_s)]
    between = _between([published for published, _ in runs], resting_s) if is_regular else []
    gaps = sorted((*within, *between), key=lambda gap: gap.from_ns)
    lasted_s = sum(float(np.ptp(published)) for published, _ in runs) * 1e-9
    intervals = sum(len(published) - 1 for published, _ in runs)
    return KeyContents(
        key=key,
        topic=topic,
        is_regular=is_regular,
        count=sum(len(published) for published, _ in runs),
        payload_bytes=one.payload_bytes,
        runs=len(runs),
        first_ns=min(int(published.min()) for published, _ in runs),
        last_ns=max(int(published.max()) for published, _ in runs),
        rate_hz=intervals / lasted_s if lasted_s > 0 else 0.0,
        gaps=tuple(gaps),
        lost=sum(gap.lost for gap in gaps),
        unreadable=one.unreadable,
        unreadable_reason=one.unreadable_reason,
        received_ns=one.received_ns,
    )


def without_left_out(
    contents: tuple[KeyContents, ...], lost: Mapping[str, int], keys: Collection[str]
) -> tuple[KeyContents, ...]:
    """The same where messages under these keys were left out on purpose: `lost` is what the recorder noted of them."""
    return tuple(
        replace(one, lost=lost.get(one.key, 0), gaps=tuple(gap for gap in one.gaps if not gap.lost))
        if one.key in keys
        else one
        for one in contents
    )


def _topic(key: str) -> tuple[str, bool, float]:
    """The topic's name, whether its messages come regularly while its publisher runs, and the interval at rest."""
    topic = known_topic(key)
    if topic is None:
        return "", False, 0.0
    # heartbeats come while an arm is armed, and not between two grasps
    is_regular = topic.delivery is Delivery.LATEST and topic.rate_hz is not None and topic is not HEARTBEAT
    return str(topic), is_regular, 1.0 / topic.resting_hz if topic.resting_hz else 0.0


def _between(runs: list[Int64[np.ndarray, "n"]], resting_s: float) -> list[Gap]:
    """Where nothing came regularly between the end of one run of a publisher and the beginning of the next."""
    ordered = sorted((run for run in runs if len(run)), key=lambda run: int(run.min()))
    pauses = [(int(one.max()), int(other.min())) for one, other in itertools.pairwise(ordered)]
    intervals = np.concatenate([np.diff(np.sort(run)) for run in ordered]) if ordered else np.zeros(0)
    longest_ns = _longest_ns(intervals, resting_s)
    return [Gap(begins, ends, 0) for begins, ends in pauses if ends - begins > longest_ns]


def _longest_ns(interval_ns: np.ndarray, resting_s: float) -> float:
    """How long something regular may be silent."""
    usual_ns = float(np.median(interval_ns)) if len(interval_ns) else 0.0
    return max(SILENT_PERIODS * usual_ns, 1e9 * max(SILENT_S, RESTING_PERIODS * resting_s))


def gaps_of(
    published_ns: Int64[np.ndarray, "n"], sequence: Int64[np.ndarray, "n"], is_regular: bool, resting_s: float = 0.0
) -> list[Gap]:
    """Where numbers of one run are missing and, of what comes regularly, where it was silent.

    Numbers are those of the recording, of which 32 bits are kept; they may come out of order or twice.
    """
    relative = (sequence - sequence[0] + SEQUENCE_RANGE // 2) % SEQUENCE_RANGE - SEQUENCE_RANGE // 2
    numbers, places = np.unique(relative, return_index=True)
    if len(numbers) < 2:
        return []
    times_ns = published_ns[places]
    lost, interval_ns = np.diff(numbers) - 1, np.diff(times_ns)
    is_silent = interval_ns > _longest_ns(interval_ns, resting_s)
    found = np.flatnonzero((lost > 0) | (is_silent & is_regular))
    return [Gap(int(times_ns[i]), int(times_ns[i + 1]), int(lost[i])) for i in found]
