"""What a running session shows, read back from the file that it leaves."""

import collections
import dataclasses
import random
import threading

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from agents.viewer import live, screen, sinks
from agents.viewer.entity import Moment
from agents.viewer.layout import DEFAULT, Scene, live_layout
from agents.viewer.live import LiveViewer, ViewerError
from agents.viewer.sinks import FLUSHED_EVERY, file_sink
from schemas import topics
from schemas.codec import encode
from schemas.messages import ExecutionKind, Image, ImageEncoding, ReplayClock, RobotMode, Status, StereoFrame, Verdict
from schemas.topics import MAIN, Delivery, key
from shared.runtime.attachment import Attachment
from shared.runtime.taps import Tapped
from tests.agents.viewer.conftest import STAMP, in_metres, rows_of, values, words

PUBLISHED_NS = STAMP.capture_left_ns + 30_000_000


@pytest.fixture(scope="module", autouse=True)
def patient_viewer():
    """A test machine may stall for longer than who closes a viewer waits for its file."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(live, "DRAIN_S", 60.0)
        yield


def tapped(topic, message, after_ns=0, numbered=True):
    """A message as it travels, published a while after its frame was seen."""
    payload = message if isinstance(message, bytes) else encode(message)
    agent = "perception" if topic.agent == topics.ANY_AGENT else topic.agent
    name = key("test", topic, "psm1" if topic.per_arm else MAIN, agent)
    return Tapped(topic, name, payload, Attachment(1, 0, PUBLISHED_NS + after_ns, 12.5) if numbered else None)


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Shows messages and returns the report with what the file then holds: entity to rows of columns."""

    def run(*some):
        path = tmp_path_factory.mktemp("shown") / "session.rrd"
        viewer = LiveViewer(path, "file", "session")
        for message in some:
            viewer.put(message)
        return viewer.close(), rows_of(path)

    return run


def later(message, frames=1):
    """The same of so many frames later, a second apart."""
    stamp = message.stamp
    moved = dataclasses.replace(
        stamp, sequence=stamp.sequence + frames, capture_left_ns=stamp.capture_left_ns + frames * 10**9
    )
    return dataclasses.replace(message, stamp=moved)


@pytest.fixture(scope="module")
def whole_session(session_messages, shown):
    return shown(*(tapped(topic, message) for topic, message in session_messages.items()))


def test_every_published_topic_is_shown_and_the_file_holds_what_each_tells(session_messages, whole_session):
    published = {topic for topic in topics.TOPICS if topic.delivery is not Delivery.COMMAND}
    assert set(session_messages) == published
    report, rows = whole_session
    assert report.shown == {str(topic): 1 for topic in published}
    assert not (report.dropped or report.thinned or report.unreadable)
    assert len(RrdReader(report.path).blueprints()) >= 1
    for entity in (
        "/world/left/mask", "/world/right/mask", "/world/thread/regions", "/world/observations/points",
        "/world/plan/psm1/fingers", "/confidence", "/plan/report", "/robot/joints/psm1", "/operator/psm1/heartbeat",
        "/replay/rate", "/world/tail/psm1", "/lanes/psm1/tail",
    ):  # fmt: skip
        assert entity in rows, entity
    said = words(rows)
    for text in (
        "planner: nothing in reach", "operator/goal of psm1 at s = 0.400 from surgeon: refused (OFF_THREAD)",
        "phase reached slide", "simulator: grasp held", "the segmenter is slow", "capture at 30%, slide 9 mm",
        "FAULT SWAPPED", "tension: it is held in the tissue",
    ):  # fmt: skip
        assert text in said, text
    assert "NOTE SMALL" not in said
    frame = session_messages[topics.FRAMES]
    for side, image, media in (("left", frame.left, "image/jpeg"), ("right", frame.right, "image/png")):
        (row,) = rows[f"/world/{side}/image"]
        assert (bytes(row["EncodedImage:blob"][0]), row["EncodedImage:media_type"]) == (image.data, [media])
    assert values(rows, "/tail/length_mm/psm1", "Scalars:scalars")[0] == pytest.approx([25.0, 24.02, 25.98, 20.0])
    health = {entity: values(rows, entity, "Scalars:scalars")[0] for entity in rows if entity.startswith("/health/")}
    assert health == {
        "/health/rate_hz/perception/perception\\/observations": [28.0],
        "/health/lost/perception/camera\\/frames": [3.0],
        "/health/replaced/perception/camera\\/frames": [7.0],
        "/health/age_ms/perception/camera\\/frames": [10.0],
        "/health/step_ms/perception/p50": [12.0],
        "/health/step_ms/perception/p99": [31.0],
        "/health/processor_percent/perception": [25.0],
        "/health/memory_mib/perception": [64.0],
        "/health/clock_ahead_ms/camera": [3.5],
    }


