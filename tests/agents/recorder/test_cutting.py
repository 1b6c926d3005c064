"""A session of a few seconds, cut in all ways."""

import dataclasses
import hashlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agents.cli.main import main
from agents.inspection.session import read_session
from agents.recorder.cutting import cut
from schemas.codec import encode
from schemas.messages import (
    Consumed,
    FrameStamp,
    Image,
    ImageEncoding,
    RectifiedStereo,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadObservations,
)
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, key
from shared.recording.completeness import completeness
from shared.recording.entry import Entry
from shared.recording.losses import COMPLETE, LOSSES, LOST
from shared.recording.mcap_file import read_attachments, read_notes, read_recording
from shared.recording.writer import RecordingWriter
from tests.agents.inspection.conftest import made, ns

FRAME_NS, FRAME_COUNT, EVERY = 100_000_000, 20, 3
START_NS = 1_700_000_000_000_000_000
IMAGE = Image(ImageEncoding.RAW, 2, 1, 1, b"\0\xff")
FRAMES_KEY = key("lab", FRAMES)


def frame(n):
    return StereoFrame(FrameStamp(n, n, n, "c"), IMAGE, IMAGE)


def observations(n):
    return ThreadObservations(
        stamp=FrameStamp(n, n, n, "c"),
        camera=RectifiedStereo(2, 1, 100.0, 100.0, 1.0, 0.5, 5.0, None),
        status=Status.FAILED,
        reason="none",
        segmenter="truth",
        points_camera=np.zeros((0, 3)),
        half_size_px=np.zeros((0, 2)),
        matched_px=np.zeros((0, 3)),
        match_cost=np.zeros((0, 2)),
        inlier=np.zeros(0, bool),
        mask_left=IMAGE,
        mask_right=IMAGE,
        judgements=(),
        consumed=(Consumed(FRAMES_KEY, 1, n),),
    )


def calibration():
    K, T = np.array([[100.0, 0, 1], [0, 100, 0.5], [0, 0, 1]]), np.eye(4)
    T[0, 3] = -5
    return StereoCalibration(2, 1, K, K, np.zeros(0), np.zeros(0), T, None)


@pytest.fixture
def session(tmp_path):
    """Frames at 10 Hz, of which perception took every third, with a calibration before."""
    path = tmp_path / "session.mcap"
    writer = RecordingWriter(path)
    writer.note("run", {"protocol": "P1"})
    writer.attach("rig.json", "application/json", b"{}", START_NS)
    writer.write(CALIBRATION, Entry(key("lab", CALIBRATION), 1, 0, encode(calibration()), START_NS, START_NS))
    for n in range(FRAME_COUNT):
        at_ns = START_NS + n * FRAME_NS
        writer.write(FRAMES, Entry(FRAMES_KEY, 1, n, encode(frame(n)), at_ns, at_ns))
        if n % EVERY == 0:
            entry = Entry(
                key("lab", OBSERVATIONS), 1, n // EVERY, encode(observations(n)), at_ns, at_ns + FRAME_NS // 2
            )
            writer.write(OBSERVATIONS, entry)
    writer.note(LOSSES, {COMPLETE: "True"})
    writer.close()
    return path


def cut_seconds(session, tmp_path, begin_s, end_s, **options):
    target = tmp_path / "short.mcap"
    report = cut(session, target, START_NS + round(begin_s * 1e9), START_NS + round(end_s * 1e9), **options)
    return report, list(read_recording(target)), target


def test_a_stretch_begins_with_the_states_that_held_and_holds_what_was_received_within(session, tmp_path):
    report, entries, target = cut_seconds(session, tmp_path, 0.5, 1.0)
    before = {(e.key, e.sequence): e for e in read_recording(session)}
    assert [(e.key.split("/")[-1], e.sequence, e.repeated) for e in entries] == [
        ("calibration", 0, True),
        *[("frames", n, False) for n in (5, 6)],
        ("observations", 2, False),
        *[("frames", n, False) for n in (7, 8, 9)],
        ("observations", 3, False),
        ("frames", 10, False),
    ]
    assert all(before[e.key, e.sequence].payload == e.payload for e in entries)
    assert (report.kept, report.unused) == (sum(not e.repeated for e in entries), 0)
    assert completeness(target).complete
    assert read_notes(target, "run") == {"protocol": "P1"}
    (derived,) = completeness(target).derived
    assert (derived.how, derived.source) == ("cut from 0.5 s to 1.0 s", "session.mcap")
    assert derived.sha256 == hashlib.sha256(session.read_bytes()).hexdigest()
    assert derived.left_out == {"messages before and after": len(before) - (len(entries) - 1)}
    assert read_attachments(target) == {"rig.json": b"{}"}


def test_frames_of_which_nothing_was_made_are_left_out_and_the_file_says_so(session, tmp_path):
    report, entries, target = cut_seconds(session, tmp_path, 0.5, 1.0, only_used_frames=True)
    assert [e.sequence for e in entries if e.key == FRAMES_KEY] == [6, 9]
    assert report.unused == 4
    told = completeness(target)
    assert (told.complete, told.left_out_frames) == (True, 4)
    assert told.sentence == "complete but for what was left out on purpose"
    session = read_session(target)
    assert [one.lost for one in session.contents] == [0] * len(session.contents)
    assert not any(one.gaps for one in session.contents)


