"""A recording ends before the disk is full."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from agents.recorder.intake import DiskGuard
from agents.recorder.recorder import RecorderSettings
from shared.recording.completeness import completeness
from shared.recording.mcap_file import read_notes, read_recording


@pytest.fixture
def disk(monkeypatch):
    """Makes every disk one that has so many bytes free, of so many."""

    def set_to(free, total=10**12):
        told = SimpleNamespace(f_bavail=free // 1000, f_blocks=total // 1000, f_frsize=1000)
        monkeypatch.setattr("agents.recorder.intake.os.statvfs", lambda _: told)

    return set_to


def test_recording_stops_with_a_message_while_the_disk_has_the_room_that_is_to_stay_free(
    record, messages, tmp_path, disk, until
):
    disk(8_000_000)
    path = tmp_path / "a.mcap"
    recorder = record(path, settings=RecorderSettings(keep_free_bytes=8_000_000))
    for number in range(50):
        recorder.put(messages.log(number))
    until(lambda: sum(recorder.report().received.values()) == 50)
    disk(7_999_000)
    until(recorder.ended.is_set)
    report = recorder.close()
    assert report.fault.startswith("recording was stopped: 8.0 MB are free where ")
    assert "8.0 MB are to stay free" in report.fault
    assert not report.complete
    told = completeness(path)
    assert (told.finished, told.complete) == (True, False)
    assert "to stay free" in (read_notes(path, "ended") or {})["reason"]
    assert [entry.sequence for entry in read_recording(path)] == list(range(50))


@pytest.mark.parametrize(("total", "kept"), [(10**9, 20_000_000), (10**12, 524_288_000)])
def test_2_percent_of_a_disk_stay_free_500_mb_at_most_and_recording_begins_anew_at_twice_that(disk, total, kept):
    guard = DiskGuard(Path("/sessions"))
    for free, has_room, has_room_again in (
        (kept - 1000, False, False),
        (kept, True, False),
        (2 * kept - 1000, True, False),
        (2 * kept, True, True),
    ):
        disk(free, total)
        assert (guard.problem() == "", guard.has_room_again()) == (has_room, has_room_again)


def test_what_is_no_disk_or_cannot_be_looked_at_is_left_to_fail_by_itself(tmp_path, disk):
    assert DiskGuard(tmp_path / "none", 10**18).problem() == ""
    disk(0, total=0)
    assert DiskGuard(tmp_path, 1).problem() == ""
