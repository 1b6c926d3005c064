"""Whether a recording holds everything, as far as it tells itself."""

import contextlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from shared.recording.derivation import UNUSED_FRAMES, Anew, Derivation, derivations
from shared.recording.entry import Note, RecordingError
from shared.recording.losses import COMPLETE, LOSSES, LOST, counts_of
from shared.recording.mcap_file import finished_notes, is_finished, read_with_notes

ENDED, REASON = "ended", "reason"
"""The note of a recorder that stopped before it was told to."""
UNKNOWN = "nobody noted whether anything is missing"


@dataclass(frozen=True)
class Completeness:
    """What a recording says of itself.

    Fields:
        finished: whether it was closed; of a file that was cut off nobody knows how much it lacks.
        last_ns: when the last message of one that was cut off was received; None where that is not known.
        lost: messages that are known to be missing, by key.
        complete: None where nobody knows.
        derived: how it came from another recording, the newest last; empty for a recorder's own.
        damage: what keeps the notes at its end from being read; empty where they were.
        stopped: why its recorder ended it early, as that noted; empty where it did not.
    """

    finished: bool
    last_ns: int | None
    lost: dict[str, int]
    complete: bool | None
    derived: tuple[Derivation, ...] = ()
    damage: str = ""
    stopped: str = ""

    def doubts_of(self, damage: str) -> list[str]:
        """What whoever uses the recording must know: what it lacks, and that some of it was made later.

        Of a file whose reading broke off, that `damage` takes the place of what it says of itself.
        """
        nothing = self.complete or (self.finished and self.complete is None and not self._of_source)
        lacks = damage or ("" if nothing else self.sentence)
        return [*filter(None, (lacks,)), *(one.sentence for one in self.derived if one.agents)]

    @property
    def lacks_frames_on_purpose(self) -> bool:
        """Whether frames were left out, however many: a file that was cut off does not say."""
        return any(UNUSED_FRAMES in one.left_out for one in self.derived)

    @property
    def ran_anew(self) -> dict[str, Anew]:
        """The agents whose outputs are not those of the session itself, by name."""
        return {name: anew for one in self.derived for name, anew in one.agents.items()}

    def is_anew(self, kind: str, published_ns: int) -> bool:
        """Whether a message of this kind of agent was made anew that the file repeats from before its beginning."""
        of_kind = [one for one in self.derived if any(name.partition("/")[0] == kind for name in one.agents)]
        return bool(of_kind) and 0 < of_kind[-1].from_ns <= published_ns

    @property
    def sentence(self) -> str:
        """The same in plain words."""
        if self.damage:
            return self.damage
        gaps = ", ".join(f"{count} of {_without_rig(key)}" for key, count in sorted(self.lost.items()))
        if not self.finished:
            until = f"cut off {_when(self.last_ns)}, and whether anything came after is not known"
            return f"{until}; {f'lost {gaps}' if gaps else 'nothing is known to be lost before'}"
        if self.complete:
            left_out = any(one.left_out for one in self.derived)
            return "complete but for what was left out on purpose" if left_out else "complete"
        stopped = f"its recorder stopped early: {self.stopped}" if self.stopped else ""
        why = "; ".join(filter(None, (f"lost {gaps}" if gaps else "", stopped)))
        lost = f"not complete: {why}" if why else "not complete" if self.complete is False else ""
        source = f"its source: {self._of_source}" if self._of_source else ""
        return "; ".join(filter(None, (lost, source))) or UNKNOWN

    @property
    def _of_source(self) -> str:
        """What the file that it was made of said of itself, unless that was complete or nobody knew."""
        said = self.derived[-1].source_said if self.derived else ""
        return "" if said.startswith("complete") or said == UNKNOWN else said


def no_message_in(path: Path, damage: str = "") -> str:
    """Why nothing can be made of a recording that holds no message, as far as it can be read."""
    if damage:
        return f"{damage}, and no message does"
    return f"{path} holds no message" if is_finished(path) else f"{path} is cut off before its first message"


def completeness(path: Path) -> Completeness:
    """What a recording tells of what it lacks; one that was closed is not read for it.

    Raises:
        RecordingError, OSError: as `read_recording`.
    """
    finished = is_finished(path)
    if finished:
        # where the index alone is damaged, the messages can be read all the same
        with contextlib.suppress(RecordingError):
            return completeness_of(finished_notes(path), True, None)
    notes, last_ns, damage = list[Note](), None, ""
    try:
        for record in read_with_notes(path):
            if isinstance(record, Note):
                notes.append(record)
            else:
                last_ns = record.received_ns
    except RecordingError as error:
        if last_ns is None:
            raise
        damage = str(error) if finished else ""
    said = completeness_of(notes, finished, last_ns)
    return replace(said, damage=damage, complete=False if damage else said.complete)


def completeness_of(notes: Iterable[Note], finished: bool, last_ns: int | None) -> Completeness:
    """What the notes of a recording tell of what it lacks."""
    notes = list(notes)
    summed = next((note for note in reversed(notes) if note.name == LOSSES), None)
    lost = Counter[str]()
    for note in [summed] if summed is not None else [note for note in notes if note.name == LOST]:
        lost.update(counts_of(note))
    told = summed.facts.get(COMPLETE) if summed is not None and finished else None
    complete = False if lost else None if told is None else told.lower() == "true"
    stopped = next((note.facts.get(REASON, "") for note in reversed(notes) if note.name == ENDED), "")
    return Completeness(finished, last_ns, dict(lost), complete, derivations(notes), stopped=stopped)


def _without_rig(key: str) -> str:
    """A key of one rig as people write it."""
    return key.split("/", 2)[-1]


def _when(at_ns: int | None) -> str:
    if at_ns is None:
        return "before its first message"
    return datetime.fromtimestamp(at_ns * 1e-9, UTC).astimezone().strftime("at %Y-%m-%d %H:%M:%S.%f")[:-5]
