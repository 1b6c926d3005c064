"""The last seconds in memory, kept as a file when something goes wrong, with the seconds that follow it.

What happens before an event is what explains it, and recording all day for one is seldom wanted.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from agents.recorder.parts import FileSettings, Head, Parts, Tally
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import AgentHealth, ExecutionEvent, ExecutionKind, GraspJudgement, RobotMode, RobotState, Verdict
from schemas.topics import EXECUTION, HEALTH, JUDGEMENT, ROBOT_STATE, Topic
from shared.recording.entry import Entry, Note
from shared.recording.losses import Loss

WATCHED = (EXECUTION, JUDGEMENT, ROBOT_STATE, HEALTH)


class Triggers:
    """Looks at messages one after another; what lasts triggers once, when it begins."""

    def __init__(self) -> None:
        self._lasting: dict[str, bool] = {}

    def of(self, topic: Topic, key: str, payload: bytes) -> str | None:
        """The one word for what a message tells of; None where all goes well."""
        if topic not in WATCHED:
            return None
        try:
            message = decode(topic.message, payload)
        except MessageError:
            return None
        match message:
            case ExecutionEvent(kind=(ExecutionKind.HELD | ExecutionKind.REFUSED) as kind):
                return kind.name.lower()
            case GraspJudgement(verdict=verdict) if verdict is not Verdict.HELD:
                return verdict.name.lower()
            case RobotState():
                return self._begins(key, message.mode is RobotMode.FAULT)
            case AgentHealth():
                return self._begins(key, message.fault != "")
            case _:
                return None

    def _begins(self, key: str, faulty: bool) -> str | None:
        before, self._lasting[key] = self._lasting.get(key, False), faulty
        return "fault" if faulty and not before else None


TRIGGER = "trigger"
"""The note that says why a file was kept."""


@dataclass(frozen=True)
class PreTriggerSettings:
    """What is kept of each event.

    Fields:
        before_s, after_s: seconds before it, and after the last that comes meanwhile.
        limit_bytes: of memory; where the seconds before need more, fewer are kept, and that is said.
    """

    before_s: float
    after_s: float
    limit_bytes: int = 1 << 30


class PreTrigger:
    """Keeps the last seconds, and writes `name_1_held.mcap` and so on beside `path` when an event comes."""

    def __init__(
        self,
        path: Path,
        settings: PreTriggerSettings,
        files: FileSettings,
        head: Head,
        tally: Tally,
        tell: Callable[[str], None],
    ) -> None:
        self._path, self._settings, self._files, self._tally, self._tell = path, settings, files, tally, tell
        self._head = head
        self._ring: deque[tuple[Topic, Entry]] = deque()
        self._ring_bytes, self._too_little_memory = 0, False
        self._losses: deque[Loss] = deque()
        self._triggers = Triggers()
        self._parts: Parts | None = None
        self._until_ns, self._events = 0, 0

    def write(self, topic: Topic, entry: Entry) -> None:
        """Remember a message; write it where an event is being kept, or it is one."""
        self._ring.append((topic, entry))
        self._ring_bytes += len(entry.payload)
        self._forget(entry.received_ns)
        if self._parts is not None:
            self._parts.write(topic, entry)
        if reason := self._triggers.of(topic, entry.key, entry.payload):
            self.trigger(reason, entry.received_ns)

    def trigger(self, reason: str, at_ns: int) -> None:
        """Keep what is remembered, and what comes now."""
        self._until_ns = at_ns + int(self._settings.after_s * 1e9)
        if self._parts is not None:
            self._parts.trigger(reason, at_ns)
            return
        # messages may have waited here for longer than the seconds before, with nothing to drive them out
        self._forget(at_ns)
        self._events += 1
        path = self._path.with_stem(f"{self._path.stem}_{self._events}_{reason}")
        held_s = (at_ns - self._ring[0][1].received_ns) * 1e-9 if self._ring else 0.0
        self._tell(f"{reason}: the {held_s:.1f} s before it, and {self._settings.after_s:g} s more, go to {path}")
        self._parts = Parts(path, self._files, self._head.copy(), self._tally)
        self._parts.note(Note(TRIGGER, {"reason": reason, "at_ns": str(at_ns), "seconds_before": f"{held_s:.3f}"}))
        if self._losses:
            self._parts.lose(list(self._losses), at_ns)
        for topic, entry in self._ring:
            self._parts.write(topic, entry)
        self._parts.flush(at_ns)

    def note(self, note: Note) -> None:
        """Add facts to this file and to those that follow."""
        self._head.notes[note.name] = note
        if self._parts is not None:
            self._parts.note(note)

    def lose(self, losses: list[Loss], at_ns: int) -> None:
        """Remember what is lost, and say so in a file that is being written."""
        self._losses.extend(losses)
        if self._parts is not None:
            self._parts.lose(losses, at_ns)

    def spoil(self) -> None:
        """The file that is being written is not complete."""
        if self._parts is not None:
            self._parts.spoil()

    def flush(self, now_ns: int) -> None:
        """Hand what is written to the system, and end the file once its time is over."""
        self._forget(now_ns)
        if self._parts is None:
            return
        if now_ns < self._until_ns:
            self._parts.flush(now_ns)
        else:
            self.close()

    def close(self, complete: bool = True) -> None:
        """End the file that is being written."""
        if self._parts is not None:
            self._parts.close(complete)
            self._parts = None

    def abandon(self) -> None:
        """Close the file as it is."""
        if self._parts is not None:
            self._parts.abandon()

    def _forget(self, now_ns: int) -> None:
        begins_ns = now_ns - int(self._settings.before_s * 1e9)
        while self._ring:
            entry = self._ring[0][1]
            if entry.received_ns >= begins_ns:
                if self._ring_bytes <= self._settings.limit_bytes:
                    break
                self._say_that_memory_is_short(now_ns - entry.received_ns)
            topic, _ = self._ring.popleft()
            self._ring_bytes -= len(entry.payload)
            self._head.follow(topic, entry)
        oldest_ns = self._ring[0][1].received_ns if self._ring else now_ns
        while self._losses and self._losses[0].at_ns < oldest_ns:
            self._losses.popleft()

    def _say_that_memory_is_short(self, held_ns: int) -> None:
        if not self._too_little_memory:
            limit = self._settings.limit_bytes / 1e6
            self._tell(f"{limit:.0f} MB of memory hold only the last {held_ns * 1e-9:.1f} s; allow more, or less time")
        self._too_little_memory = True
