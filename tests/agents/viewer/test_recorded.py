import dataclasses
import itertools

import numpy as np
import pytest

from agents.cli.main import main
from agents.viewer.layout import LAYOUTS
from agents.viewer.live import LiveViewer
from agents.viewer.recorded import RecordedViewer, between, tapped_of
from schemas import topics
from schemas.codec import encode
from schemas.messages import RobotMode
from schemas.topics import MAIN, Delivery, key
from shared.recording.mcap_file import Entry, RecordingWriter, read_recording
from tests.agents.viewer.test_live import rows_of, values, words

SECONDS = 3
STATES_HZ = 100


@pytest.fixture(scope="module")
def recording(session_messages, scene, tmp_path_factory):
    """Three seconds of a session: every topic at first, then an arm's state a hundred times a second."""
    path = tmp_path_factory.mktemp("recording") / "session.mcap"
    captured_ns = scene.observations.stamp.capture_left_ns
    writer = RecordingWriter(path)

    def write(topic, message, number, after_ns):
        agent = "perception" if topic.agent == topics.ANY_AGENT else topic.agent
        name = key("test", topic, "psm1" if topic.per_arm else MAIN, agent)
        published_ns = captured_ns + 30_000_000 + after_ns
        writer.write(topic, Entry(name, 1, number, encode(message), published_ns, published_ns + 2_000_000))

    for topic, message in session_messages.items():
        if topic.recorded:
            write(topic, message, 0, 0)
    state = session_messages[topics.ROBOT_STATE]
    for number in range(1, SECONDS * STATES_HZ):
        after_ns = number * 1_000_000_000 // STATES_HZ
        moved = dataclasses.replace(state, measured_ns=captured_ns + after_ns, mode=RobotMode.IDLE)
        write(topics.ROBOT_STATE, moved, number, after_ns)
    writer.close()
    return path


def show(recording, path, layout="operate", thin=False, to_s=None):
    viewer = RecordedViewer(path, "file", "session", layout, thin)
    viewer.show(between(read_recording(recording), None, to_s))
    assert viewer.finished.wait(120)
    assert viewer.error is None
    return viewer, viewer.close()


@pytest.fixture(scope="module")
def whole(recording, tmp_path_factory):
    """The viewer and its report of the whole recording."""
    return show(recording, tmp_path_factory.mktemp("shown") / "session.rrd")


@pytest.fixture(scope="module")
def rows(whole):
    """What the file then holds."""
    return rows_of(whole[1].path)


@pytest.mark.slow
def test_every_message_of_a_recording_is_shown_unless_thinning_is_asked_for(recording, whole, rows, tmp_path):
    viewer, report = whole
    assert sum(report.shown.values()) == sum(1 for _ in read_recording(recording))
    assert not (report.thinned or report.dropped or report.unreadable or viewer.unknown)
    assert len(rows["/robot/jaw_deg/psm1"]) == SECONDS * STATES_HZ
    _, thin = show(recording, tmp_path / "thin.rrd", thin=True)
    assert thin.thinned["robot_bridge/state"] + thin.shown["robot_bridge/state"] == SECONDS * STATES_HZ
    assert thin.shown["robot_bridge/state"] == pytest.approx(20 * SECONDS, abs=1)


def test_a_recording_is_shown_as_the_rig_was(recording, rows, tmp_path):
    live = LiveViewer(tmp_path / "live.rrd", "file", "session")
    first = [entry for entry in read_recording(recording) if entry.sequence == 0]
    for entry in first:
        tapped = tapped_of(entry)
        assert tapped is not None
        live.put(tapped)
    seen_live, seen_later = rows_of(live.close().path), rows
    assert set(seen_live) <= set(seen_later)
    for entity, component in (
        ("/world/thread/curve", "LineStrips3D:strips"),
        ("/world/plan/psm1/considered", "Points3D:positions"),
        ("/latency/reconstruction", "Scalars:scalars"),
    ):
        assert values(seen_live, entity, component) == values(seen_later, entity, component) != []


