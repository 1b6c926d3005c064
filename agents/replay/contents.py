"""What a recording holds, from one pass over it: how many messages of which keys, when, and where it is damaged."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import CommandRecord
from schemas.topics import COMMANDS, TOPICS, Topic, topic_of
from shared.recording.completeness import no_message_in
from shared.recording.mcap_file import Entry, RecordingError, read_recording

LONGEST_COMMAND_NS = 10 * 10**9


@dataclass(frozen=True)
class PastCommand:
    """A command that was carried out or refused: when its receiver got it, and what it was."""

    at_ns: int
    topic: Topic
    instance: str
    message: Any


@dataclass
class Contents:
    """What a recording holds.

    Fields:
        counts: messages by key, of keys that the topic table knows.
        commands: those of which the recording holds the records of whoever received them.
        unknown: messages by key, of keys that it does not know.
        first_ns, last_ns: when the first and the last message were received.
        zero_ns: when the first one was published, which seconds are counted from.
        damage: what keeps the rest from being read; empty where all of it can be.
    """

    counts: Counter[str] = field(default_factory=Counter[str])
    commands: list[PastCommand] = field(default_factory=list[PastCommand])
    unknown: Counter[str] = field(default_factory=Counter[str])
    first_ns: int = 0
    zero_ns: int = 0
    last_ns: int = 0
    damage: str = ""

    @property
    def commands_by_topic(self) -> Counter[str]:
        """How many commands of each topic it holds."""
        return Counter(str(command.topic) for command in self.commands)

    @property
    def rigs(self) -> tuple[str, ...]:
        """The rigs whose messages it holds, that with the most first."""
        rigs: Counter[str] = Counter()
        for key, count in self.counts.items():
            rigs[key.split("/")[1]] += count
        return tuple(rig for rig, _ in rigs.most_common())


def contents_of(path: Path) -> Contents:
    """Look through a recording.

    Raises:
        RecordingError: where nothing of it can be read.
        OSError: where it cannot be opened.
    """
    contents, empty, begun = Contents(), True, False
    try:
        for entry in read_recording(path):
            # what is repeated from before the file began is older than its first moment
            contents.first_ns = contents.first_ns if begun else entry.received_ns
            contents.zero_ns = contents.zero_ns if begun else entry.at_ns
            contents.last_ns, empty, begun = entry.received_ns, False, begun or not entry.repeated
            _count(contents, entry)
    except RecordingError as error:
        if empty:
            raise
        contents.damage = str(error)
    if empty:
        raise RecordingError(no_message_in(path))
    return contents


def readable(path: Path) -> Iterator[Entry]:
    """The messages of a recording as far as it can be read."""
    try:
        yield from read_recording(path)
    except RecordingError:
        return


def known_topic(key: str) -> Topic | None:
    """The topic of a key; None where the table has none."""
    try:
        return topic_of(key)
    except KeyError:
        return None


def _count(contents: Contents, entry: Entry) -> None:
    known = known_topic(entry.key)
    (contents.counts if known is not None else contents.unknown)[entry.key] += 1
    command = _command(entry) if known is COMMANDS else None
    if command is not None:
        contents.commands.append(command)


def _command(entry: Entry) -> PastCommand | None:
    """The command that a record tells of; None where it cannot be read."""
    try:
        record = decode(CommandRecord, entry.payload)
        topic = next((topic for topic in TOPICS if str(topic) == record.topic), None)
        if topic is None:
            return None
        message = decode(topic.message, record.payload)
    except MessageError:
        return None
    # the record is published when the command has been carried out; clocks of two machines may be apart
    between_ns = entry.received_ns - record.received_ns
    at_ns = record.received_ns if 0 <= between_ns < LONGEST_COMMAND_NS else entry.received_ns
    return PastCommand(at_ns, topic, entry.key.split("/")[3], message)
