"""Only events are kept, with the seconds before and after them."""

import threading

from agents.recorder.pre_trigger import PreTriggerSettings
from agents.recorder.recorder import RecorderSettings
from schemas.messages import ExecutionKind, RobotMode
from schemas.topics import CALIBRATION, key
from shared.clock import monotonic_s
from shared.recording.completeness import completeness
from shared.recording.mcap_file import is_finished, read_notes, read_recording


def keeping(before_s, after_s, **limits):
    return RecorderSettings(pre_trigger=PreTriggerSettings(before_s, after_s, **limits))


def wait_past(seconds):
    """So long that the clock is past it."""
    begin_s = monotonic_s()
    while monotonic_s() < begin_s + seconds:
        threading.Event().wait(seconds)


def numbers(path, messages):
    return [entry.sequence for entry in read_recording(path) if entry.key == messages.camera]


def test_without_an_event_there_is_no_file(record, messages, tmp_path):
    recorder = record(tmp_path / "a.mcap", settings=keeping(60.0, 60.0))
    recorder.put(messages.log(0))
    recorder.put(messages.execution(0, ExecutionKind.FINISHED))
    report = recorder.close()
    assert (report.paths, report.received, report.complete) == ((), {}, True)
    assert list(tmp_path.iterdir()) == []


def test_what_came_before_a_held_grasp_is_kept_with_what_follows_and_what_was_lost(record, messages, tmp_path, until):
    lines = []
    recorder = record(tmp_path / "a.mcap", settings=keeping(60.0, 60.0), tell=lines.append)
    for number in (0, *range(3, 20)):
        recorder.put(messages.log(number))
    until(lambda: lines)
    recorder.put(messages.execution(0, ExecutionKind.HELD))
    until(lambda: recorder.report().paths)
    for number in range(20, 30):
        recorder.put(messages.log(number))
    report = recorder.close()
    path = tmp_path / "a_1_held.mcap"
    assert report.paths == (path,)
    assert numbers(path, messages) == [0, *range(3, 30)]
    assert (read_notes(path, "trigger") or {})["reason"] == "held"
    assert completeness(path).lost == report.lost == {messages.camera: 2}
    assert len(lines) == 2
    assert str(path) in lines[1]


def test_each_event_gets_a_file_that_ends_by_itself_and_holds_the_calibration_of_long_ago(
    record, messages, tmp_path, until
):
    recorder = record(tmp_path / "a.mcap", settings=keeping(0.05, 0.0))
    recorder.put(messages.calibration())
    count = iter(range(1_000_000))

    def finished(name):
        recorder.put(messages.log(next(count)))
        return (tmp_path / name).exists() and is_finished(tmp_path / name)

    for name in ("a_1_asked.mcap", "a_2_asked.mcap"):
        # what is older than the seconds before is gone when the event comes
        wait_past(0.1)
        recorder.trigger("asked")
        until(lambda name=name: finished(name))
    report = recorder.close()
    assert [path.name for path in report.paths] == ["a_1_asked.mcap", "a_2_asked.mcap"]
    for path in report.paths:
        (calibration,) = [entry for entry in read_recording(path) if entry.key == key("lab", CALIBRATION)]
        assert calibration.repeated


def test_what_lasts_is_one_event_and_a_later_event_lengthens_the_first(record, messages, tmp_path):
    recorder = record(tmp_path / "a.mcap", settings=keeping(60.0, 60.0))
    for number, mode in enumerate([RobotMode.IDLE, *[RobotMode.FAULT] * 5, RobotMode.IDLE]):
        recorder.put(messages.state(number, mode))
    recorder.put(messages.execution(0, ExecutionKind.REFUSED))
    report = recorder.close()
    assert [path.name for path in report.paths] == ["a_1_fault.mcap"]
    assert (read_notes(report.paths[0], "marked") or {})["reason"] == "refused"


def test_memory_is_bounded_and_it_is_said_that_less_is_kept(record, messages, tmp_path):
    lines = []
    recorder = record(tmp_path / "a.mcap", settings=keeping(60.0, 0.0, limit_bytes=20_000), tell=lines.append)
    for number in range(100):
        recorder.put(messages.log(number, size=1000))
    recorder.put(messages.execution(0, ExecutionKind.HELD))
    held = numbers(recorder.close().paths[0], messages)
    assert held[-1] == 99
    assert 15 <= len(held) <= 20
    assert sum("of memory hold only the last" in line for line in lines) == 1
