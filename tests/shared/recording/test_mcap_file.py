"""Recordings as files: whole, cut off, damaged, foreign."""

import itertools
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

import schemas
from schemas.codec import encode
from schemas.messages import LogLevel, LogRecord
from schemas.topics import COMMANDS, LOG, key
from shared.recording.entry import PROFILE
from shared.recording.mcap_file import (
    Entry,
    Note,
    RecordingError,
    RecordingWriter,
    is_finished,
    read_attachments,
    read_notes,
    read_recording,
    read_with_notes,
    recorded_by,
)

DATA_END = 15
KEY = key("lab", LOG, agent="camera")


def entry(number, epoch=7, name=KEY):
    payload = encode(LogRecord(number, "camera", "main", LogLevel.INFO, "x" * 20))
    return Entry(name, epoch, number, payload, 1000 + number, 2000 + number)


def written(path, entries, notes=None, flush_every=None):
    writer = RecordingWriter(path)
    for number, one in enumerate(entries):
        writer.write(LOG, one)
        if flush_every and number % flush_every == flush_every - 1:
            writer.flush()
    if notes is not None:
        writer.note("losses", notes)
    writer.close()
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a recording of 40 messages in 8 chunks, with notes."""
    entries = [entry(n, epoch=n // 25) for n in range(40)]
    path = written(tmp_path_factory.mktemp("whole") / "a.mcap", entries, {"complete": "True"}, flush_every=5)
    return entries, path.read_bytes()


def test_what_was_written_is_read_in_its_order_with_its_notes_and_runs_told_apart(tmp_path):
    other = key("lab", COMMANDS, agent="planner")
    entries = [entry(n, name=KEY if n % 3 else other) for n in range(20)]
    entries += [entry(n, epoch) for epoch in (2**56 - 1, 5) for n in range(3)]
    path = written(tmp_path / "a.mcap", entries, {KEY: "12", "complete": "False"})
    assert list(read_recording(path)) == entries
    assert Note("losses", {KEY: "12", "complete": "False"}) in list(read_with_notes(path))
    assert read_notes(path, "losses") == {KEY: "12", "complete": "False"}
    assert read_notes(path, "other") is None


def test_any_reader_of_mcap_finds_messages_with_schema_and_key(tmp_path):
    path = written(tmp_path / "a.mcap", [entry(n) for n in range(3)])
    with path.open("rb") as file:
        found = [(s.name, s.encoding, c.topic, m.sequence) for s, c, m in make_reader(file).iter_messages() if s]
    assert found == [("suturegrasp.v1.LogRecord", "protobuf", KEY, n) for n in range(3)]


def test_of_a_file_cut_off_anywhere_what_was_flushed_is_read_and_no_more(whole, tmp_path):
    entries, data = whole
    path, counts = tmp_path / "cut.mcap", []
    for length in itertools.chain(range(0, len(data), 101), range(len(data) - 10, len(data))):
        path.write_bytes(data[:length])
        assert not is_finished(path)
        try:
            found = list(read_recording(path))
        except RecordingError as error:
            # not even the file's own header
            assert length < 100, error
            continue
        assert found == entries[: len(found)]
        counts.append(len(found))
    assert counts == sorted(counts)
    assert set(counts) == set(range(0, 41, 5))
    path.write_bytes(data[: len(data) // 4])
    assert read_notes(path, "losses") is None
    path.write_bytes(data)
    assert is_finished(path)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damage_is_read_around_or_named_and_never_passes_for_a_message(whole, tmp_path_factory, data):
    entries, original = whole
    damaged = bytearray(original)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = Path(tmp_path_factory.getbasetemp() / "damaged.mcap")
    path.write_bytes(bytes(damaged))
    found, fault = [], ""
    try:
        for one in read_recording(path):
            found.append(one)
    except RecordingError as error:
        fault = str(error)
        assert str(path) in fault
        assert "\n" not in fault
    assert [e for e in entries if e in found] == found
    assert fault or found == entries


def test_a_record_whose_kind_is_damaged_does_not_vanish_unnoticed(whole, tmp_path):
    entries, original = whole
    path, at, records = tmp_path / "a.mcap", 8, 0
    while original[at] != DATA_END:
        path.write_bytes(original[:at] + b"\x7f" + original[at + 1 :])
        with pytest.raises(RecordingError):
            assert list(read_recording(path)) == entries
        at += 9 + int.from_bytes(original[at + 1 : at + 9], "little")
        records += 1
    assert records > 16


@settings(max_examples=40, deadline=None)
@given(garbage=st.binary(max_size=200), magic=st.booleans())
def test_anything_else_is_no_recording(tmp_path_factory, garbage, magic):
    path = Path(tmp_path_factory.getbasetemp() / "garbage.mcap")
    path.write_bytes((b"\x89MCAP0\r\n" if magic else b"") + garbage)
    with pytest.raises(RecordingError, match=r"garbage\.mcap is "):
        list(read_recording(path))


def test_a_recording_of_another_program_is_named_as_such(tmp_path):
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="other")
        schema = writer.register_schema("std_msgs/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        writer.add_message(channel, 1, b"1234", 1)
        writer.finish()
    for read in (
        lambda: list(read_recording(path)),
        lambda: read_notes(path, "losses"),
        lambda: read_attachments(path),
    ):
        with pytest.raises(RecordingError, match="MCAP file of another program"):
            read()


@pytest.mark.parametrize("cut_off", [0, 100])
def test_attachments_are_found_whether_or_not_the_end_was_written(cut_off, tmp_path):
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path)
    writer.attach("rig.json", "application/json", b"{}", at_ns=5)
    writer.write(LOG, entry(0))
    writer.attach("rig.json", "application/json", b"the last one", at_ns=6)
    writer.flush()
    writer.close()
    path.write_bytes(path.read_bytes()[: path.stat().st_size - cut_off])
    assert read_attachments(path) == {"rig.json": b"the last one"}


def by_version(path, version, monkeypatch):
    """A recording of one message that says which version made it."""
    with monkeypatch.context() as patched:
        patched.setattr("shared.recording.writer.LIBRARY", f"suturegrasp {version}")
        return written(path, [entry(0)])


def test_a_recording_of_an_older_version_is_read_as_one_of_this(tmp_path, monkeypatch):
    path, asked = by_version(tmp_path / "old.mcap", "0.0.9", monkeypatch), []

    def lifted(name, payload, version):
        asked.append((name, version))
        return payload

    monkeypatch.setattr("shared.recording.mcap_file.lifted", lifted)
    assert list(read_recording(path)) == [entry(0)]
    assert asked == [("LogRecord", (0, 0, 9))]
    assert recorded_by(path) == (0, 0, 9)


def test_a_recording_of_a_version_that_cannot_be_read_is_named(tmp_path, monkeypatch):
    path = by_version(tmp_path / "new.mcap", "9.1.0", monkeypatch)
    for read in (lambda: list(read_recording(path)), lambda: recorded_by(path), lambda: read_notes(path, "losses")):
        with pytest.raises(RecordingError, match=r"new.mcap was recorded by suturegrasp 9.1.0, .* update suturegrasp"):
            read()


def packed(path, compression, size, count=1):
    """A recording of messages of zeros, each a chunk of its own, packed by another program."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, chunk_size=size)
        writer.start(profile=PROFILE, library=f"suturegrasp {schemas.__version__}")
        schema = writer.register_schema("suturegrasp.v1.LogRecord", "protobuf", b"")
        channel = writer.register_channel(KEY, "protobuf", schema, {"epoch": "7"})
        for number in range(count):
            writer.add_message(channel, number + 1, bytes(size), number + 1)
        writer.finish()
    return path


