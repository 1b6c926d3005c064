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
from shared.recording import mcap_file
from shared.recording.entry import PROFILE
from shared.recording.mcap_file import Entry, Note, RecordingError, RecordingWriter, read_notes, read_recording

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


def test_what_was_written_is_read_in_its_order_with_its_notes_and_runs_told_apart_by_any_reader_too(tmp_path):
    other = key("lab", COMMANDS, agent="planner")
    entries = [entry(n, name=KEY if n % 3 else other) for n in range(20)]
    entries += [entry(n, epoch) for epoch in (2**56 - 1, 5) for n in range(3)]
    path = written(tmp_path / "a.mcap", entries, {KEY: "12", "complete": "False"})
    assert list_of(path) == entries
    assert Note("losses", {KEY: "12", "complete": "False"}) in list(mcap_file.read_with_notes(path))
    assert read_notes(path, "losses") == {KEY: "12", "complete": "False"}
    assert read_notes(path, "other") is None
    with path.open("rb") as file:
        found = [(s.name, s.encoding, c.topic, m.sequence) for s, c, m in make_reader(file).iter_messages() if s]
    assert ("suturegrasp.v1.LogRecord", "protobuf", KEY, 19) in found


def test_of_a_file_cut_off_anywhere_what_was_flushed_is_read_and_no_more(whole, tmp_path):
    entries, data = whole
    path, counts = tmp_path / "cut.mcap", []
    for length in itertools.chain(range(0, len(data), 101), range(len(data) - 10, len(data))):
        path.write_bytes(data[:length])
        assert not mcap_file.is_finished(path)
        try:
            found = list_of(path)
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
    assert mcap_file.is_finished(path)


def list_of(path):
    return list(read_recording(path))


def found_or_fault(path):
    """What is read, and what breaks it off in a sentence that names the file."""
    found = []
    try:
        for one in read_recording(path):
            found.append(one)
    except RecordingError as error:
        assert str(path) in str(error)
        assert "\n" not in str(error)
        return found, str(error)
    return found, ""


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damage_is_read_around_or_named_and_never_passes_for_a_message(whole, tmp_path_factory, data):
    entries, original = whole
    damaged = bytearray(original)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = Path(tmp_path_factory.getbasetemp() / "damaged.mcap")
    path.write_bytes(bytes(damaged))
    found, fault = found_or_fault(path)
    assert [e for e in entries if e in found] == found
    assert fault or found == entries


def test_a_recording_of_another_program_is_named_as_such_and_what_is_none_too(tmp_path):
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="other")
        writer.finish()
    for read in (list_of, lambda path: read_notes(path, "a"), mcap_file.read_attachments):
        with pytest.raises(RecordingError, match="MCAP file of another program"):
            read(path)
    for content, said in ((b"text", "is no recording"), (path.read_bytes()[:8], "is damaged")):
        path.write_bytes(content)
        with pytest.raises(RecordingError, match=rf"foreign\.mcap {said}"):
            list_of(path)
    with pytest.raises(RecordingError, match="is a folder; name a recording in it"):
        list(read_recording(tmp_path))


def test_the_last_attachment_of_a_name_is_found_though_the_end_is_cut_off_or_its_index_damaged(tmp_path):
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path)
    writer.attach("rig.json", "application/json", b"{}", at_ns=5)
    writer.write(LOG, entry(0))
    writer.attach("rig.json", "application/json", b"the last one", at_ns=6)
    writer.flush()
    writer.close()
    whole = path.read_bytes()
    # the last time that the name is written is in the index
    place = whole.rindex(b"rig.json") - 20
    for data in (whole, whole[:-100], whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :]):
        path.write_bytes(data)
        assert mcap_file.read_attachments(path) == {"rig.json": b"the last one"}


def test_a_recording_of_an_older_version_is_read_as_one_of_this_and_a_newer_one_refused(tmp_path, monkeypatch):
    def by(version):
        with monkeypatch.context() as patched:
            patched.setattr("shared.recording.writer.LIBRARY", f"suturegrasp {version}")
            return written(tmp_path / f"{version}.mcap", [entry(0)])

    path, asked = by("0.0.9"), []
    monkeypatch.setattr(mcap_file, "lifted", lambda name, payload, version: asked.append((name, version)) or payload)
    assert list_of(path) == [entry(0)]
    assert asked == [("LogRecord", (0, 0, 9))]
    assert mcap_file.recorded_by(path) == (0, 0, 9)
    path = by("9.1.0")
    for read in (list_of, mcap_file.recorded_by, lambda path: read_notes(path, "losses")):
        with pytest.raises(RecordingError, match=r"mcap was recorded by suturegrasp 9.1.0, .* update suturegrasp"):
            read(path)


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


@pytest.mark.slow
@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_what_another_program_has_packed_is_read_but_no_small_file_grows_without_bound(tmp_path, compression):
    (found,) = read_recording(packed(tmp_path / "packed.mcap", compression, 1 << 20))
    assert found.payload == bytes(1 << 20)
    for size, count in ((200 << 20, 1), (8 << 20, 12)):
        path = packed(tmp_path / "bomb.mcap", compression, size, count)
        assert 100 * path.stat().st_size + (16 << 20) < size * count
        tracemalloc.start()
        with pytest.raises(RecordingError, match=r"bomb\.mcap unpacks to over 100 times its size and 16 MB"):
            list_of(path)
        assert tracemalloc.get_traced_memory()[1] < size * count
        tracemalloc.stop()