def test_part_of_a_recording_has_what_still_holds_from_before_it(recording, session_messages):
    bent = dataclasses.replace(session_messages[topics.CALIBRATION], distortion_left=np.full(5, 0.01))
    entries = list(read_recording(recording))
    frame = next(e for e in entries if e.key.endswith("camera/main/frames"))
    calibration = next(e for e in entries if e.key.endswith("calibration"))
    begin_ns = entries[0].received_ns
    late = dataclasses.replace(frame, sequence=1, received_ns=begin_ns + 2_000_000_000)
    told = dataclasses.replace(calibration, payload=encode(bent))
    part = list(between(iter([told, frame, late]), 1.0, 3.0))
    assert [entry.key for entry in part] == [calibration.key, frame.key]
    assert part[1].sequence == 1
    passing = [e for e in between(iter(entries), 1.0, 1.5) if topics.topic_of(e.key).delivery is not Delivery.STATE]
    some = [entry.received_ns - begin_ns for entry in passing]
    assert min(some) >= 1_000_000_000
    assert max(some) <= 1_500_000_000
    assert len(some) == pytest.approx(0.5 * STATES_HZ, abs=2)


def test_latency_and_arrival_are_told_and_step_times_that_are_in_no_recording_are_left_out(rows):
    assert not [entity for entity in rows if entity.startswith("/step_ms/")]
    assert values(rows, "/latency/reconstruction", "Scalars:scalars") == [[30.0]]
    took = values(rows, "/clock/arrival_ms/robot_bridge/psm1", "Scalars:scalars")
    assert [value for (value,) in took] == pytest.approx([2.0] * (SECONDS - 1), abs=1e-6)


@pytest.fixture
def view(monkeypatch, capfd):
    """Run the command where there is no screen: its exit status, and what it says."""
    for screen in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(screen, raising=False)

    def run(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["view", *map(str, arguments)])
        return end.value.code, *capfd.readouterr()

    return run


def test_the_command_writes_a_recording_and_tells_how_far_it_is_and_what_it_could_not_read(recording, view, tmp_path):
    status, out, _ = view(recording, "--output", tmp_path / "good.rrd", "--layout", "timing")
    assert status == 0
    assert "the first picture came after" in out
    assert "dropped 0, unreadable 0" in out
    damaged, content = tmp_path / "damaged.mcap", recording.read_bytes()
    damaged.write_bytes(content[: len(content) // 2] + b"\xff" * 64 + content[len(content) // 2 + 64 :])
    status, _, error = view(damaged, "--output", tmp_path / "bad.rrd")
    assert status in (1, 2)
    assert "is damaged; only what lies before the damage can be read" in error


def test_the_command_names_messages_that_are_none(session_messages, view, tmp_path):
    path = tmp_path / "session.mcap"
    writer = RecordingWriter(path)
    for number, payload in enumerate((b"\xff\xff\xff", encode(session_messages[topics.LOG]))):
        writer.write(topics.LOG, Entry(key("test", topics.LOG, MAIN, "planner"), 1, number, payload, 10**18, 10**18))
    writer.close()
    status, out, _ = view(path, "--output", tmp_path / "session.rrd")
    assert status == 0
    assert "not shown: 1 of */log could not be read" in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere.mcap",), "nowhere.mcap cannot be read"),
        ((__file__, "--output", "x.rrd"), "is no recording"),
        (("--from", "1"), "cuts a recording, and none is named"),
        (("{recording}", "--output", "{recording}"), "exists already; give another name"),
        (("{recording}", "--output", "{another}"), "exists already; give another name"),
        (("{recording}", "--from", "soon", "--output", "x.rrd"), "--from 'soon' is no moment"),
        (("{recording}",), "there is no screen here"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(arguments, said, recording, view, tmp_path):
    (another := tmp_path / "another.mcap").touch()
    names = {"recording": recording, "another": another}
    status, _, error = view(*(argument.format(**names) for argument in arguments))
    assert status == 2
    assert said in error
    assert len(error.strip().splitlines()) == 1


def test_a_viewer_that_is_closed_ends_the_file_where_it_has_come_to(recording, tmp_path):
    viewer = RecordedViewer(tmp_path / "part.rrd", "file", "session", "operate", thin=False)
    viewer.show(itertools.cycle(list(read_recording(recording))))
    assert viewer.first_picture.wait(60)
    report = viewer.close()
    assert viewer.finished.wait(60)
    assert "/world/left/image" in rows_of(report.path)


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_view_of_a_layout_complains(layout, recording, shown_by_rerun, tmp_path):
    _, report = show(recording, tmp_path / "session.rrd", layout=layout, to_s=1.0)
    assert "capture at 30%" in words(rows_of(report.path))
    shown_by_rerun(report.path, "capture_time")