def test_frames_and_what_descends_from_them_stand_at_their_capture_and_the_rest_at_its_own_time(whole_session):
    _, rows = whole_session
    for entity in ("/world/left/image", "/world/thread/curve", "/world/left/mask", "/plan/probability"):
        (row,) = [row for row in rows[entity] if row.get("capture_time") is not None]
        assert (row["capture_time"], row["frame"]) == (STAMP.capture_left_ns, STAMP.sequence), entity
    for entity in ("/robot/jaw_deg/psm1", "/world/truth", "/log/perception", "/operator/psm1/heartbeat"):
        times = [row["capture_time"] for row in rows[entity] if row.get("frame") is None]
        assert STAMP.capture_left_ns + 5_000_000 in times, entity
    for stage in ("camera", "perception", "surface", "reconstruction", "planner"):
        assert values(rows, f"/latency/{stage}", "Scalars:scalars") == [[30.0]]
        assert values(rows, f"/step_ms/{stage}", "Scalars:scalars") == [[12.5]]


def test_everything_in_space_is_in_millimetres_whatever_the_calibrations_unit(whole_session, scene):
    _, rows = whole_session
    for entity in ("/world/thread/curve", "/world/truth"):
        (strips,) = values(rows, entity, "LineStrips3D:strips")
        points = np.concatenate(strips)
        assert np.linalg.norm(points[:, None] - scene.curve[None], axis=2).min(axis=1).max() < 0.1
    (path,) = values(rows, "/world/plan/psm1/path", "LineStrips3D:strips")
    assert np.allclose(np.array(path)[:, :, 2], [[50, 70], [70, 75], [75, 75]])
    assert values(rows, "/world/right", "Transform3D:translation") == [[[5.5, 0.0, 0.0]]]
    ((left, right),) = values(rows, "/world/tool/psm1/fingers", "LineStrips3D:strips")
    pin = np.array([10.0, 20.0, 80.0])
    assert np.allclose([left[0], right[0]], pin, atol=1e-4)
    reach = np.array([left[1], right[1]]) - pin
    assert np.allclose(np.linalg.norm(reach, axis=1), 10.2, atol=1e-4)
    assert np.allclose(reach[:, 0], 0, atol=1e-4)
    assert np.allclose(np.arctan2(reach[:, 1], reach[:, 2]), [0.5, -0.5], atol=1e-5)
    ((shaft,),) = values(rows, "/world/tool/psm1/shaft", "LineStrips3D:strips")
    pin, wrist, up = np.array(shaft)
    remote_centre = np.array([0.0, 20.0, 200.0])
    assert np.linalg.norm(wrist - pin) == pytest.approx(9.1, abs=1e-3)
    along = (remote_centre - wrist) / np.linalg.norm(remote_centre - wrist)
    assert np.allclose((up - wrist) / np.linalg.norm(up - wrist), along, atol=1e-5)


