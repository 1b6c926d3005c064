import dataclasses
import itertools
import subprocess
import sys

import numpy as np
import pytest

from agents.cli.main import main
from agents.viewer.live import LiveViewer
from agents.viewer.live_layout import LAYOUTS
from agents.viewer.recorded import RecordedViewer, between, tapped_of
from schemas import topics
from schemas.codec import encode
from schemas.messages import RobotMode
from schemas.topics import MAIN, Delivery, key
from shared.recording.mcap_file import Entry, RecordingWriter, read_recording
from tests.agents.viewer.test_live import headless_environment, rows_of, values, words

SECONDS = 4
STATES_HZ = 100


@pytest.fixture(scope="module")
def recording(session_messages, scene, tmp_path_factory):
    """Four seconds of a session: every topic at first, then an arm's state a hundred times a second."""
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


def show(recording, path, **options):
    viewer = RecordedViewer(path, "file", "session", options.pop("layout", "operate"), options.pop("thin", False))
    viewer.show(between(read_recording(recording), options.pop("from_s", None), options.pop("to_s", None)))
    assert viewer.finished.wait(120)
    assert viewer.error is None
    return viewer, viewer.close()


def test_every_message_of_a_recording_is_shown_unless_thinning_is_asked_for(recording, tmp_path):
    viewer, whole = show(recording, tmp_path / "whole.rrd")
    assert sum(whole.shown.values()) == sum(1 for _ in read_recording(recording))
    assert not (whole.thinned or whole.dropped or whole.unreadable or viewer.unknown)
    assert len(rows_of(whole.path)["/robot/jaw_deg/psm1"]) == SECONDS * STATES_HZ
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


@pytest.fixture(scope="module")
def rows(recording, tmp_path_factory):
    """What the viewer is given of the whole recording."""
    return rows_of(show(recording, tmp_path_factory.mktemp("shown") / "session.rrd")[1].path)


def test_step_times_that_are_in_no_recording_are_left_out(rows):
    assert not [entity for entity in rows if entity.startswith("/step_ms/")]
    assert values(rows, "/latency/reconstruction", "Scalars:scalars") == [[30.0]]


def test_what_it_took_to_arrive_is_the_least_of_a_second(rows):
    took = values(rows, "/clock/arrival_ms/robot_bridge/psm1", "Scalars:scalars")
    assert [value for (value,) in took] == pytest.approx([2.0] * (SECONDS - 1), abs=1e-6)


def run_view(*arguments, **options):
    command = [sys.executable, "-m", "agents.cli", "view", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, **options)


def test_the_command_writes_a_recording_tells_how_far_it_is_and_what_it_could_not_read(recording, tmp_path):
    damaged = tmp_path / "damaged.mcap"
    content = recording.read_bytes()
    damaged.write_bytes(content[: len(content) // 2] + b"\xff" * 64 + content[len(content) // 2 + 64 :])
    good = run_view(recording, "--output", tmp_path / "good.rrd", "--layout", "timing")
    assert good.returncode == 0, good.stderr
    assert "the first picture came after" in good.stdout
    assert "dropped 0, unreadable 0" in good.stdout
    bad = run_view(damaged, "--output", tmp_path / "bad.rrd")
    assert bad.returncode in (1, 2)
    assert "is damaged; only what lies before the damage can be read" in bad.stderr


def test_the_command_names_messages_that_are_none(session_messages, tmp_path):
    path = tmp_path / "session.mcap"
    writer = RecordingWriter(path)
    for number, payload in enumerate((b"\xff\xff\xff", encode(session_messages[topics.LOG]))):
        writer.write(topics.LOG, Entry(key("test", topics.LOG, MAIN, "planner"), 1, number, payload, 10**18, 10**18))
    writer.close()
    seen = run_view(path, "--output", tmp_path / "session.rrd")
    assert seen.returncode == 0
    assert "not shown: 1 of */log could not be read" in seen.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere.mcap",), "nowhere.mcap cannot be read"),
        ((__file__, "--output", "x.rrd"), "is no recording"),
        (("--from", "1"), "cuts a recording, and none is named"),
        (("{recording}", "--output", "{recording}"), "is the recording itself"),
        (("{recording}",), "there is no screen here"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(arguments, said, recording, monkeypatch, capfd):
    for screen in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(screen, raising=False)
    with pytest.raises(SystemExit) as end:
        main(["view", *(str(argument).replace("{recording}", str(recording)) for argument in arguments)])
    assert end.value.code == 2
    told = capfd.readouterr().err
    assert said in told
    assert len(told.strip().splitlines()) == 1


def test_a_viewer_that_is_closed_ends_the_file_where_it_has_come_to(recording, tmp_path):
    viewer = RecordedViewer(tmp_path / "part.rrd", "file", "session", "operate", thin=False)
    viewer.show(itertools.cycle(list(read_recording(recording))))
    assert viewer.first_picture.wait(60)
    report = viewer.close()
    assert viewer.finished.wait(60)
    assert "/world/left/image" in rows_of(report.path)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_view_of_a_layout_complains(layout, recording, tmp_path):
    environment, shot = headless_environment(tmp_path)
    _, report = show(recording, tmp_path / "session.rrd", layout=layout, to_s=1.0)
    assert "capture at 30%" in words(rows_of(report.path))
    picture = tmp_path / "shot.png"
    command = [
        sys.executable,
        str(shot),
        str(report.path),
        str(picture),
        "--timeline",
        "capture_time",
        "--size",
        "800x450",
    ]
    seen = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120, env=environment)
    assert seen.returncode == 0, seen.stdout + seen.stderr
    assert picture.stat().st_size > 10_000
