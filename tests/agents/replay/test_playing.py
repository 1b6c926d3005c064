"""What of a recording is played and when: its topics, stretch, order, moments, steps, and who is waited for."""

from datetime import datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.replay.contents import (
    PastCommand,
    SelectionError,
    WindowError,
    contents_of,
    name_of,
    select,
    window_ns,
)
from agents.replay.flow import Awaited, awaited_of, spacing_errors_ms, spacing_of
from agents.replay.items import Message, ReadAhead, items
from agents.replay.player import Controls, Timeline
from schemas.messages import Consumed, Progress
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, PROMPT, ROBOT_STATE, THREAD, key
from shared.recording.mcap_file import UntilDamage

FRAME_KEY, CALIBRATION_KEY = key("recorded", FRAMES), key("recorded", CALIBRATION)
MS, SECOND = 10**6, 10**9
FROM_OUTSIDE = {"camera/frames", "camera/calibration", "camera/log", "robot_bridge/state"}


@pytest.fixture(scope="module")
def contents(recording):
    return contents_of(recording.path)


def named(selection):
    return {name_of(key) for key in selection.keys}


def test_by_default_all_is_played_but_what_would_be_acted_on_what_nobody_knows_and_what_is_live(contents):
    selection = select(contents, None, ())
    assert named(selection) == {*FROM_OUTSIDE, "reconstruction/thread", "perception/health", "perception/command"}
    assert selection.commands == ()
    assert {name_of(key): reason for key, reason in selection.left_out.items()} == {
        "planner/plan": "would be acted on",
        "operator/prompt": "would be acted on",
        "somebody/whatever": "the topic table does not know it",
    }
    # agents that are live get what comes from outside
    live = ("perception/main", "reconstruction/main", "planner/main", "robot_bridge/psm2")
    assert named(select(contents, None, live)) == FROM_OUTSIDE


def test_topics_are_named_by_a_pattern_but_what_would_be_acted_on_has_to_be_spelt_out(contents):
    by_pattern = {"camera/frames", "camera/calibration", "camera/log", "reconstruction/thread"}
    assert named(select(contents, ("camera/*", "*/thread"), ())) == by_pattern
    assert "planner/plan" not in named(select(contents, ("*",), ()))
    spelt = select(contents, ("planner/plan", "operator/prompt", "camera/frames"), ("perception/main",))
    assert spelt.acted_on == ("planner/plan", "operator/prompt")
    assert spelt.commands == (PROMPT,)


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("camera/frames", "camera/main is live on this rig and publishes camera/frames itself"),
        ("camera/framez", "is no topic; it holds camera/calibration, camera/frames, "),
        ("simulator/state", "is not in this recording"),
        ("planner/*", "is not in this recording"),
    ],
)
def test_a_name_that_nothing_has_or_that_is_live_is_refused(contents, pattern, said):
    with pytest.raises(SelectionError) as refused:
        select(contents, (pattern,), ("camera/main",))
    assert said in str(refused.value)


def test_contents_tell_what_there_is_and_when(contents, recording):
    entries = recording.entries
    assert sum(contents.counts.values()) + sum(contents.unknown.values()) == len(entries)
    assert contents.rigs == ("recorded",)
    assert (contents.first_ns, contents.last_ns) == (entries[0].received_ns, entries[-1].received_ns)
    (prompt,) = contents.commands
    # when perception got it, which is before it left its record
    assert (prompt.topic, prompt.at_ns) == (PROMPT, recording.begin_ns + 800 * MS)


BEGIN_NS = round(datetime(2026, 11, 20, 14, 30).astimezone().timestamp()) * SECOND
END_NS = BEGIN_NS + 60 * SECOND


@given(st.lists(st.integers(0, 60_000), min_size=2, max_size=2).map(sorted))
def test_seconds_are_counted_from_the_start(stretch_ms):
    begin, end = (f"{ms / 1000:.3f}" for ms in stretch_ms)
    assert window_ns(begin, end, BEGIN_NS, END_NS) == tuple(BEGIN_NS + ms * MS for ms in stretch_ms)