def test_residuals_are_those_of_the_frame_that_a_thread_comes_from_and_a_failure_empties_the_thread(
    scene, failed, shown
):
    thread = in_metres(scene.reconstruction)
    threads = thread, later(thread), later(failed, 2)
    _, rows = shown(
        tapped(topics.OBSERVATIONS, in_metres(scene.observations)), *(tapped(topics.THREAD, each) for each in threads)
    )

    def curve(entity):
        return [value for (value,) in values(rows, entity, "Scalars:scalars")]

    assert curve("/residual_px/left/median") == pytest.approx([0.3, np.nan, np.nan], abs=0.02, nan_ok=True)
    whiskers = values(rows, "/world/left/residuals_x20", "LineStrips2D:strips")
    assert [len(lines) > 100 for lines in whiskers] == [True, False, False]
    worst = curve("/deviation/worst")
    assert worst == pytest.approx([worst[0], worst[0], np.nan], nan_ok=True)
    tubes = values(rows, "/world/thread/posterior", "Mesh3D:vertex_positions")
    corners = np.array(tubes[0])
    assert np.linalg.norm(corners[:, None] - scene.curve[None], axis=2).min(axis=1).max() < 5, "millimetres"
    assert len(rows["/world/thread/posterior"]) > len([tube for tube in tubes if tube])
    assert values(rows, "/lanes/reconstruction", "StateChange:state") == [["ok"], ["failed"]]
    assert values(rows, "/world/thread/curve", "LineStrips3D:strips")[-1] == []
    assert "is the thread in focus?" in words(rows)


def test_images_that_are_not_rectified_stand_apart_from_what_was_measured_and_raw_ones_are_compressed(
    session_messages, shown
):
    bent = dataclasses.replace(session_messages[topics.CALIBRATION], distortion_left=np.full(5, 0.01))
    raw = Image(ImageEncoding.RAW, 64, 48, 3, bytes(64 * 48 * 3))
    _, rows = shown(tapped(topics.CALIBRATION, bent), tapped(topics.FRAMES, StereoFrame(STAMP, raw, raw)))
    assert rows["/camera/raw/left"][0]["EncodedImage:media_type"] == ["image/jpeg"]
    assert "/world/left/image" not in rows


def test_what_was_found_in_a_right_image_that_was_moved_lies_on_the_image_as_it_came(scene, session_messages, shown):
    shows = []
    for rows_up in (0, 3):
        observed = dataclasses.replace(scene.observations, rows_moved_up=rows_up)
        some = session_messages[topics.CALIBRATION], observed, scene.reconstruction
        _, rows = shown(*map(tapped, (topics.CALIBRATION, topics.OBSERVATIONS, topics.THREAD), some))
        shows.append(rows)
    for what in ("mask", "centrelines", "residuals_x20"):
        for side, down in (("left", 0), ("right", 3)):
            before, after = (values(rows, f"/world/{side}/{what}", "LineStrips2D:strips")[0] for rows in shows)
            for line, moved in zip(before, after, strict=True):
                assert np.allclose(np.array(moved) - line, [0, down], atol=1e-3)
    before, after = (np.array(values(rows, "/world/right", "Pinhole:image_from_camera")[0]).ravel() for rows in shows)
    assert (after - before)[7] == 3


