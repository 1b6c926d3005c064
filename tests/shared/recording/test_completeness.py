"""What a file says of itself: whole, cut off, with losses that were told before."""

import pytest

from schemas.codec import encode
from schemas.messages import LogLevel, LogRecord
from schemas.topics import LOG, key
from shared.recording.completeness import completeness, completeness_of
from shared.recording.entry import Note
from shared.recording.losses import LOSSES, ON_THE_WAY, Loss, as_note
from shared.recording.mcap_file import Entry, finished_notes
from shared.recording.writer import RecordingWriter

KEY = key("lab", LOG, agent="camera")
TEXT = encode(LogRecord(0, "camera", "main", LogLevel.INFO, "x" * 100))
WHEN_NS = 1_800_000_000_000_000_000


def written(path, lost=(), complete=None):
    writer = RecordingWriter(path)
    for number in range(5):
        writer.write(LOG, Entry(KEY, 1, number, TEXT, WHEN_NS, WHEN_NS + number))
    if lost:
        note = as_note(lost, WHEN_NS)
        writer.note(note.name, note.facts)
    writer.flush()
    size = path.stat().st_size
    if complete is not None:
        writer.note(LOSSES, {loss.key: str(loss.count) for loss in lost} | {"complete": str(complete)})
    writer.close()
    return size


LOST = (Loss(KEY, 3, 5, ON_THE_WAY, 0),)


def told_of(path):
    told = completeness(path)
    return told.finished, told.complete, told.lost, told.sentence


def test_a_closed_recording_is_complete_or_tells_each_loss_once_though_the_file_holds_it_twice(tmp_path):
    path = tmp_path / "a.mcap"
    written(path, complete=True)
    assert told_of(path) == (True, True, {}, "complete")
    written(path, LOST, complete=False)
    assert told_of(path) == (True, False, {KEY: 3}, "not complete: lost 3 of camera/main/log")
    stopped = completeness_of([Note("ended", {"reason": "4.2 MB are free"}), *finished_notes(path)], True, None)
    assert stopped.sentence.endswith("lost 3 of camera/main/log; its recorder stopped early: 4.2 MB are free")
    # one that does not say is not taken for complete
    written(path)
    assert told_of(path) == (True, None, {}, "nobody noted whether anything is missing")


@pytest.mark.parametrize(("lost", "complete"), [((), None), (LOST, False)])
def test_a_recording_that_was_cut_off_says_until_when_and_is_never_complete(tmp_path, lost, complete):
    path = tmp_path / "a.mcap"
    size = written(path, lost, complete=True)
    path.write_bytes(path.read_bytes()[:size])
    told = completeness(path)
    assert (told.finished, told.complete, told.last_ns) == (False, complete, WHEN_NS + 4)
    assert told.sentence.startswith("cut off at 2027-01-1")
    assert ("lost 3 of camera/main/log" in told.sentence) == bool(lost)
