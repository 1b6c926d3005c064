from typing import Any

from agents.replay.contents import PastCommand, contents_of, readable
from agents.replay.items import Message, ReadAhead, items
from schemas.topics import CALIBRATION, FRAMES, key

FRAME_KEY, CALIBRATION_KEY = key("recorded", FRAMES), key("recorded", CALIBRATION)
MS = 10**6


def sent(recording, keys, begin_ms=0, end_ms=2000, commands=()) -> list[Any]:
    window = recording.begin_ns + begin_ms * MS, recording.begin_ns + end_ms * MS
    return list(items(readable(recording.path), keys, commands, window, "elsewhere"))


def test_bytes_order_and_times_are_those_of_the_recording_and_the_rig_is_the_new_one(recording):
    keys = tuple({entry.key for entry in recording.entries})
    found = sent(recording, keys)
    assert [m.payload for m in found] == [e.payload for e in recording.entries]
    assert [m.at_ns for m in found] == [e.received_ns for e in recording.entries]
    assert [m.published_ns for m in found] == [e.published_ns for e in recording.entries]
    assert {m.key.split("/")[1] for m in found} == {"elsewhere"}


def test_a_stretch_begins_with_the_states_that_held_then(recording):
    found = sent(recording, (FRAME_KEY, CALIBRATION_KEY), 500, 700)
    begin_ns = recording.begin_ns + 500 * MS
    assert (found[0].payload, found[0].at_ns) == (b"calibration", begin_ns)
    assert [m.at_ns for m in found[1:]] == [
        e.received_ns
        for e in recording.entries
        if e.key == FRAME_KEY and 500 <= (e.received_ns - recording.begin_ns) / MS <= 700
    ]


def test_commands_come_when_they_were_received_not_when_their_record_was_left(recording):
    commands = contents_of(recording.path).commands
    found = sent(recording, (FRAME_KEY,), commands=commands)
    times = [item.at_ns for item in found]
    assert times == sorted(times)
    (command,) = [item for item in found if isinstance(item, PastCommand)]
    assert command.at_ns == recording.begin_ns + 800 * MS
    assert sent(recording, (FRAME_KEY,), 900, commands=commands)[0].at_ns > command.at_ns


def test_a_step_ends_with_a_frame_or_where_there_are_none_with_each_message(recording):
    all_keys = tuple({entry.key for entry in recording.entries})
    assert {m.key.split("/")[-1] for m in sent(recording, all_keys) if m.ends_step} == {"frames"}
    assert all(m.ends_step for m in sent(recording, (CALIBRATION_KEY,)))


def test_what_is_read_ahead_is_all_of_it_in_order_however_little_may_wait():
    source = [Message(n, "k", bytes(10), 0, False) for n in range(200)]
    ahead = ReadAhead(iter(source), most_bytes=25)
    ahead.fill(0.01)
    assert list(ahead) == source
    ahead.close()
    # it ends where nobody wants more
    ahead = ReadAhead(iter(source), most_bytes=25)
    assert next(iter(ahead)).at_ns == 0
    ahead.close()
    assert not ahead._thread.is_alive()
