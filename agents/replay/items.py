"""What is sent of a stretch of a recording, in its order, read ahead by a thread of its own."""

import heapq
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from agents.replay.contents import PastCommand
from schemas.topics import FRAMES, known_topic
from shared.recording.entry import Entry
from shared.recording.stretch import stretch

AHEAD_BYTES = 64 << 20
"""What is read ahead of time, some seconds of everything, so that the disk delays nothing."""


@dataclass(frozen=True)
class Message:
    """A message to publish at a moment of the recording; who goes step by step holds after those that end one."""

    at_ns: int
    key: str
    payload: bytes
    published_ns: int
    ends_step: bool


Item = Message | PastCommand


def items(
    recording: Iterable[Entry],
    keys: Sequence[str],
    commands: Iterable[PastCommand],
    window_ns: tuple[int, int],
    rig: str,
) -> Iterator[Item]:
    """What is sent of a stretch of a recording, under the keys of a rig, in the order in which it was received.

    States that held when the stretch begins (such as the calibration) come first, since late joiners get them too. A
    step ends with each frame; where none are sent, with each message.
    """
    begin_ns, end_ns = window_ns
    chosen = sorted((c for c in commands if begin_ns <= c.at_ns <= end_ns), key=lambda command: command.at_ns)
    return heapq.merge(_messages(recording, frozenset(keys), window_ns, rig), chosen, key=lambda item: item.at_ns)


def _messages(
    recording: Iterable[Entry], keys: frozenset[str], window_ns: tuple[int, int], rig: str
) -> Iterator[Message]:
    begin_ns, end_ns = window_ns
    has_frames = any(known_topic(key) is FRAMES for key in keys)
    played = (entry for entry in recording if entry.key in keys)
    return (_message(entry, begin_ns, rig, has_frames) for entry in stretch(played, begin_ns, end_ns))


def _message(entry: Entry, begin_ns: int, rig: str, has_frames: bool) -> Message:
    parts = entry.key.split("/")
    key = "/".join((parts[0], rig, *parts[2:]))
    ends_step = not has_frames or known_topic(entry.key) is FRAMES
    return Message(max(entry.received_ns, begin_ns), key, entry.payload, entry.published_ns, ends_step)


class ReadAhead:
    """Items that a thread of its own reads before they are needed."""

    def __init__(self, source: Iterator[Item], most_bytes: int = AHEAD_BYTES) -> None:
        """Begin to read."""
        self._source, self._most_bytes = source, most_bytes
        self._condition = threading.Condition()
        self._read: deque[Item] = deque()
        self._bytes, self._ended, self._fault = 0, False, None
        self._thread = threading.Thread(target=self._read_all, name="read ahead", daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[Item]:
        """The items, in order.

        Raises:
            OSError: where the file cannot be read any further.
        """
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._read or self._ended)
                if not self._read:
                    break
                item = self._read.popleft()
                self._bytes -= _size(item)
                self._condition.notify_all()
            yield item
        if self._fault is not None:
            raise self._fault

    def fill(self, within_s: float) -> None:
        """Wait until as much is read as may be, since reading and sending get in each other's way."""
        with self._condition:
            self._condition.wait_for(lambda: self._bytes >= self._most_bytes or self._ended, within_s)

    def close(self) -> None:
        """Read no further."""
        with self._condition:
            self._ended = True
            self._condition.notify_all()
        self._thread.join()

    def _read_all(self) -> None:
        try:
            for item in self._source:
                with self._condition:
                    self._condition.wait_for(lambda: self._bytes < self._most_bytes or self._ended)
                    if self._ended:
                        return
                    self._read.append(item)
                    self._bytes += _size(item)
                    self._condition.notify_all()
        except OSError as error:
            self._fault = error
        finally:
            with self._condition:
                self._ended = True
                self._condition.notify_all()


def _size(item: Item) -> int:
    return len(item.payload) if isinstance(item, Message) else 0
