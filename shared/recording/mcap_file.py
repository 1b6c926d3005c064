"""Recordings: MCAP files that hold every message as it travelled, with its schema, key, sequence and times.

A channel is one run (epoch) of one key's publisher; its metadata holds the epoch and the delivery class. Records lie in
the order in which the messages were received, so a file is read from front to back, a cut-off one like a whole one.
Channels without an epoch hold what was derived for other programs, and are left out.
"""

import contextlib
import os
import struct
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

import lz4.frame
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.migrations import NewerVersionError, Version, check_readable, lifted, lifted_key, version_of
from schemas.topics import Topic, known_topic
from shared.recording.entry import PROFILE, Entry, Note, RecordingError
from shared.recording.writer import RecordingWriter

__all__ = [
    "Entry",
    "Note",
    "RecordingError",
    "RecordingWriter",
    "finished_notes",
    "is_finished",
    "read_attachments",
    "read_notes",
    "read_recording",
    "read_with_notes",
    "recorded_by",
]

HEAD = struct.Struct("<BQ")
"""Before every record: its opcode and its length."""
GROWS_TIMES, GROWS_BYTES = 100, 16 << 20
"""What packed chunks may unpack to, of the file's size and beyond it. Our recorder packs nothing; raw images of a black
field packed by other programs come to a fortieth, and a whole chunk of ours has a megabyte or one large message."""
EPOCH = "epoch"
"""What the channels of own messages tell; those that were derived for other programs do not."""


def read_recording(path: Path) -> Iterator[Entry]:
    """Every message of a recording in the order in which it was received; of a cut-off file, what was flushed.

    Raises:
        RecordingError: where the file is no recording, or damaged; in the midst of it, after the messages before.
        OSError: where it cannot be opened.
    """
    return (record for record in read_with_notes(path) if isinstance(record, Entry))


def read_with_notes(path: Path) -> Iterator[Entry | Note]:
    """The messages of a recording, and its notes where they lie before, between or after them.

    Raises:
        RecordingError, OSError: as `read_recording`.
    """
    channels: dict[int, Channel] = {}
    with _damage_named(path):
        records = _records(path)
        version = _check_own(next(records), path)
        for record in records:
            if isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                if EPOCH in channel.metadata:
                    yield _entry(channel, record, version)
            elif isinstance(record, Metadata):
                yield Note(record.name, record.metadata)


class UntilDamage:
    """The messages and notes of a recording, as far as it can be read; `damage` says then what broke it off.

    Raises:
        RecordingError, OSError: as `read_recording`, where nothing of it can be read.
    """

    def __init__(self, path: Path) -> None:
        self._path, self.damage = path, ""

    def __iter__(self) -> Iterator[Entry | Note]:
        found = False
        try:
            for record in read_with_notes(self._path):
                found = True
                yield record
        except RecordingError as error:
            if not found:
                raise
            self.damage = str(error)

    def entries(self) -> Iterator[Entry]:
        """The messages alone."""
        return (record for record in self if isinstance(record, Entry))

    def messages(self, *topics: Topic) -> Iterator[tuple[Entry, Any]]:
        """What these topics hold, decoded; messages that cannot be read are left out."""
        for entry in self.entries():
            topic = known_topic(entry.key)
            if topic in topics:
                with contextlib.suppress(MessageError):
                    yield entry, decode(topic.message, entry.payload)


def recorded_by(path: Path) -> Version:
    """The version of the program that recorded a file; its messages are read as those of this version.

    Raises:
        RecordingError, OSError: as `read_recording`; or where it is too new to be read.
    """
    with _damage_named(path):
        return _check_own(next(_records(path)), path)


def is_finished(path: Path) -> bool:
    """Whether a recording was closed, so that nothing was cut off from its end.

    Raises:
        OSError: where it cannot be opened.
    """
    with _opened(path) as file:
        return _ends_as_it_should(file)


def read_notes(path: Path, name: str) -> dict[str, str] | None:
    """The facts that were noted under a name when the recording ended; None where it was cut off before.

    Raises:
        RecordingError, OSError: as `read_recording`.
    """
    found = [note.facts for note in read_with_notes(path) if isinstance(note, Note) and note.name == name]
    return found[-1] if found else None


def finished_notes(path: Path) -> list[Note]:
    """The notes of a recording that was closed, found by its index, without reading its messages.

    Raises:
        RecordingError, OSError: as `read_recording`.
    """
    with _damage_named(path), _opened(path) as file:
        reader = SeekingReader(file, validate_crcs=True)
        _check_own(reader.get_header(), path)
        return [Note(found.name, found.metadata) for found in reader.iter_metadata()]


