"""A loss is told and noted when it happens, so that a killed recorder's file says where it is not complete."""

import pathlib
import subprocess
import sys

import pytest

from shared.recording.completeness import completeness
from shared.recording.losses import LOSSES, LOST
from shared.recording.mcap_file import Note, read_notes, read_recording, read_with_notes


def lost_notes(path):
    return [n.facts for n in read_with_notes(path) if isinstance(n, Note) and n.name == LOST]


def test_a_gap_is_told_and_in_the_file_while_recording_goes_on(record, messages, tmp_path, until):
    lines = []
    recorder = record(tmp_path / "a.mcap", tell=lines.append)
    for number in (0, 1, 5):
        recorder.put(messages.log(number))
    until(lambda: lines)
    assert lines == [f"lost 3 of {messages.camera} (2-4 on the way)"]
    (note,) = until(lambda: lost_notes(tmp_path / "a.mcap"))
    assert note[messages.camera] == "3: 2-4 on the way"
    told = completeness(tmp_path / "a.mcap")
    assert (told.finished, told.complete, told.lost) == (False, False, {messages.camera: 3})
    recorder.close()
    told = completeness(tmp_path / "a.mcap")
    assert (told.finished, told.complete, told.lost) == (True, False, {messages.camera: 3})


def test_losses_that_come_fast_share_lines_and_none_is_left_out_of_the_file(record, messages, tmp_path):
    lines = []
    recorder = record(tmp_path / "a.mcap", tell=lines.append)
    for number in range(0, 4000, 2):
        recorder.put(messages.log(number))
    report = recorder.close()
    assert report.lost == {messages.camera: 1999}
    assert len(lines) <= 2
    counts = [int(facts[messages.camera].split(":")[0]) for facts in lost_notes(report.path)]
    assert sum(counts) == 1999


@pytest.mark.slow
def test_a_killed_recorder_leaves_all_but_the_last_moments_and_says_what_was_lost(tmp_path, until):
    path = tmp_path / "a.mcap"
    process = subprocess.Popen(
        [sys.executable, str(pathlib.Path(__file__).with_name("recording_process.py")), str(path), "10", "14"],
        stdout=subprocess.DEVNULL,
    )

    def held():
        return [entry.sequence for entry in read_recording(path)] if path.exists() else []

    try:
        # the messages are small and slow: by size alone a chunk would not be written within the deadline
        until(lambda: path.exists() and path.stat().st_size > 100 and len(held()) > 20, "messages to be on the disk")
    finally:
        process.kill()
        process.wait()
    numbers = held()
    assert numbers == [n for n in range(numbers[-1] + 1) if n not in range(10, 14)]
    assert path.stat().st_size < 1 << 20
    assert read_notes(path, LOSSES) is None
    told = completeness(path)
    assert (told.finished, told.complete) == (False, False)
    assert list(told.lost.values()) == [4]
    assert "cut off at " in told.sentence
    assert "lost 4 of camera/main/log" in told.sentence
