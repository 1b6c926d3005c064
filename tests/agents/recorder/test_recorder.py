"""The recorder on messages put by hand, behind a real router, and on a full disk."""

import pathlib
import threading

from agents.recorder.recorder import LOSSES
from schemas.topics import LOG, PLAN, key
from shared.recording.completeness import completeness
from shared.recording.losses import LOST
from shared.recording.mcap_file import Note, RecordingWriter, read_notes, read_recording, read_with_notes
from shared.runtime.attachment import Attachment, pack
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher

CAMERA, OTHER = key("lab", LOG, agent="camera"), key("lab", LOG, agent="planner")


def places(path):
    return [(entry.key, entry.epoch, entry.sequence) for entry in read_recording(path)]


def lost_notes(path):
    return [n.facts[CAMERA] for n in read_with_notes(path) if isinstance(n, Note) and n.name == LOST]


def test_everything_is_read_back_as_it_was_put_until_it_is_closed(record, messages, tmp_path):
    recorder = record(tmp_path / "a.mcap")
    put = [messages.log(n, agent=agent) for n in range(50) for agent in ("camera", "planner")]
    for one in put:
        recorder.put(one)
    report = recorder.close()
    recorder.put(messages.log(50))
    assert recorder.close() == report
    assert (report.complete, report.received) == (True, {CAMERA: 50, OTHER: 50})
    found = list(read_recording(report.path))
    assert [(e.key, e.payload) for e in found] == [(t.key, t.payload) for t in put]
    assert [(e.epoch, e.sequence, e.published_ns) for e in found] == [
        (t.beside.epoch, t.beside.sequence, t.beside.published_ns) for t in put if t.beside
    ]
    received = [e.received_ns for e in found]
    assert received == sorted(received)
    assert read_notes(report.path, LOSSES) == {"complete": "True"}


def test_gaps_are_counted_by_key_and_written_into_the_file(record, messages, tmp_path):
    recorder = record(tmp_path / "a.mcap")
    for number in (0, 1, 4, 5, 9):
        recorder.put(messages.log(number))
    for number in (7, 8):
        recorder.put(messages.log(number, agent="planner"))
    # Zenoh tells of gaps too: those of a key that was heard are counted already
    recorder.missed(LOG, 3)
    recorder.missed(PLAN, 2)
    report = recorder.close()
    assert report.lost == {CAMERA: 2 + 3, str(PLAN): 2}
    assert not report.complete
    assert read_notes(report.path, LOSSES) == {CAMERA: "5", str(PLAN): "2", "complete": "False"}


def test_a_publisher_that_restarted_has_lost_nothing_and_what_has_no_number_is_left_out(record, messages, tmp_path):
    recorder = record(tmp_path / "a.mcap")
    for epoch in (5, 3):
        for number in range(3):
            recorder.put(messages.log(number, epoch=epoch))
    recorder.put(messages.log(3, epoch=3, numbered=False))
    report = recorder.close()
    assert (report.lost, report.unnumbered, report.complete) == ({}, 1, False)
    assert places(report.path) == [(CAMERA, epoch, n) for epoch in (5, 3) for n in range(3)]


def test_behind_a_slow_disk_nobody_waits_and_what_finds_no_room_is_counted(record, messages, tmp_path, monkeypatch):
    going, write = threading.Event(), RecordingWriter.write
    monkeypatch.setattr(RecordingWriter, "write", lambda *a: (going.wait(60.0), write(*a))[1])
    recorder = record(tmp_path / "a.mcap", queue_limit=10)
    # a gap on the way and an overflow add up
    for number in (*range(40), *range(45, 60)):
        recorder.put(messages.log(number))
    going.set()
    report = recorder.close()
    held = places(report.path)
    assert report.received == {CAMERA: len(held)}
    assert report.lost == {CAMERA: 60 - len(held)}
    assert 10 <= len(held) <= 12
    assert read_notes(report.path, LOSSES) == {CAMERA: str(60 - len(held)), "complete": "False"}


def test_on_a_full_disk_the_recorder_ends_and_its_report_says_why(record, messages, until):
    recorder, numbers = record(pathlib.Path("/dev/full")), iter(range(1_000_000))

    def ended():
        recorder.put(messages.log(next(numbers)))
        return recorder.ended.is_set()

    until(ended)
    report = recorder.close()
    assert report.fault == "/dev/full cannot be written: No space left on device"
    assert not report.complete


def test_a_gap_between_publisher_and_recorder_is_counted(settings, session, record, tmp_path, until, heard_by_others):
    name = key(settings.rig, PLAN)
    publisher = declare_publisher(session, name, LOG)
    with connected(settings, 60.0) as connection:
        recorder = record(tmp_path / "live.mcap")
        connection.listen((PLAN,), recorder.put, recorder.missed)
        heard_by_others(session, name)
        for number in (0, 1, 5):
            publisher.put(b"payload", attachment=pack(Attachment(3, number, 0, 0.0)))
        until(lambda: sum(recorder.report().received.values()) == 3)
    assert recorder.close().lost == {name: 3}
    publisher.undeclare()


def test_runs_beyond_those_that_a_file_can_tell_apart_are_lost_alone_and_named(record, messages, tmp_path, monkeypatch):
    monkeypatch.setattr("shared.recording.writer.MOST_RUNS", 3)
    recorder = record(tmp_path / "a.mcap")
    for epoch in (1, 2, 3, 4, 5, 3):
        recorder.put(messages.log(epoch, epoch=epoch))
    report = recorder.close()
    assert [epoch for _, epoch, _ in places(report.path)] == [1, 2, 3, 3]
    assert (report.lost, report.fault) == ({CAMERA: 2}, "")


def test_a_gap_is_told_and_in_the_file_while_recording_goes_on(record, messages, tmp_path, until):
    lines, path = [], tmp_path / "a.mcap"
    recorder = record(path, tell=lines.append)
    for number in (0, 1, 5):
        recorder.put(messages.log(number))
    until(lambda: lines)
    assert lines == [f"lost 3 of {CAMERA} (2-4 on the way)"]
    # were it killed now, the file would hold all of that
    until(lambda: path.stat().st_size and [number for _, _, number in places(path)] == [0, 1, 5])
    assert lost_notes(path) == ["3: 2-4 on the way"]
    assert "cut off at " in completeness(path).sentence
    for finished in (False, True):
        told = completeness(path)
        assert (told.finished, told.complete, told.lost) == (finished, False, {CAMERA: 3})
        recorder.close()
