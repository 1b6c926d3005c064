"""A recording in several files, each of which opens by itself."""

from agents.recorder.parts import Attached, FileSettings
from agents.recorder.recorder import RecorderSettings
from schemas.codec import decode
from schemas.messages import StereoCalibration
from schemas.topics import CALIBRATION, key
from shared.calibration import read_calibration
from shared.recording.completeness import completeness
from shared.recording.mcap_file import Note, read_attachments, read_notes, read_recording


def in_parts(**settings):
    return RecorderSettings(FileSettings(**settings))


def test_a_recording_is_split_by_size_and_nothing_is_lost_or_doubled_between(record, messages, tmp_path, until):
    recorder = record(tmp_path / "a.mcap", settings=in_parts(split_bytes=10_000))
    for number in (0, 3):
        recorder.put(messages.log(number))
    until(lambda: recorder.report().lost)
    for number in range(4, 100):
        recorder.put(messages.log(number, size=1000))
    report = recorder.close()
    assert len(report.paths) > 5
    assert report.paths[:2] == (tmp_path / "a.mcap", tmp_path / "a_part2.mcap")
    assert all(sum(len(entry.payload) for entry in read_recording(path)) <= 10_000 for path in report.paths)
    numbers = [entry.sequence for path in report.paths for entry in read_recording(path) if not entry.repeated]
    assert numbers == [0, *range(3, 100)]
    found = [(read_notes(path, "part") or {})["number"] for path in report.paths]
    assert found == [str(number + 1) for number in range(len(report.paths))]
    # a loss lies in the part that it happened in
    first, *later = (completeness(path) for path in report.paths)
    assert (first.complete, first.lost) == (False, {messages.camera: 2})
    assert all(part.complete for part in later)
    assert report.lost == {messages.camera: 2}


def test_a_recording_is_split_by_time(record, messages, tmp_path, until):
    recorder = record(tmp_path / "a.mcap", settings=in_parts(split_s=0.2))
    number = iter(range(1_000_000))

    def another():
        recorder.put(messages.log(next(number)))
        return len(recorder.report().paths) >= 3

    until(another)
    report = recorder.close()
    assert report.complete
    for path in report.paths[:-1]:
        times = [entry.received_ns for entry in read_recording(path)]
        assert max(times) - min(times) < 0.2e9


def test_every_part_begins_with_calibration_state_notes_and_attachments_marked_as_repeated(record, messages, tmp_path):
    recorder = record(
        tmp_path / "a.mcap",
        settings=in_parts(split_bytes=5_000),
        notes=(Note("run", {"rig": "lab"}),),
        attached=(Attached("configuration.json", "application/json", b"{}"),),
    )
    recorder.put(messages.calibration(0, metres_per_unit=1.0))
    # one that changes is attached again
    recorder.put(messages.calibration(1))
    for number in range(30):
        recorder.put(messages.state(number))
        recorder.put(messages.log(number, size=500))
    report = recorder.close()
    assert len(report.paths) > 3
    for number, path in enumerate(report.paths):
        entries = list(read_recording(path))
        calibration = [entry for entry in entries if entry.key == key("lab", CALIBRATION)][-1]
        assert calibration.repeated == (number > 0)
        assert decode(StereoCalibration, calibration.payload).metres_per_unit == 1e-3
        repeated = [entry for entry in entries if entry.repeated]
        assert len(repeated) == (2 if number else 0)
        assert entries[: len(repeated)] == repeated
        received = [entry.received_ns for entry in entries]
        assert received == sorted(received)
        assert read_notes(path, "run") == {"rig": "lab"}
        files = read_attachments(path)
        assert files["configuration.json"] == b"{}"
        (tmp_path / "calibration.json").write_bytes(files["calibration.json"])
        read = read_calibration(tmp_path / "calibration.json", unit=None, image_size=(64, 48))
        assert read.calibration.metres_per_unit == 1e-3
