"""What waits to be written, and what was lost before it could: whoever brings a message never waits.

Room is bounded by number and by bytes, so that a disk that stands still takes no more memory than that.

A recording ends, and says so, before it fills the disk that others write to as well.
"""

import os
import threading
from collections import defaultdict, deque
from dataclasses import dataclass
from pathlib import Path

from schemas.topics import Topic, topic_of
from shared.clock import now_ns
from shared.recording.losses import NO_ROOM, ON_THE_WAY, TOLD_BY_ZENOH, Loss
from shared.runtime.attachment import Attachment
from shared.runtime.taps import Tapped

QUEUE_LIMIT = 4000
"""Messages that may wait for the disk, some seconds of everything; beyond that they are lost, and counted."""
QUEUE_BYTES = 512 << 20
GATHERED_BYTES = 4 << 20
"""What may wait for more to come, so that whoever writes is not woken for each message."""


@dataclass(frozen=True)
class Waiting:
    """A numbered message, and when it was received."""

    tapped: Tapped
    beside: Attachment
    received_ns: int


class Intake:
    """Takes messages from any thread, and gives them to one."""

    def __init__(self, limit: int = QUEUE_LIMIT, limit_bytes: int = QUEUE_BYTES) -> None:
        self._limit, self._limit_bytes = limit, limit_bytes
        self._waiting: deque[Waiting] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._last: dict[str, tuple[int, int]] = {}
        self._losses: list[Loss] = []
        self._missed: defaultdict[str, int] = defaultdict(int)
        self._gaps: defaultdict[str, int] = defaultdict(int)
        self.unnumbered = 0
        self.closed = False

    def put(self, tapped: Tapped) -> None:
        """Queue a message; never waits."""
        with self._changed:
            if self.closed:
                return
            beside = tapped.beside
            if beside is None:
                self.unnumbered += 1
                return
            # the time is read under the lock, so that the file is in the order of its times
            at_ns = now_ns()
            self._follow(tapped.key, beside, at_ns)
            size = len(tapped.payload)
            if len(self._waiting) >= self._limit or (self._waiting and self._bytes + size > self._limit_bytes):
                self._losses.append(Loss(tapped.key, beside.sequence, beside.sequence, NO_ROOM, at_ns))
                return
            self._bytes += size
            self._waiting.append(Waiting(tapped, beside, at_ns))
            if self._bytes >= GATHERED_BYTES or 2 * len(self._waiting) >= self._limit:
                self._changed.notify()

    def missed(self, topic: Topic, count: int) -> None:
        """Count messages that Zenoh reports as lost; most show as a gap too, once the next one comes."""
        with self._changed:
            self._missed[str(topic)] += count

    def take(self, timeout_s: float) -> Waiting | None:
        """The next message; where none waits, after that time, or as soon as much does. None where none has come."""
        with self._changed:
            if not self._waiting and not self.closed:
                self._changed.wait(timeout_s)
            if not self._waiting:
                return None
            waiting = self._waiting.popleft()
            self._bytes -= len(waiting.tapped.payload)
            return waiting

    def take_losses(self) -> list[Loss]:
        """What was lost since this was asked last; once closed, also what Zenoh told of and no gap shows."""
        with self._changed:
            losses, self._losses = self._losses, []
            if self.closed:
                for name, count in self._missed.items():
                    if (left := count - self._gaps.get(name, 0)) > 0:
                        losses.append(Loss(name, 1, left, TOLD_BY_ZENOH, now_ns()))
                self._missed.clear()
            return losses

    def close(self) -> None:
        """Take nothing more; what waits can still be taken."""
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    @property
    def empty(self) -> bool:
        """Whether nothing waits."""
        with self._changed:
            return not self._waiting

    def _follow(self, key: str, beside: Attachment, at_ns: int) -> None:
        epoch, last = self._last.get(key, (beside.epoch, beside.sequence - 1))
        self._last[key] = (beside.epoch, beside.sequence)
        # a publisher that restarted begins a new sequence
        if epoch == beside.epoch and beside.sequence > last + 1:
            self._losses.append(Loss(key, last + 1, beside.sequence - 1, ON_THE_WAY, at_ns))
            self._gaps[str(topic_of(key))] += beside.sequence - last - 1


SHARE, MOST_BYTES = 0.02, 500 << 20
"""Left free unless told otherwise: 2 % of the disk, 500 MB at most."""


class DiskGuard:
    """Watches the disk of a folder; `keep_free_bytes` is what is to stay free, None for the rule above."""

    def __init__(self, folder: Path, keep_free_bytes: int | None = None) -> None:
        self._folder, self._keep_bytes = folder, keep_free_bytes

    def problem(self) -> str:
        """Why nothing more should be written; empty where there is room, or the system does not tell."""
        free, keep = self._room()
        if free is None or free >= keep:
            return ""
        return (
            f"{_mb(free)} are free where {self._folder} lies, and {_mb(keep)} are to stay free: "
            "make room, or record elsewhere"
        )

    def has_room_again(self) -> bool:
        """Whether there is twice the room that is to stay free, so that a recording may begin anew and last a while."""
        free, keep = self._room()
        return free is None or free >= 2 * keep

    def _room(self) -> tuple[int | None, int]:
        """Bytes that are free, None where the system does not tell or nothing can fill, and that are to stay free."""
        try:
            disk = os.statvfs(self._folder)
        except OSError:
            return None, 0
        free, total = disk.f_bavail * disk.f_frsize, disk.f_blocks * disk.f_frsize
        keep = min(int(SHARE * total), MOST_BYTES) if self._keep_bytes is None else self._keep_bytes
        # what has no size, such as /dev, is no disk that fills
        return (free if total else None), keep


def _mb(size: int) -> str:
    return f"{size / 1e6:.0f} MB" if size >= 10e6 else f"{size / 1e6:.1f} MB"
