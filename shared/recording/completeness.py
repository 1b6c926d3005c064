"""Whether a recording holds everything, as far as it tells itself."""

from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from shared.recording.entry import Entry, Note
from shared.recording.losses import COMPLETE, LOSSES, LOST, counts_of
from shared.recording.mcap_file import is_finished, read_with_notes


@dataclass(frozen=True)
class Completeness:
    """What a recording says of itself.

    Fields:
        finished: whether it was closed; a file that was cut off lacks its last moments, and nobody counted them.
        last_ns: when its last message was received, None where it has none.
        lost: messages that are known to be missing, by key.
        complete: None where nobody knows, because the file was cut off and tells of no loss before.
    """

    finished: bool
    last_ns: int | None
    lost: dict[str, int]
    complete: bool | None

    @property
    def sentence(self) -> str:
        """The same in plain words."""
        gaps = ", ".join(f"{count} of {key}" for key, count in sorted(self.lost.items()))
        until = "" if self.finished else f"cut off {_when(self.last_ns)}, and what came in the last moments is missing"
        if self.complete:
            return "complete"
        known = f"lost {gaps}" if gaps else "not complete" if self.finished else "nothing is known to be lost before"
        return f"{until}; {known}" if until else known


def completeness(path: Path) -> Completeness:
    """Read a recording from front to back for what it lacks.

    Raises:
        RecordingError, OSError: as `read_recording`.
    """
    last_ns, summed, noted = None, None, Counter[str]()
    for record in read_with_notes(path):
        match record:
            case Entry():
                last_ns = record.received_ns
            case Note(name) if name == LOST:
                noted.update(counts_of(record))
            case Note(name) if name == LOSSES:
                summed = record
            case _:
                pass
    if summed is not None and is_finished(path):
        return Completeness(True, last_ns, counts_of(summed), summed.facts.get(COMPLETE) == str(True))
    return Completeness(is_finished(path), last_ns, dict(noted), False if noted else None)


def _when(at_ns: int | None) -> str:
    if at_ns is None:
        return "before its first message"
    return datetime.fromtimestamp(at_ns * 1e-9, UTC).astimezone().strftime("at %Y-%m-%d %H:%M:%S.%f")[:-5]
