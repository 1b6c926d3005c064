"""Freezes the schema of a version that is about to be released: `python -m tests.schemas.freeze session.mcap`.

Beside this file, in released/{version}, it writes `schema.txt`, a line for every field and every value of an enum, and
`recording.mcap`, the first message of each key of a recorded session. The tests of released versions read both for
ever. Whoever changes a schema before its release freezes it anew with --again, which keeps the messages of topics that
the session lacks.
"""

import argparse
import sys
from pathlib import Path

from google.protobuf.descriptor import FieldDescriptor

import schemas
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.topics import HEALTH, LOG, topic_of
from schemas.wire import descriptor
from shared.recording.mcap_file import Entry, RecordingWriter, read_recording

RELEASED = Path(__file__).with_name("released")
KINDS = {getattr(FieldDescriptor, name): name[5:].lower() for name in dir(FieldDescriptor) if name.startswith("TYPE_")}
OFTEN = 2
"""Of health and log, which every agent has, so many keys are kept."""


def schema_lines():
    """Every field and every value of an enum as a line: name, number, and what it holds."""
    wire = descriptor()
    for message in wire.message_types_by_name.values():
        for field in message.fields:
            held = field.message_type or field.enum_type
            kind = held.name if held else KINDS[field.type]
            label = "repeated " if field.is_repeated else "optional " if field.has_presence and not held else ""
            yield f"{message.name}.{field.name} = {field.number}: {label}{kind}"
    for enum in wire.enum_types_by_name.values():
        for value in enum.values:
            yield f"{enum.name}.{value.name} = {value.number}"


def one_of_each(recording):
    """The first message of each key that can be read and, where it has a status, is no failure."""
    kept = dict[str, Entry]()
    for entry in read_recording(recording):
        topic = topic_of(entry.key)
        if entry.key in kept or sum(topic_of(k) is topic for k in kept) >= (OFTEN if topic in (HEALTH, LOG) else 9):
            continue
        try:
            message = decode(topic.message, entry.payload)
        except MessageError:
            continue
        if getattr(message, "reason", "") == "":
            kept[entry.key] = entry
    return kept.values()


def freeze(recording, again):
    """Write the folder of this version."""
    folder = RELEASED / schemas.__version__
    if folder.exists() and not again:
        sys.exit(f"{folder} exists already: a released version never changes (--again before its release)")
    path = folder / "recording.mcap"
    kept = list(one_of_each(path)) if path.exists() else []
    have = {topic_of(entry.key) for entry in kept}
    new = [entry for entry in one_of_each(recording) if topic_of(entry.key) not in have]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "schema.txt").write_text("".join(f"{line}\n" for line in sorted(schema_lines())))
    path.unlink(missing_ok=True)
    writer = RecordingWriter(path)
    for entry in (*kept, *new):
        writer.write(topic_of(entry.key), entry)
    writer.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--again", action="store_true")
    options = parser.parse_args()
    freeze(options.recording, options.again)
