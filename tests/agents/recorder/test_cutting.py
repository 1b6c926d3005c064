"""A session of a few seconds, cut in all ways."""

import dataclasses
import hashlib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agents.cli.main import main
from agents.recorder.cutting import cut
from agents.session_report.session import read_session
from schemas.codec import decode, encode
from schemas.messages import Consumed, RobotState
from schemas.topics import CALIBRATION, FRAMES, ROBOT_STATE, THREAD, key
from shared.recording.completeness import completeness
from shared.recording.derivation import UNUSED_FRAMES
from shared.recording.entry import Entry
from shared.recording.losses import COMPLETE, LOSSES, LOST
from shared.recording.mcap_file import read_attachments, read_notes, read_recording
from shared.recording.writer import RecordingWriter
from tests.agents.session_report.conftest import Maker, calibration, frame, made, ns, robot_state, thread

COUNT, EVERY = 20, 3
FRAMES_KEY = key("lab", FRAMES)
FRAME = encode(frame(0, 0.0))


@pytest.fixture
def session(tmp_path):
    """Frames at 10 Hz, of every third of which a thread was made, with a calibration before."""
    maker = Maker()
    maker.put(CALIBRATION, calibration(), 0.0)
    for n in range(COUNT):
        maker.put(FRAMES, frame(n, n / 10), n / 10)
        if n % EVERY == 0:
            made_of = (Consumed(FRAMES_KEY, 1, n),)
            maker.put(THREAD, dataclasses.replace(thread(n, n / 10), consumed=made_of), n / 10 + 0.05)
    notes = (("run", {"protocol": "P1"}), (LOSSES, {COMPLETE: "True"}))
    return maker.write(tmp_path / "session.mcap", notes, {"rig.json": b"{}"})


def cut_short(session, tmp_path, begin_s=0.5, end_s=1.01, **options):
    target = tmp_path / "short.mcap"
    return cut(session, target, ns(begin_s), ns(end_s), **options), list(read_recording(target)), target


def test_a_stretch_begins_with_the_states_that_held_and_holds_what_was_received_within(session, tmp_path):
    report, entries, target = cut_short(session, tmp_path)
    before = {(e.key, e.sequence): e for e in read_recording(session)}
    assert [(e.key.split("/")[-1], e.sequence, e.repeated) for e in entries] == [
        ("calibration", 0, True),
        *[("frames", n, False) for n in (5, 6)],
        ("thread", 2, False),
        *[("frames", n, False) for n in (7, 8, 9)],
        ("thread", 3, False),
        ("frames", 10, False),
    ]
    assert all(before[e.key, e.sequence].payload == e.payload for e in entries)
    assert (report.kept, report.unused) == (len(entries) - 1, 0)
    assert completeness(target).complete
    assert read_notes(target, "run") == {"protocol": "P1"}
    (derived,) = completeness(target).derived
    assert (derived.how, derived.source) == ("cut from 0.5 s to 1.0 s", "session.mcap")
    assert derived.sha256 == hashlib.sha256(session.read_bytes()).hexdigest()
    assert derived.left_out == {"messages before and after": len(before) - (len(entries) - 1)}
    assert read_attachments(target) == {"rig.json": b"{}"}


def test_frames_of_which_nothing_was_made_are_left_out_and_the_file_says_so_wherever_it_breaks_off(session, tmp_path):
    report, entries, target = cut_short(session, tmp_path, only_used_frames=True)
    assert [e.sequence for e in entries if e.key == FRAMES_KEY] == [6, 9]
    assert report.unused == 4
    told = completeness(target)
    assert (told.complete, [one.left_out[UNUSED_FRAMES] for one in told.derived]) == (True, [4])
    assert told.sentence == "complete but for what was left out on purpose"
    whole = target.read_bytes()
    for share in (0.5, 0.9, 1.0):
        target.write_bytes(whole[: int(share * len(whole))])
        (derived,) = completeness(target).derived
        assert (derived.how[:3], derived.source) == ("cut", "session.mcap")
        # frames that were left out on purpose are no losses
        assert not any(one.lost or one.gaps for one in read_session(target).contents)
        assert read_attachments(target) == {"rig.json": b"{}"}


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.integers(0, COUNT), max_size=4, unique=True),
    st.lists(st.integers(0, COUNT), min_size=2, max_size=2).map(sorted),
    st.booleans(),
    st.booleans(),
)
def test_of_what_a_recording_lacks_its_cut_lacks_what_was_lost_within(tmp_path, lost_at, stretch, closed, used):
    """Of any losses, any stretch, of files that were closed or cut off, cut once and twice."""
    begin, end = stretch
    path, once, twice = (tmp_path / f"{name}.mcap" for name in ("session", "once", "twice"))
    writer = RecordingWriter(path)
    for n in range(COUNT):
        if n in lost_at:
            writer.note(LOST, {"at_ns": str(ns(n)), FRAMES_KEY: f"1: {n} on the way"})
        writer.write(FRAMES, Entry(FRAMES_KEY, 1, n, FRAME, ns(n), ns(n)))
    if closed:
        counts = {FRAMES_KEY: str(len([n for n in lost_at if n < COUNT]))} if lost_at else {}
        writer.note(LOSSES, counts | {COMPLETE: str(not lost_at)})
        writer.close()
    else:
        writer.flush()
        writer.abandon()
    within = len([n for n in lost_at if begin <= n <= end and n < COUNT])
    for source, file in ((path, once), (once, twice)):
        cut(source, file, ns(begin), ns(end), only_used_frames=used)
        told = completeness(file)
        assert told.lost == ({FRAMES_KEY: within} if within else {})
        assert (told.complete is True) == (closed and not lost_at)
        assert told.derived[-1].sha256 == hashlib.sha256(source.read_bytes()).hexdigest()
        assert told.derived[-1].source_said == completeness(source).sentence
        kept = sum(1 for _ in read_recording(file))
        assert kept + sum(told.derived[-1].left_out.values()) == sum(1 for _ in read_recording(source))


