"""The recorder on messages put by hand, behind a real router, and on a full disk."""

import pathlib
import threading
from typing import Any

import numpy as np
import pytest

from agents.recorder.recorder import LOSSES
from schemas.codec import encode
from schemas.messages import FrameStamp, Image, ImageEncoding, LogLevel, LogRecord, StereoFrame
from schemas.topics import FRAMES, LOG, PLAN, TOPICS, key
from shared.recording.mcap_file import RecordingWriter, read_notes, read_recording
from shared.runtime.agent import Agent, Output
from shared.runtime.attachment import Attachment, pack
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher
from shared.runtime.taps import Tapped

CAMERA, OTHER = key("lab", LOG, agent="camera"), key("lab", LOG, agent="planner")
IMAGE = Image(ImageEncoding.RAW, 64, 48, 3, bytes(64 * 48 * 3))


def tapped(number, name=CAMERA, epoch=1, numbered=True):
    payload = encode(LogRecord(number, "camera", "main", LogLevel.INFO, "text"))
    return Tapped(LOG, name, payload, Attachment(epoch, number, 1000 + number, 0.0) if numbered else None)


def places(path):
    return [(entry.key, entry.epoch, entry.sequence) for entry in read_recording(path)]


@pytest.fixture
def stuck(monkeypatch):
    """A disk that answers only once the event is set."""
    going = threading.Event()
    write = RecordingWriter.write
    monkeypatch.setattr(RecordingWriter, "write", lambda *a: (going.wait(60.0), write(*a))[1])
    yield going
    going.set()


def test_everything_is_read_back_as_it_was_put(record, tmp_path):
    recorder = record(tmp_path / "a.mcap")
    put = [tapped(n, name) for n in range(50) for name in (CAMERA, OTHER)]
    for one in put:
        recorder.put(one)
    report = recorder.close()
    assert report.complete
    assert report.received == {CAMERA: 50, OTHER: 50}
    found = list(read_recording(report.path))
    assert [(e.key, e.payload) for e in found] == [(t.key, t.payload) for t in put]
    assert [(e.epoch, e.sequence, e.published_ns) for e in found] == [
        (t.beside.epoch, t.beside.sequence, t.beside.published_ns) for t in put if t.beside
    ]
    received = [e.received_ns for e in found]
    assert received == sorted(received)
    assert read_notes(report.path, LOSSES) == {"complete": "True"}


def test_gaps_are_counted_by_key_and_written_into_the_file(record, tmp_path):
    recorder = record(tmp_path / "a.mcap")
    for number in (0, 1, 4, 5, 9):
        recorder.put(tapped(number))
    for number in (7, 8):
        recorder.put(tapped(number, OTHER))
    # Zenoh tells of gaps too: those of a key that was heard are counted already
    recorder.missed(LOG, 3)
    recorder.missed(PLAN, 2)
    report = recorder.close()
    assert report.lost == {CAMERA: 2 + 3, str(PLAN): 2}
    assert not report.complete
    assert read_notes(report.path, LOSSES) == {CAMERA: "5", str(PLAN): "2", "complete": "False"}


def test_a_publisher_that_restarted_has_lost_nothing_and_what_has_no_number_is_left_out(record, tmp_path):
    recorder = record(tmp_path / "a.mcap")
    for epoch in (5, 3):
        for number in range(3):
            recorder.put(tapped(number, epoch=epoch))
    assert recorder.report().lost == {}
    recorder.put(tapped(3, epoch=3, numbered=False))
    report = recorder.close()
    assert (report.lost, report.unnumbered, report.complete) == ({}, 1, False)
    assert places(report.path) == [(CAMERA, epoch, n) for epoch in (5, 3) for n in range(3)]


