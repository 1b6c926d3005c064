"""A recording in the viewer: all of it, by the same mapping as live, and the command that shows it."""

import dataclasses
import itertools

import numpy as np
import pytest
from rerun.chunk import RrdReader

from agents.cli.main import main
from agents.viewer.layout import LAYOUTS
from agents.viewer.live import LiveViewer
from agents.viewer.recorded import RecordedViewer, tapped_of
from schemas import topics
from schemas.codec import encode
from schemas.messages import RobotMode
from schemas.topics import MAIN, key
from shared.recording.mcap_file import Entry, RecordingWriter, read_recording
from shared.recording.stretch import stretch
from tests.agents.viewer.conftest import STAMP, rows_of, values, words

SECONDS = 3
STATES_HZ = 100


@pytest.fixture(scope="module")
def recording(session_messages, tmp_path_factory):
    """Three seconds of a session: every topic at first, then an arm's state a hundred times a second."""
    path = tmp_path_factory.mktemp("recording") / "session.mcap"
    writer = RecordingWriter(path)

    def write(topic, message, number, after_ns):
        agent = "perception" if topic.agent == topics.ANY_AGENT else topic.agent
        name = key("test", topic, "psm1" if topic.per_arm else MAIN, agent)
        published_ns = STAMP.capture_left_ns + 30_000_000 + after_ns
        # by a clock that is ahead, over a network that takes longer or shorter
        received_ns = published_ns + (number % 10 - 2) * 1_000_000
        writer.write(topic, Entry(name, 1, number, encode(message), published_ns, received_ns))

    for topic, message in session_messages.items():
        if topic.recorded:
            write(topic, message, 0, 0)
    state = dataclasses.replace(session_messages[topics.ROBOT_STATE], mode=RobotMode.IDLE)
    for number in range(1, SECONDS * STATES_HZ):
        after_ns = number * 1_000_000_000 // STATES_HZ
        moved = dataclasses.replace(state, measured_ns=STAMP.capture_left_ns + after_ns)
        write(topics.ROBOT_STATE, moved, number, after_ns)
    writer.close()
    return path


def show(recording, path, layout="operate", thin=False, some=None):
    viewer = RecordedViewer(path, "file", "session", layout, thin)
    viewer.show(itertools.islice(read_recording(recording), some))
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


def test_every_message_of_a_recording_is_shown_unless_thinning_is_asked_for(recording, whole, rows, tmp_path):
    viewer, report = whole
    assert sum(report.shown.values()) == sum(1 for _ in read_recording(recording))
    assert not (report.thinned or report.dropped or report.unreadable or viewer.unknown)
    assert len(rows["/robot/jaw_deg/psm1"]) == SECONDS * STATES_HZ
    _, thin = show(recording, tmp_path / "thin.rrd", thin=True)
    assert thin.thinned["robot_bridge/state"] + thin.shown["robot_bridge/state"] == SECONDS * STATES_HZ
    assert thin.shown["robot_bridge/state"] == pytest.approx(20 * SECONDS, abs=1)
    counted = values(rows_of(thin.path), "/viewer/thinned/robot_bridge\\/state", "Scalars:scalars")
    assert counted[-1] == [thin.thinned["robot_bridge/state"]]


def test_a_recording_is_shown_as_the_rig_was_with_its_latencies(recording, rows, tmp_path):
    live = LiveViewer(tmp_path / "live.rrd", "file", "session")
    for tapped in [tapped_of(entry) for entry in read_recording(recording) if entry.sequence == 0]:
        assert tapped is not None
        live.put(tapped)
    seen_live = rows_of(live.close().path)
    assert set(seen_live) <= set(rows)
    for entity, component in (
        ("/world/thread/curve", "LineStrips3D:strips"),
        ("/world/plan/psm1/considered", "Points3D:positions"),
        ("/latency/reconstruction", "Scalars:scalars"),
    ):
        assert values(seen_live, entity, component) == values(rows, entity, component) != []
    assert values(rows, "/latency/reconstruction", "Scalars:scalars") == [[30.0]]
    took = values(rows, "/clock/arrival_ms/robot_bridge/psm1", "Scalars:scalars")
    assert [value for (value,) in took] == pytest.approx([-2.0] * (SECONDS - 1), abs=1e-6)
    # a recording does not hold how long steps took
    assert not [entity for entity in rows if entity.startswith("/step_ms/")]


def test_part_of_a_recording_has_what_still_holds_from_before_it(recording, session_messages):
    bent = dataclasses.replace(session_messages[topics.CALIBRATION], distortion_left=np.full(5, 0.01))
    entries = list(read_recording(recording))
    frame = next(e for e in entries if e.key.endswith("camera/main/frames"))
    calibration = next(e for e in entries if e.key.endswith("calibration"))
    begin_ns = entries[0].received_ns
    late = dataclasses.replace(frame, sequence=1, received_ns=begin_ns + 2_000_000_000)
    told = dataclasses.replace(calibration, payload=encode(bent))
    part = list(stretch([told, frame, late], begin_ns + 10**9, begin_ns + 3 * 10**9))
    assert [entry.key for entry in part] == [calibration.key, frame.key]
    assert part[1].sequence == 1
    begin_ns += 10**9
    passing = [e for e in stretch(entries, begin_ns, begin_ns + 5 * 10**8) if e.received_ns >= begin_ns]
    some = [entry.received_ns - begin_ns for entry in passing]
    assert max(some) <= 500_000_000
    assert len(some) == pytest.approx(0.5 * STATES_HZ, abs=2)


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


def test_the_command_writes_a_recording_and_names_what_it_could_not_read(recording, session_messages, view, tmp_path):
    status, out, _ = view(recording, "--output", tmp_path / "good.rrd", "--layout", "timing")
    assert status == 0
    assert "the first picture came after" in out
    assert "dropped 0, unreadable 0" in out
    damaged, content = tmp_path / "damaged.mcap", recording.read_bytes()
    damaged.write_bytes(content[: len(content) // 2] + b"\xff" * 64 + content[len(content) // 2 + 64 :])
    status, _, error = view(damaged, "--output", tmp_path / "bad.rrd")
    assert status in (1, 2)
    assert "is damaged; only what lies before the damage can be read" in error
    writer = RecordingWriter(tmp_path / "odd.mcap")
    for number, payload in enumerate((b"\xff\xff\xff", encode(session_messages[topics.LOG]))):
        writer.write(topics.LOG, Entry(key("test", topics.LOG, MAIN, "planner"), 1, number, payload, 10**18, 10**18))
    writer.close()
    status, out, _ = view(tmp_path / "odd.mcap", "--output", tmp_path / "odd.rrd")
    assert status == 0
    assert "not shown: 1 of */log could not be read" in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere.mcap",), "nowhere.mcap cannot be read"),
        ((__file__, "--output", "x.rrd"), "is no recording"),
        (("--from", "1"), "cuts a recording, and none is named"),
        (("{recording}", "--output", "{recording}"), "exists already; give another name"),
        (("{recording}", "--from", "soon", "--output", "x.rrd"), "--from 'soon' is no moment"),
        (("{recording}",), "there is no screen here"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(arguments, said, recording, view):
    status, _, error = view(*(argument.format(recording=recording) for argument in arguments))
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


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_recording_is_shown_in_any_layout(layout, recording, tmp_path):
    path = tmp_path / "session.rrd"
    show(recording, path, layout=layout, some=30)
    # it is laid out anew once it is known what there is to show
    assert len(RrdReader(path).blueprints()) == 2
    assert "capture at 30%" in words(rows_of(path))
