"""Files that are made of recordings: they open as a recorder's own do, and say what was done to them."""

import mimetypes
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import schemas
from agents.recorder.foxglove import FoxgloveCopies
from schemas.topics import Topic
from shared.recording.completeness import Completeness
from shared.recording.derivation import BEGUN, DERIVED, Derivation, as_far_as_held, digest_of, unfinished_of
from shared.recording.entry import Entry, Note
from shared.recording.foxglove_schemas import DESCRIPTORS
from shared.recording.losses import COMPLETE, LOSSES
from shared.recording.mcap_file import recorded_by
from shared.recording.writer import RecordingWriter


class DerivedFile:
    """Writes a derived recording, with the copies that other programs show.

    Raises:
        OSError: where it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._writer, self._copies = RecordingWriter(path), FoxgloveCopies()
        self._notes, self._held = list[Note](), defaultdict[str, list[int]](list)

    def write(self, topic: Topic, entry: Entry) -> None:
        """Add a message."""
        self._writer.write(topic, entry)
        if not entry.repeated:
            self._held[entry.key].append(entry.received_ns)
        for copy in self._copies.of(topic, entry):
            self._writer.write_derived(copy.channel, copy.schema, DESCRIPTORS, copy.payload, entry)

    def begin(self, derivation: Derivation, attached: Mapping[str, bytes]) -> None:
        """Say what the file is made of, as far as that is known, for one that is cut off before its end."""
        for name, data in attached.items():
            self._writer.attach(name, mimetypes.guess_type(name)[0] or "application/octet-stream", data, 0)
        self._writer.note(BEGUN, derivation.note.facts)

    def note(self, note: Note) -> None:
        """Add a note of the source; what sums up the source is left to `close`.

        So is how many of its messages an agent that ran anew has made; meanwhile the source's derivation is begun.
        """
        if note.name != LOSSES:
            self._notes.append(note)
            self._writer.note(BEGUN if note.name == DERIVED else note.name, note.facts)

    def close(self, derivation: Derivation, complete: bool | None, lost: Mapping[str, int]) -> None:
        """Say what the file was made of and what it lacks, and finish it.

        A source that was cut off has only said at its beginning what it was made of.
        """
        told = [note for note in self._notes if note.name == DERIVED]
        for note in (*told, *unfinished_of(self._notes)):
            self._writer.note(DERIVED, as_far_as_held(note, self._held).facts)
        self._writer.note(DERIVED, derivation.note.facts)
        known = {} if complete is None else {COMPLETE: str(complete and not lost)}
        self._writer.note(LOSSES, {key: str(count) for key, count in lost.items()} | known)
        self._writer.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._writer.abandon()


def derived_from(source: Path, said: Completeness, how: str, **told: Any) -> Derivation:
    """How a file is derived from another, as that is now.

    Raises:
        RecordingError, OSError: as `read_recording`.
    """
    version = ".".join(map(str, recorded_by(source)))
    read_as = "" if version == schemas.__version__ else version
    return Derivation(how, source.name, digest_of(source), said.sentence, read_as=read_as, **told)