def test_behind_a_slow_disk_nobody_waits_and_what_finds_no_room_is_counted(record, tmp_path, stuck):
    recorder = record(tmp_path / "a.mcap", queue_limit=10)
    # a gap on the way and an overflow add up
    for number in (*range(40), *range(45, 60)):
        recorder.put(tapped(number))
    stuck.set()
    report = recorder.close()
    held = places(report.path)
    assert report.received == {CAMERA: len(held)}
    assert report.lost == {CAMERA: 60 - len(held)}
    assert 10 <= len(held) <= 12
    assert read_notes(report.path, LOSSES) == {CAMERA: str(60 - len(held)), "complete": "False"}


def test_on_a_full_disk_the_recorder_ends_and_its_report_says_why(record, until):
    full = pathlib.Path("/dev/full")
    if not full.exists():
        pytest.skip("needs /dev/full")
    recorder, numbers = record(full), iter(range(1_000_000))

    def ended():
        recorder.put(tapped(next(numbers)))
        return recorder.ended.is_set()

    until(ended)
    report = recorder.close()
    assert report.fault == "/dev/full cannot be written: No space left on device"
    assert not report.complete


def test_closing_twice_is_closing_once_and_nothing_is_recorded_after(record, tmp_path):
    recorder = record(tmp_path / "a.mcap")
    recorder.put(tapped(0))
    first = recorder.close()
    recorder.put(tapped(1))
    assert recorder.close() == first
    assert places(first.path) == [(CAMERA, 1, 0)]


class Film(Agent):
    kind, instance, inputs, outputs, commands, tick_hz = "camera", "main", (), (FRAMES,), (), 50.0

    def __init__(self):
        self.sent = 0

    def step(self, arrived: Any):
        image = Image(ImageEncoding.RAW, 64, 48, 3, np.full((48, 64, 3), self.sent % 256, np.uint8).tobytes())
        yield Output(FRAMES, StereoFrame(FrameStamp(self.sent, arrived.now_ns, arrived.now_ns, ""), image, image))
        self.sent += 1


@pytest.mark.slow
def test_everything_of_a_live_run_is_read_back_identically(settings, running, record, tmp_path, until):
    heard = []
    with connected(settings, 60.0) as connection:
        recorder = record(tmp_path / "live.mcap")

        def receive(one):
            heard.append(one)
            recorder.put(one)

        connection.listen(TOPICS, receive, recorder.missed)
        running(Film())
        until(lambda: sum(t.topic is FRAMES for t in heard) > 50)
    report = recorder.close()
    assert report.lost == {}
    found = [(e.key, e.epoch, e.sequence, e.payload, e.published_ns) for e in read_recording(report.path)]
    expected = [(t.key, t.beside.epoch, t.beside.sequence, t.payload, t.beside.published_ns) for t in heard]
    assert sorted(found) == sorted(expected)
    for name in report.received:
        assert [f for f in found if f[0] == name] == [e for e in expected if e[0] == name]


def test_a_gap_between_publisher_and_recorder_is_counted(settings, session, record, tmp_path, until, heard_by_others):
    publisher = declare_publisher(session, key(settings.rig, PLAN), LOG)
    with connected(settings, 60.0) as connection:
        recorder = record(tmp_path / "live.mcap")
        connection.listen((PLAN,), recorder.put, recorder.missed)
        heard_by_others(session, key(settings.rig, PLAN))
        for number in (0, 1, 5):
            publisher.put(b"payload", attachment=pack(Attachment(3, number, 0, 0.0)))
        until(lambda: sum(recorder.report().received.values()) == 3)
    assert recorder.close().lost == {key(settings.rig, PLAN): 3}
    publisher.undeclare()


def test_runs_beyond_those_that_a_file_can_tell_apart_are_lost_alone_and_named(record, tmp_path, monkeypatch):
    monkeypatch.setattr("shared.recording.writer.MOST_RUNS", 3)
    recorder = record(tmp_path / "a.mcap")
    for epoch in (1, 2, 3, 4, 5, 3):
        recorder.put(tapped(epoch, epoch=epoch))
    report = recorder.close()
    assert [epoch for _, epoch, _ in places(report.path)] == [1, 2, 3, 3]
    assert (report.lost, report.fault) == ({CAMERA: 2}, "")