def read_attachments(path: Path) -> dict[str, bytes]:
    """The files that belong to a recording, by name; the last of each name.

    Of a finished recording they are found by its index, without its messages being read, unless that is damaged.

    Raises:
        RecordingError, OSError: as `read_recording`.
    """
    if is_finished(path):
        with contextlib.suppress(RecordingError), _damage_named(path), _opened(path) as file:
            reader = SeekingReader(file, validate_crcs=True)
            _check_own(reader.get_header(), path)
            return {found.name: found.data for found in reader.iter_attachments()}
    with _damage_named(path):
        return {record.name: record.data for record in _records(path) if isinstance(record, Attachment)}


def _opened(path: Path) -> BinaryIO:
    if path.is_dir():
        raise RecordingError(f"{path} is a folder; name a recording in it, such as session.mcap")
    return path.open("rb")


def _records(path: Path) -> Iterator[McapRecord]:
    """The header, and the records of the data section until its end or where the file was cut off."""
    with _opened(path) as file:
        whole = _Whole(file, _end_of_whole_records(file, path))
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        records = StreamReader(cast(IO[bytes], whole), validate_crcs=True, emit_chunks=True).records
        first = next(records)
        _check_own(first, path)
        yield first
        room = GROWS_TIMES * size + GROWS_BYTES
        try:
            for record in records:
                if not isinstance(record, Chunk):
                    yield record
                    continue
                plain = _unpacked(record, room, path)
                room -= len(plain.data) if record.compression else 0
                yield from breakup_chunk(plain, validate_crc=True)
        except EndOfFile:
            return


def _unpacked(chunk: Chunk, room: int, path: Path) -> Chunk:
    """A chunk whose records can be read, however it was packed; no more is unpacked than there is room for."""
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(room + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=room + 1)
    else:
        return chunk
    if len(data) > room:
        grown = f"{path} unpacks to over {GROWS_TIMES} times its size and {GROWS_BYTES >> 20} MB"
        raise RecordingError(f"{grown}, which no recording does: it is damaged, or made to fill this machine's memory")
    return replace(chunk, compression="", data=data, uncompressed_size=len(data))


def _check_own(first: McapRecord, path: Path) -> Version:
    if not isinstance(first, Header) or first.profile != PROFILE:
        raise RecordingError(f"{path} is an MCAP file of another program; give one that suturegrasp recorded")
    try:
        version = version_of(first.library.rpartition(" ")[2])
        check_readable(version)
    except NewerVersionError as error:
        raise RecordingError(f"{path} was {error}") from None
    return version


def _end_of_whole_records(file: BinaryIO, path: Path) -> int:
    """Where the last whole record of the data section ends."""
    size = file.seek(0, os.SEEK_END)
    finished = _ends_as_it_should(file)
    file.seek(0)
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise RecordingError(f"{path} is no recording; give an MCAP file that suturegrasp recorded")
    opcode, end = 0, file.tell()
    while opcode != Opcode.DATA_END and len(head := file.read(HEAD.size)) == HEAD.size:
        opcode, length = HEAD.unpack(head)
        if end + HEAD.size + length > size:
            break
        end = file.seek(end + HEAD.size + length)
    if finished and opcode != Opcode.DATA_END:
        raise RecordingError(_damaged(path))
    file.seek(0)
    return end


def _ends_as_it_should(file: BinaryIO) -> bool:
    if file.seek(0, os.SEEK_END) < 2 * len(MCAP0_MAGIC):
        return False
    file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
    return file.read() == MCAP0_MAGIC


class _Whole:
    """The whole records of a file that may have been cut off in the midst of one."""

    def __init__(self, file: BinaryIO, end: int) -> None:
        self._file, self._end = file, end

    def read(self, size: int) -> bytes:
        """The next bytes; none at the end."""
        left = self._end - self._file.tell()
        if size < 0 or size > left > 0:
            raise ValueError("a record claims more than there is, or less than nothing")
        return self._file.read(min(size, left))


def _damaged(path: Path) -> str:
    return f"{path} is damaged; only what lies before the damage can be read"


def _entry(channel: Channel, message: Message, version: Version) -> Entry:
    epoch, repeated = int(channel.metadata[EPOCH]), "repeated" in channel.metadata
    key = lifted_key(channel.topic)
    topic = known_topic(key)
    # of a topic that there no longer is, whoever reads says so
    payload = message.data if topic is None else lifted(topic.message.__name__, message.data, version)
    return Entry(key, epoch, message.sequence, payload, message.publish_time, message.log_time, repeated)


@contextmanager
def _damage_named(path: Path) -> Generator[None]:
    """Whatever a reader stumbles over in a file becomes one sentence."""
    try:
        yield
    except (RecordingError, OSError):
        raise
    except (
        McapError,
        struct.error,
        StopIteration,
        LookupError,
        ArithmeticError,
        ValueError,
        RuntimeError,
        MemoryError,
        zstandard.ZstdError,
    ) as error:
        raise RecordingError(_damaged(path)) from error