@pytest.mark.parametrize("written", ["14:30:05", "2026-11-20T14:30:05", "2026-11-20 14:30:05.0"])
def test_a_time_of_the_day_is_meant_where_one_is_written(written):
    assert window_ns(written, None, BEGIN_NS, END_NS) == (BEGIN_NS + 5 * SECOND, END_NS)


@pytest.mark.parametrize(
    ("begin", "end", "said"),
    [
        ("61", None, "--from 61 lies beyond the end of the recording, which lasts 60.0 s"),
        ("20", "10", "--to 10 lies before --from 20"),
        (None, "14:00", "--to 14:00 lies before the recording, which begins at 2026-11-20 14:30:00"),
        ("soon", None, "--from 'soon' is no moment"),
        (None, "25:00", "--to '25:00' is no moment"),
        ("9" * 400, None, "is no moment"),
    ],
)
def test_a_stretch_that_makes_no_sense_is_said_in_a_sentence(begin, end, said):
    with pytest.raises(WindowError) as refused:
        window_ns(begin, end, BEGIN_NS, END_NS)
    assert said in str(refused.value)


def sent(recording, keys, begin_ms=0, end_ms=2000, commands=()) -> list[Any]:
    window = recording.begin_ns + begin_ms * MS, recording.begin_ns + end_ms * MS
    return list(items(UntilDamage(recording.path).entries(), keys, commands, window, "elsewhere"))


def test_bytes_order_and_times_are_those_of_the_recording_the_rig_is_the_new_one_and_frames_end_steps(recording):
    found = sent(recording, tuple({entry.key for entry in recording.entries}))
    assert [(m.payload, m.at_ns, m.published_ns) for m in found] == [
        (e.payload, e.received_ns, e.published_ns) for e in recording.entries
    ]
    assert {m.key.split("/")[1] for m in found} == {"elsewhere"}
    assert {m.key.split("/")[-1] for m in found if m.ends_step} == {"frames"}
    # where there are none, each message does
    assert all(m.ends_step for m in sent(recording, (CALIBRATION_KEY,)))


def test_a_stretch_begins_with_the_states_that_held_then(recording):
    first, *frames = sent(recording, (FRAME_KEY, CALIBRATION_KEY), 500, 700)
    assert (first.payload, first.at_ns) == (b"calibration", recording.begin_ns + 500 * MS)
    received = [(e.received_ns - recording.begin_ns) / MS for e in recording.entries if e.key == FRAME_KEY]
    assert [(m.at_ns - recording.begin_ns) / MS for m in frames] == [ms for ms in received if 500 <= ms <= 700]


def test_commands_come_when_they_were_received_not_when_their_record_was_left(recording, contents):
    found = sent(recording, (FRAME_KEY,), commands=contents.commands)
    times = [item.at_ns for item in found]
    assert times == sorted(times)
    (command,) = [item for item in found if isinstance(item, PastCommand)]
    assert command.at_ns == recording.begin_ns + 800 * MS
    assert sent(recording, (FRAME_KEY,), 900, commands=contents.commands)[0].at_ns > command.at_ns


def test_what_is_read_ahead_is_all_of_it_in_order_however_little_may_wait():
    source = [Message(n, "k", bytes(10), 0, False) for n in range(200)]
    ahead = ReadAhead(iter(source), most_bytes=25)
    ahead.fill(0.01)
    assert list(ahead) == source
    # it ends where nobody wants more
    ahead = ReadAhead(iter(source), most_bytes=25)
    assert next(iter(ahead)).at_ns == 0
    ahead.close()


@given(st.sampled_from((0.1, 0.5, 1.0, 2.0, 10.0)), st.integers(0, 100), st.floats(0, 1000))
def test_a_moment_is_due_when_the_timeline_has_come_to_it(rate, seconds, begin_s):
    timeline = Timeline(rate)
    timeline.jump(5 * SECOND, begin_s)
    timeline.go_on(begin_s)
    due_s = timeline.due_s((5 + seconds) * SECOND)
    assert due_s == pytest.approx(begin_s + seconds / rate)
    assert timeline.now(due_s)[0] == pytest.approx((5 + seconds) * SECOND, abs=10_000)


