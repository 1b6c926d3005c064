"""A recording ends before the disk is full: a small one, where one can be mounted."""

import contextlib
import os
import subprocess

import pytest

from agents.recorder.disk import DiskGuard
from agents.recorder.recorder import RecorderSettings
from shared.recording.completeness import completeness
from shared.recording.mcap_file import read_notes, read_recording

DISK_MB = 24


@pytest.fixture
def small_disk(tmp_path):
    """A disk of a few megabytes of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = None
    with contextlib.suppress(OSError):
        mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(folder)]
        mounted = subprocess.run(mount, capture_output=True, check=False)
    if mounted is None or mounted.returncode != 0:
        pytest.skip("no disk can be mounted here")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)  # noqa: S607


@pytest.mark.slow
def test_recording_stops_with_a_message_while_the_disk_has_the_room_that_is_to_stay_free(
    record, messages, small_disk, until
):
    keep_free = 8_000_000
    path = small_disk / "a.mcap"
    recorder = record(path, settings=RecorderSettings(keep_free_bytes=keep_free))
    numbers = iter(range(1_000_000))

    def another():
        recorder.put(messages.log(next(numbers), size=200_000))
        return recorder.ended.is_set()

    until(another)
    report = recorder.close()
    assert "recording was stopped: " in report.fault
    assert "8.0 MB are to stay free" in report.fault
    assert not report.complete
    disk = os.statvfs(small_disk)
    assert 0 < disk.f_bavail * disk.f_frsize < keep_free
    assert path.stat().st_size > 4_000_000
    told = completeness(path)
    assert (told.finished, told.complete) == (True, False)
    assert "to stay free" in (read_notes(path, "ended") or {})["reason"]
    held = [entry.sequence for entry in read_recording(path)]
    assert held == list(range(len(held)))


def test_a_disk_that_is_full_of_other_things_is_a_problem_from_the_beginning(tmp_path):
    disk = os.statvfs(tmp_path)
    free = disk.f_bavail * disk.f_frsize
    assert "make room" in DiskGuard(tmp_path, 2 * free + 1).problem()
    assert DiskGuard(tmp_path, 0).problem() == ""
    # what cannot be looked at is left to fail by itself
    assert DiskGuard(tmp_path / "none", 2 * free + 1).problem() == ""


def test_the_rule_leaves_a_share_of_a_small_disk_free(small_disk):
    guard = DiskGuard(small_disk)
    assert guard.problem() == ""
    (small_disk / "other").write_bytes(bytes(int(0.99 * (DISK_MB << 20))))
    assert "0.3 MB are free" in guard.problem() or "0.2 MB are free" in guard.problem()