def test_what_this_version_does_not_know_is_left_out_and_counted(session, tmp_path):
    writer = RecordingWriter(tmp_path / "newer.mcap")
    for entry in read_recording(session):
        writer.write(FRAMES, dataclasses.replace(entry, key=entry.key.replace("frames", "holograms")))
    writer.close()
    report, entries, target = cut_short(tmp_path / "newer.mcap", tmp_path)
    assert report.kept == sum(not entry.repeated for entry in entries)
    (derived,) = completeness(target).derived
    assert derived.left_out["messages of topics that this version does not know"] == COUNT


def test_whoever_uses_what_was_made_of_a_file_that_was_cut_off_is_told(session, tmp_path):
    session.write_bytes(session.read_bytes()[:-400])
    _, _, target = cut_short(session, tmp_path)
    (doubt,) = completeness(target).doubts_of("")
    assert doubt.startswith("its source: cut off at ")


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["--from", "9"], 2, "--from 9 lies beyond the end of the recording, which lasts 1.9 s"),
        (["--from", "soon"], 2, "--from 'soon' is no moment"),
        (["--output", "{session}"], 2, "exists already; give another name"),
        (["--to", "1", "--used"], 0, "without 6 frames of which nothing in it was made"),
    ],
)
def test_the_command_says_in_one_line_what_it_did_or_why_not(session, tmp_path, capsys, arguments, status, said):
    given = [argument.format(session=session) for argument in arguments]
    output = [] if "--output" in given else ["--output", str(tmp_path / "short.mcap")]
    with pytest.raises(SystemExit, match=str(status)):
        main(["cut", str(session), *given, *output])
    told = capsys.readouterr()
    assert said in told.err + told.out
    assert (told.err.count("\n"), bool(told.out)) == ((1, False) if status else (0, True))


def test_a_stretch_within_a_motion_holds_the_plan_of_it_and_its_goal(tmp_path):
    target = tmp_path / "short.mcap"
    cut(made().write(tmp_path / "grasp.mcap"), target, ns(1.2), ns(1.9))
    (grasp,) = read_session(target).grasps
    assert grasp.plan is not None and grasp.goal is not None
    assert (grasp.plan.plan_id, grasp.goal.header.id, grasp.plan_before) == ("plan-g2", "g2", True)


def test_states_of_an_arm_are_moved_by_what_the_camera_is_late_and_the_file_says_so(session, tmp_path, capsys):
    maker = Maker()
    for n in range(COUNT):
        maker.put(FRAMES, frame(n, n / 10), n / 10)
        maker.put(ROBOT_STATE, robot_state(n / 10), n / 10, "psm1")
    source, target = maker.write(tmp_path / "late.mcap"), tmp_path / "moved.mcap"
    with pytest.raises(SystemExit, match="0"):
        main(["cut", str(source), "--output", str(target), "--delay", "psm1=120", "--delay", "psm2=5"])
    assert "holds no state of psm2" in capsys.readouterr().err
    times = [
        [
            decode(RobotState, e.payload).measured_ns
            for e in read_recording(path)
            if e.key == key("lab", ROBOT_STATE, "psm1")
        ]
        for path in (source, target)
    ]
    assert times[1] == [at_ns + 120_000_000 for at_ns in times[0]]
    assert completeness(target).derived[-1].how.endswith("states of psm1 moved by +120 ms")
    with pytest.raises(SystemExit, match="2"):
        main(["cut", str(session), "--output", str(tmp_path / "no.mcap"), "--delay", "psm1"])
    assert "'psm1' is no arm with milliseconds" in capsys.readouterr().err