def test_no_time_passes_while_it_is_held_and_none_is_made_up_for():
    timeline = Timeline(2.0)
    timeline.jump(0, 10.0)
    assert timeline.now(11.0) == (0, 0.0)
    assert timeline.go_on(12.0)
    assert not timeline.go_on(12.5)
    assert timeline.now(13.0) == (2 * SECOND, 2.0)
    assert timeline.hold(13.0)
    assert timeline.now(20.0) == (2 * SECOND, 0.0)
    timeline.go_on(20.0)
    assert timeline.due_s(4 * SECOND) == 21.0


def test_a_step_goes_on_until_one_frame_is_sent_and_space_until_it_is_held_again():
    controls, held = Controls(held=True), []
    for key_pressed in ("step", "step", "step_done", "step_done", "toggle", "step_done", "toggle"):
        getattr(controls, key_pressed)()
        held.append(controls.held)
    assert held == [False, False, False, True, False, False, True]
    # who leaves after his steps has them done first
    controls.step()
    controls.stop_when_done()
    assert not controls.stopped
    controls.step_done()
    assert controls.stopped


def test_spacing_errors_are_those_of_neighbours_of_one_run():
    recorded_ns = np.array([0, 10, 20, 0, 100], dtype=np.int64) * MS
    sent_s, run = np.array([1.0, 1.021, 1.039, 5.0, 5.2]), np.array([0, 0, 0, 1, 1])
    errors = spacing_errors_ms(sent_s, recorded_ns, run, 0.5)
    np.testing.assert_allclose(errors, [1.0, 2.0, 0.0], atol=1e-9)
    spacing = spacing_of(errors)
    assert spacing is not None
    assert (spacing.pairs, round(spacing.worst_ms, 6)) == (3, 2.0)
    assert spacing_of(np.empty(0)) is None


FRAME, SEEN, CURVE = (key("test", topic) for topic in (FRAMES, OBSERVATIONS, THREAD))
STATE, OTHER_STATE = key("test", ROBOT_STATE, "psm1"), key("test", ROBOT_STATE, "psm2")
EPOCH, THEIRS = 1, 2


def awaited(perception=4, reconstruction=9, planner=5, epoch=EPOCH, before=None):
    """Who is waited for once frame 4 was sent, where these are done with so much."""
    said = {
        "perception/main": Progress(FRAME, (Consumed(FRAME, EPOCH, perception),), (Consumed(SEEN, THEIRS, 9),)),
        "reconstruction/main": Progress(SEEN, (Consumed(SEEN, THEIRS, reconstruction),), (Consumed(CURVE, THEIRS, 5),)),
        "planner/main": Progress(CURVE, (Consumed(CURVE, THEIRS, planner),), ()),
    }
    return awaited_of(said, {FRAME: 4}, epoch, before or {})


def test_a_fast_replay_waits_for_each_consumer_of_what_followed_and_for_nothing_else():
    assert awaited() is None
    assert awaited(perception=3) == Awaited("perception/main", FRAME, 4)
    assert awaited(reconstruction=8) == Awaited("reconstruction/main", SEEN, 9)
    assert awaited(planner=4) == Awaited("planner/main", CURVE, 5)
    # the same number of another run is another message
    assert awaited(epoch=EPOCH + 5) == Awaited("perception/main", FRAME, 4)
    # what was published before need not have been heard
    assert awaited(planner=2, before={(CURVE, THEIRS): 5}) is None
    assert awaited(planner=2, before={(CURVE, THEIRS): 4}) == Awaited("planner/main", CURVE, 5)


def test_only_those_who_listen_to_a_key_are_waited_for():
    everyones = {"planner/main": Progress(key("test", ROBOT_STATE, "*"), (), ())}
    own = {"simulator/main": Progress(STATE, (), ())}
    assert awaited_of(everyones, {OTHER_STATE: 0}, EPOCH, {}) == Awaited("planner/main", OTHER_STATE, 0)
    assert awaited_of(own, {OTHER_STATE: 0}, EPOCH, {}) is None