def test_a_cut_file_that_breaks_off_still_says_what_it_was_made_of(session, tmp_path):
    _, _, target = cut_seconds(session, tmp_path, 0.5, 1.0, only_used_frames=True)
    whole = target.read_bytes()
    broken = tmp_path / "broken.mcap"
    for share in (0.5, 0.9):
        broken.write_bytes(whole[: int(share * len(whole))])
        told = completeness(broken)
        assert not told.finished
        (derived,) = told.derived
        assert derived.how.startswith("cut")
        assert derived.source == "session.mcap"
        # frames that were left out on purpose are no losses
        assert not any(one.lost or one.gaps for one in read_session(broken).contents)
        assert read_attachments(broken) == {"rig.json": b"{}"}


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.integers(0, 20), max_size=4, unique=True),
    st.integers(0, 20),
    st.integers(0, 20),
    st.booleans(),
    st.booleans(),
)
def test_of_what_a_recording_lacks_its_cut_lacks_what_was_lost_within(tmp_path, lost_at, begin, end, closed, used):
    """Of any losses, any stretch, of files that were closed or cut off, cut once and twice."""
    begin, end = sorted((begin, end))
    path = tmp_path / "session.mcap"
    writer = RecordingWriter(path)
    for n in range(FRAME_COUNT):
        at_ns = START_NS + n * FRAME_NS
        if n in lost_at:
            writer.note(LOST, {"at_ns": str(at_ns), FRAMES_KEY: f"1: {n} on the way"})
        writer.write(FRAMES, Entry(FRAMES_KEY, 1, n, encode(frame(n)), at_ns, at_ns))
    if closed:
        counts = {FRAMES_KEY: str(len([n for n in lost_at if n < FRAME_COUNT]))} if lost_at else {}
        writer.note(LOSSES, counts | {COMPLETE: str(not lost_at)})
        writer.close()
    else:
        writer.flush()
        writer.abandon()
    once, twice = tmp_path / "once.mcap", tmp_path / "twice.mcap"
    stretch = START_NS + begin * FRAME_NS, START_NS + end * FRAME_NS
    cut(path, once, *stretch, only_used_frames=used)
    cut(once, twice, *stretch, only_used_frames=used)
    within = len([n for n in lost_at if begin <= n <= end and n < FRAME_COUNT])
    for file, source in ((once, path), (twice, once)):
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
    report, entries, target = cut_seconds(tmp_path / "newer.mcap", tmp_path, 0, 1)
    assert (report.kept, {entry.key for entry in entries} & {FRAMES_KEY}) == (len(entries), set())
    (derived,) = completeness(target).derived
    assert derived.left_out["messages of topics that this version does not know"] == FRAME_COUNT


def test_whoever_uses_what_was_made_of_a_file_that_was_cut_off_is_told(session, tmp_path):
    cut_off = tmp_path / "cut_off.mcap"
    cut_off.write_bytes(session.read_bytes()[:-400])
    _, _, target = cut_seconds(cut_off, tmp_path, 0, 1)
    (doubt,) = completeness(target).doubts
    assert doubt.startswith("its source: cut off at ")
    assert completeness(session).doubts == []


def test_what_lacks_something_is_not_complete_when_it_is_cut(tmp_path):
    path = tmp_path / "session.mcap"
    writer = RecordingWriter(path)
    writer.write(FRAMES, Entry(FRAMES_KEY, 1, 0, encode(frame(0)), START_NS, START_NS))
    writer.note(LOSSES, {FRAMES_KEY: "1", COMPLETE: "False"})
    writer.close()
    _, entries, target = cut_seconds(path, tmp_path, 0, 1)
    assert len(entries) == 1
    assert completeness(target).complete is False


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--from", "9"], "--from 9 lies beyond the end of the recording, which lasts 1.9 s"),
        (["--from", "soon"], "--from 'soon' is no moment"),
        (["--output", "{session}"], "exists already; give another name"),
    ],
)
def test_what_cannot_be_cut_gets_one_line(session, tmp_path, capsys, arguments, said):
    given = [argument.format(session=session) for argument in arguments]
    output = [] if "--output" in given else ["--output", str(tmp_path / "short.mcap")]
    with pytest.raises(SystemExit, match="2"):
        main(["cut", str(session), *given, *output])
    complaint = capsys.readouterr().err
    assert said in complaint
    assert complaint.count("\n") == 1


def test_the_command_says_what_the_new_file_holds(session, tmp_path, capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["cut", str(session), "--output", str(tmp_path / "short.mcap"), "--to", "1", "--used"])
    said = capsys.readouterr().out
    assert "messages of 1.0 s" in said
    assert "without 7 frames of which nothing in it was made" in said


def test_a_stretch_within_a_motion_holds_the_plan_of_it_and_its_goal(tmp_path):
    target = tmp_path / "short.mcap"
    cut(made().write(tmp_path / "grasp.mcap"), target, ns(1.2), ns(1.9))
    (grasp,) = read_session(target).grasps
    assert grasp.plan is not None and grasp.goal is not None
    assert (grasp.plan.plan_id, grasp.goal.header.id, grasp.plan_before) == ("plan-g2", "g2", True)