def test_lanes_follow_modes_phases_and_results_and_are_logged_when_they_change(session_messages, shown):
    def told(topic, **changed):
        return tapped(topic, dataclasses.replace(session_messages[topic], **changed))

    modes = [RobotMode.IDLE, RobotMode.IDLE, RobotMode.MOVING, RobotMode.MOVING, RobotMode.HOLDING]
    stopped = {"phase": None, "code": "STALE", "reason": "too old"}
    _, rows = shown(
        *(
            tapped(topics.ROBOT_STATE, dataclasses.replace(session_messages[topics.ROBOT_STATE], mode=mode), 10**8 * k)
            for k, mode in enumerate(modes)
        ),
        told(topics.EXECUTION),
        told(topics.EXECUTION, kind=ExecutionKind.REFUSED, **stopped),
        told(topics.EXECUTION, kind=ExecutionKind.HELD, **stopped),
        told(topics.JUDGEMENT, verdict=Verdict.MISSED),
        told(topics.PLAN),
        told(topics.PLAN, arm="psm2"),
        told(topics.PLAN, status=Status.FAILED, reason="out of reach of psm1", waypoints=()),
    )
    assert values(rows, "/lanes/psm1/mode", "StateChange:state") == [["idle"], ["moving"], ["holding"]]
    assert values(rows, "/lanes/psm1/phase", "StateChange:state") == [["slide"], ["held"]]
    assert values(rows, "/lanes/psm1/verdict", "StateChange:state") == [["missed"]]
    assert "refused (STALE): too old" in words(rows)
    # a rejected grasp empties the plan before it, and no other arm's
    assert values(rows, "/world/plan/psm1/path", "LineStrips3D:strips")[-1] == []
    assert values(rows, "/world/plan/psm2/path", "LineStrips3D:strips")[-1] != []
    assert "no plan for psm1: out of reach of psm1" in words(rows)


def test_what_cannot_be_read_is_counted_and_named_and_the_next_message_is_shown(session_messages, shown):
    frame, observations = session_messages[topics.FRAMES], session_messages[topics.OBSERVATIONS]
    no_image = Image(ImageEncoding.JPEG, 960, 540, 3, b"no image at all")
    bad = [
        (topics.FRAMES, b"\xff\xff\xff"),
        (topics.THREAD, b""),
        (topics.PLAN, encode(session_messages[topics.LOG])),
        (topics.FRAMES, StereoFrame(frame.stamp, no_image, frame.right)),
        (topics.OBSERVATIONS, dataclasses.replace(observations, mask_left=no_image)),
    ]
    report, rows = shown(
        *(tapped(topic, message) for topic, message in bad), tapped(topics.LOG, session_messages[topics.LOG])
    )
    assert report.unreadable == collections.Counter(str(topic) for topic, _ in bad)
    assert report.shown == {"*/log": 1}
    assert "ThreadReconstruction" in words(rows)
    assert "15 bytes are no JPEG" in words(rows)
    assert values(rows, "/viewer/unreadable/camera\\/frames", "Scalars:scalars")[-1] == [2.0]


def test_the_largest_numbers_that_travel_and_messages_without_a_number_are_shown(session_messages, shown):
    frame, state = session_messages[topics.FRAMES], session_messages[topics.ROBOT_STATE]
    far = dataclasses.replace(frame.stamp, sequence=2**64 - 1, capture_left_ns=2**63 - 1)
    far_off = np.eye(4)
    far_off[:3, 3] = 1e300
    report, _ = shown(
        tapped(topics.FRAMES, dataclasses.replace(frame, stamp=far)),
        tapped(topics.ROBOT_STATE, dataclasses.replace(state, T_base_tool=far_off, jaw_rad=1e300)),
        tapped(topics.REPLAY_CLOCK, ReplayClock(-(2**63), 1e308)),
    )
    assert sum(report.shown.values()) + sum(report.unreadable.values()) == 3
    published = topics.FRAMES, topics.THREAD, topics.ROBOT_STATE, topics.LOG
    report, rows = shown(*(tapped(topic, session_messages[topic], numbered=False) for topic in published))
    assert report.shown == {str(topic): 1 for topic in published}
    assert "/latency/camera" not in rows


@pytest.fixture
def stuck(monkeypatch):
    """Make logging wait in the thread of that name until it is released; it has been entered, and it is released."""
    released, entered = threading.Event(), threading.Event()
    log = sinks.Sink.log

    def make(thread):
        def wait_and_log(self, moment, entities):
            if threading.current_thread().name == thread:
                entered.set()
                assert released.wait(60)
            log(self, moment, entities)

        monkeypatch.setattr(sinks.Sink, "log", wait_and_log)
        return entered, released

    yield make
    released.set()


