"""What is killed leaves all but the last moments, and says what was lost."""

import pathlib
import subprocess
import sys

import pytest

from shared.recording.completeness import completeness
from shared.recording.losses import LOSSES
from shared.recording.mcap_file import read_notes, read_recording


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
