"""Writing recordings: own messages, what others can read of them, notes, attachments.

Nothing is compressed: nearly all bytes are images, which are compressed already or full of noise. LZ4 took most of the
time that writing raw images takes, and saved none of their bytes.
"""

import contextlib
import functools
from pathlib import Path

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.writer import CompressionType, Writer

import schemas
from schemas.codec import encoding_name
from schemas.topics import Topic
from schemas.wire import descriptors_of
from shared.recording.entry import PROFILE, Entry

LIBRARY = f"suturegrasp {schemas.__version__}"
CHUNK_BYTES = 1 << 20
MASK = 0xFFFFFFFF
"""MCAP keeps the lower 32 bits of a sequence number: years at the highest rate of one run."""
MOST_RUNS = 50_000
"""Runs of publishers in one file, each of which is a channel; MCAP numbers channels with 16 bits."""


class TooManyRunsError(ValueError):
    """A message of yet another run, as only somebody sends who makes runs up; it alone is not written."""


class RecordingWriter:
    """Writes one recording; `close` writes its summary, and what was flushed before a crash can still be read.

    Raises:
        OSError: where the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._writer = Writer(
            self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.NONE, enable_data_crcs=True
        )
        self._writer.start(profile=PROFILE, library=LIBRARY)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, int, bool], int] = {}
        self._derived: dict[str, int] = {}
        self.bytes_written = 0
        """Of messages; what the file holds besides is small."""

    def write(self, topic: Topic, entry: Entry) -> None:
        """Add a message.

        Raises:
            TooManyRunsError: where the file has no room for its publisher's run.
        """
        self._add(self._channel(topic, entry), entry, entry.sequence, entry.payload)

    def write_derived(self, channel: str, schema: str, descriptors: bytes, payload: bytes, entry: Entry) -> None:
        """Add what was made from a message for other programs to read, of another package's schema.

        `read_recording` leaves it out.
        """
        if channel not in self._derived:
            facts = {"derived_from": entry.key}
            self._derived[channel] = self._writer.register_channel(
                channel, "protobuf", self._schema(schema, descriptors), facts
            )
        self._add(self._derived[channel], entry, entry.sequence, payload)

    def note(self, name: str, facts: dict[str, str]) -> None:
        """Add a record of facts about the recording."""
        self._writer.add_metadata(name, facts)

    def attach(self, name: str, media_type: str, data: bytes, at_ns: int) -> None:
        """Add a file that belongs to the recording."""
        self._writer.add_attachment(at_ns, at_ns, name, media_type, data)

    def flush(self) -> None:
        """Hand everything so far to the system, so that it outlives this process."""
        self._writer.flush()

    def close(self) -> None:
        """Finish the file."""
        try:
            self._writer.finish()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, whatever the disk says to what is still to be written."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _add(self, channel: int, entry: Entry, sequence: int, payload: bytes) -> None:
        self.bytes_written += len(payload)
        self._writer.add_message(
            channel_id=channel,
            log_time=entry.received_ns,
            publish_time=entry.published_ns,
            sequence=sequence & MASK,
            data=payload,
        )

    def _channel(self, topic: Topic, entry: Entry) -> int:
        run = entry.key, entry.epoch, entry.repeated
        if run not in self._channels:
            if len(self._channels) >= MOST_RUNS:
                raise TooManyRunsError(f"{entry.key}: more than {MOST_RUNS} runs of publishers are in this file")
            name = topic.message.__name__
            schema = self._schema(f"suturegrasp.v1.{name}", _descriptor_set(name))
            facts = {
                "epoch": str(entry.epoch),
                "delivery": topic.delivery.name.lower(),
                "encoding": encoding_name(topic.message),
            }
            if entry.repeated:
                facts["repeated"] = "true"
            self._channels[run] = self._writer.register_channel(entry.key, "protobuf", schema, facts)
        return self._channels[run]

    def _schema(self, name: str, descriptors: bytes) -> int:
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(name, "protobuf", descriptors)
        return self._schemas[name]


@functools.cache
def _descriptor_set(message: str) -> bytes:
    return FileDescriptorSet(file=[descriptors_of(message)]).SerializeToString(deterministic=True)