compressions = pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])


@pytest.mark.slow
@compressions
@pytest.mark.parametrize(("size", "count"), [(200 << 20, 1), (8 << 20, 12)])
def test_a_small_file_does_not_grow_without_bound_when_it_is_read(tmp_path, compression, size, count):
    path = packed(tmp_path / "bomb.mcap", compression, size, count)
    assert 100 * path.stat().st_size + (16 << 20) < size * count
    tracemalloc.start()
    with pytest.raises(RecordingError, match=r"bomb\.mcap unpacks to over 100 times its size and 16 MB"):
        list(read_recording(path))
    assert tracemalloc.get_traced_memory()[1] < size * count
    tracemalloc.stop()


@compressions
def test_a_recording_that_another_program_has_packed_is_read(tmp_path, compression):
    (found,) = read_recording(packed(tmp_path / "packed.mcap", compression, 1 << 20))
    assert found.payload == bytes(1 << 20)


def test_attachments_are_found_though_their_index_is_damaged(tmp_path):
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path)
    writer.attach("rig.json", "application/json", b"what was set", 0)
    writer.close()
    whole = path.read_bytes()
    # the last time that the name is written is in the index
    place = whole.rindex(b"rig.json") - 20
    path.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
    assert read_attachments(path) == {"rig.json": b"what was set"}