def flood(viewer, session_messages, count):
    for number in range(count):
        viewer.put(tapped(topics.ROBOT_STATE, session_messages[topics.ROBOT_STATE], number * 100_000_000))


@pytest.mark.parametrize("for_good", [False, True])
def test_a_stuck_file_holds_up_neither_who_puts_nor_the_end_and_drops_the_oldest(
    session_messages, tmp_path, stuck, monkeypatch, for_good
):
    entered, released = stuck("viewer")
    viewer = LiveViewer(tmp_path / "session.rrd", "file", "session")
    viewer.put(tapped(topics.LOG, session_messages[topics.LOG]))
    assert entered.wait(60)
    flood(viewer, session_messages, live.ROOM_LATEST + 70)
    if for_good:
        monkeypatch.setattr(live, "DRAIN_S", 0.2)
        assert "the end is not shown" in viewer.close().notes[0]
        return
    released.set()
    report = viewer.close()
    assert report.dropped == {"robot_bridge/state": 70}
    assert report.shown == {"*/log": 1, "robot_bridge/state": live.ROOM_LATEST}
    assert values(rows_of(report.path), "/viewer/dropped/robot_bridge\\/state", "Scalars:scalars")[-1] == [70.0]


def test_a_screen_that_is_frozen_holds_up_neither_the_file_nor_the_end(session_messages, tmp_path, stuck, monkeypatch):
    stuck("screen")
    monkeypatch.setattr(screen, "ROOM", 5)
    monkeypatch.setattr(screen, "DRAIN_S", 0.2)
    monkeypatch.setattr(screen, "open_page", lambda _: "http://localhost:9090")
    viewer = LiveViewer(tmp_path / "session.rrd", "web", "session")
    flood(viewer, session_messages, live.ROOM_LATEST)
    report = viewer.close()
    assert report.shown == {"robot_bridge/state": live.ROOM_LATEST}
    assert len(rows_of(report.path)["/robot/jaw_deg/psm1"]) == live.ROOM_LATEST
    assert report.dropped["screen"] >= live.ROOM_LATEST - 6
    assert "http://localhost:9090" in report.notes[0]


@pytest.mark.parametrize(("display", "why"), [("", "no screen"), ("nowhere:99", "closed at once")])
def test_a_window_that_does_not_open_is_said_to_be_missing_and_the_file_is_written(
    session_messages, tmp_path, monkeypatch, display, why
):
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sinks, "WINDOW_OPENS_S", 60.0)
    viewer = LiveViewer(tmp_path / "session.rrd", "native", "session")
    viewer.put(tapped(topics.LOG, session_messages[topics.LOG]))
    report = viewer.close()
    assert why in report.notes[0]
    assert viewer.address in report.notes[0]
    assert "/log/planner" in rows_of(report.path)


def test_a_file_that_cannot_be_written_is_refused_with_its_name(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ViewerError, match=r"session\.rrd cannot be written"):
        LiveViewer(tmp_path / "file" / "session.rrd", "file", "session")


def test_every_moment_is_in_one_of_the_files_of_a_long_session_and_what_always_holds_in_each(tmp_path):
    sink = file_sink(tmp_path / "session.rrd", "long", live_layout(DEFAULT, Scene()), part_bytes=200_000)
    sink.log(Moment(0), [("curve", [rr.SeriesLines(names="a name")])])
    noise, moments = random.Random(1), range(1, 6 * FLUSHED_EVERY)
    for number in moments:
        blob = rr.EncodedImage(contents=noise.randbytes(4096), media_type="image/jpeg")
        sink.log(Moment(number), [("image", [blob])])
    sink.close()
    parts = sorted(tmp_path.glob("session*.rrd"))
    assert [part.name for part in parts[:3]] == ["session.rrd", "session_part2.rrd", "session_part3.rrd"]
    found = [rows_of(part) for part in parts]
    assert sorted(row["capture_time"] for rows in found for row in rows.get("/image", ())) == list(moments)
    assert all("/curve" in rows for rows in found)
