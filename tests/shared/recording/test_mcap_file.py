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


def entry(number, epoch=7, size=20, name=KEY):
    payload = encode(LogRecord(number, "camera", "main", LogLevel.INFO, "x" * size))
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


def test_what_was_written_is_read_in_its_order(tmp_path):
    other = key("lab", COMMANDS, agent="planner")
    entries = [entry(n, name=KEY if n % 3 else other) for n in range(100)]
    assert list(read_recording(written(tmp_path / "a.mcap", entries))) == entries


def test_runs_of_a_publisher_that_restarted_are_told_apart(tmp_path):
    entries = [entry(n, epoch) for epoch in (2**56 - 1, 5) for n in range(3)]
    assert list(read_recording(written(tmp_path / "a.mcap", entries))) == entries


def test_a_recording_without_messages_is_empty(tmp_path):
    assert list(read_recording(written(tmp_path / "a.mcap", []))) == []


def test_notes_are_read_back(tmp_path):
    path = written(tmp_path / "a.mcap", [entry(0)], {"suturegrasp/lab/camera/main/frames": "12", "complete": "False"})
    assert read_notes(path, "losses") == {"suturegrasp/lab/camera/main/frames": "12", "complete": "False"}
    assert read_notes(path, "other") is None


def test_any_reader_of_mcap_finds_messages_with_schema_and_key(tmp_path):
    path = written(tmp_path / "a.mcap", [entry(n) for n in range(3)])
    with path.open("rb") as file:
        found = [(s.name, s.encoding, c.topic, m.sequence) for s, c, m in make_reader(file).iter_messages() if s]
    assert found == [("suturegrasp.v1.LogRecord", "protobuf", KEY, n) for n in range(3)]


def test_of_a_file_cut_off_anywhere_what_was_flushed_is_read_and_no_more(whole, tmp_path):
    entries, data = whole
    path, counts = tmp_path / "cut.mcap", []
    for length in itertools.chain(range(8, len(data), 37), range(len(data) - 40, len(data))):
        path.write_bytes(data[:length])
        try:
            found = list(read_recording(path))
        except RecordingError as error:
            # not even the file's own header
            assert length < 100, error
            continue
        assert found == entries[: len(found)]
        assert len(found) % 5 == 0
        counts.append(len(found))
    assert counts == sorted(counts)
    assert set(counts) == set(range(0, 41, 5))


def test_a_cut_off_recording_has_no_notes(whole, tmp_path):
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[1][: len(whole[1]) // 4])
    assert read_notes(path, "losses") is None


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


def test_a_file_that_is_not_there_is_the_systems_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        list(read_recording(tmp_path / "none.mcap"))


def test_notes_come_with_the_messages_in_one_reading(tmp_path):
    entries = [entry(n) for n in range(3)]
    path = written(tmp_path / "a.mcap", entries, {"complete": "True"})
    read = list(read_with_notes(path))
    # a note is in the file at once, and messages once their chunk is full
    assert [one for one in read if isinstance(one, Note)] == [Note("losses", {"complete": "True"})]
    assert [one for one in read if isinstance(one, Entry)] == entries


def test_whether_a_recording_was_closed_is_told_from_its_end(whole, tmp_path):
    path = tmp_path / "cut.mcap"
    for length in (0, 7, 8, 16, len(whole[1]) // 2, len(whole[1]) - 1, len(whole[1])):
        path.write_bytes(whole[1][:length])
        assert is_finished(path) == (length == len(whole[1]))


@pytest.mark.parametrize("cut_off", [0, 1, 100])
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


def by_version(path, library, monkeypatch):
    """A recording of one message that says it was made by that program."""
    with monkeypatch.context() as patched:
        patched.setattr("shared.recording.writer.LIBRARY", library)
        return written(path, [entry(0)])


def test_a_recording_of_an_older_version_is_read_as_one_of_this(tmp_path, monkeypatch):
    path = by_version(tmp_path / "old.mcap", "suturegrasp 0.0.9", monkeypatch)
    asked = []

    def lifted(name, payload, version):
        asked.append((name, version))
        return payload + b""

    monkeypatch.setattr("shared.recording.mcap_file.lifted", lifted)
    assert list(read_recording(path)) == [entry(0)]
    assert asked == [("LogRecord", (0, 0, 9))]
    assert recorded_by(path) == (0, 0, 9)


def test_a_recording_of_a_version_that_cannot_be_read_is_named(tmp_path, monkeypatch):
    path = by_version(tmp_path / "new.mcap", "suturegrasp 9.1.0", monkeypatch)
    for read in (lambda: list(read_recording(path)), lambda: recorded_by(path), lambda: read_notes(path, "losses")):
        with pytest.raises(RecordingError, match=r"new.mcap was recorded by suturegrasp 9.1.0, .* update suturegrasp"):
            read()


def packed(path, compression, size):
    """A recording of one message of zeros, packed by another program; how large it is."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, chunk_size=1 << 30)
        writer.start(profile=PROFILE, library=f"suturegrasp {schemas.__version__}")
        schema = writer.register_schema("suturegrasp.v1.LogRecord", "protobuf", b"")
        channel = writer.register_channel(KEY, "protobuf", schema, {"epoch": "7"})
        writer.add_message(channel, 1, bytes(size), 1)
        writer.finish()
    return path.stat().st_size


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_small_file_does_not_grow_without_bound_when_it_is_read(tmp_path, compression):
    path = tmp_path / "bomb.mcap"
    size, unpacked = packed(path, compression, 200 << 20), 200 << 20
    assert size < unpacked / 200
    tracemalloc.start()
    with pytest.raises(RecordingError, match=r"bomb\.mcap unpacks to over 100 times its size and 16 MB"):
        list(read_recording(path))
    assert tracemalloc.get_traced_memory()[1] < unpacked
    tracemalloc.stop()


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_recording_that_another_program_has_packed_is_read(tmp_path, compression):
    path = tmp_path / "packed.mcap"
    packed(path, compression, 1 << 20)
    (entry,) = read_recording(path)
    assert entry.payload == bytes(1 << 20)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_what_many_chunks_grow_to_together_is_bounded_too(tmp_path, compression):
    path, each, count = tmp_path / "bombs.mcap", 8 << 20, 12
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, chunk_size=each)
        writer.start(profile=PROFILE, library=f"suturegrasp {schemas.__version__}")
        schema = writer.register_schema("suturegrasp.v1.LogRecord", "protobuf", b"")
        channel = writer.register_channel(KEY, "protobuf", schema, {"epoch": "7"})
        for number in range(count):
            writer.add_message(channel, number + 1, bytes(each), number + 1)
        writer.finish()
    assert 100 * path.stat().st_size + (16 << 20) < each * count
    with pytest.raises(RecordingError, match=r"bombs\.mcap unpacks to over 100 times its size and 16 MB"):
        list(read_recording(path))
