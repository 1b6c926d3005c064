import collections
import dataclasses
import threading

import numpy as np
import pytest
from rerun.chunk import RrdReader

from agents.viewer import live, screen, sinks
from agents.viewer.live import LiveViewer, ViewerError
from agents.viewer.polyline import CORNERS
from schemas import topics
from schemas.codec import encode
from schemas.messages import (
    ExecutionKind,
    Image,
    ImageEncoding,
    ReplayClock,
    RobotMode,
    Status,
    StereoFrame,
    Verdict,
)
from schemas.messages.thread import no_centrelines
from schemas.topics import MAIN, Delivery, key
from shared.runtime.attachment import Attachment
from shared.runtime.taps import Tapped

PUBLISHED_AFTER_NS = 30_000_000


@pytest.fixture(scope="module", autouse=True)
def patient_viewer():
    """A test machine may stall for longer than who closes a viewer waits for its file."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(live, "DRAIN_S", 60.0)
        yield


@pytest.fixture(scope="module")
def tapped(scene):
    captured_ns = scene.observations.stamp.capture_left_ns

    def make(topic, message, after_ns=0, numbered=True):
        """A message as it travels, published a while after its frame was seen."""
        payload = message if isinstance(message, bytes) else encode(message)
        beside = Attachment(1, 0, captured_ns + PUBLISHED_AFTER_NS + after_ns, 12.5) if numbered else None
        agent = "perception" if topic.agent == topics.ANY_AGENT else topic.agent
        return Tapped(topic, key("test", topic, "psm1" if topic.per_arm else MAIN, agent), payload, beside)

    return make


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Shows messages and returns the report with what the file then holds: entity to rows of columns."""

    def run(*messages):
        path = tmp_path_factory.mktemp("shown") / "session.rrd"
        viewer = LiveViewer(path, "file", "session")
        for message in messages:
            viewer.put(message)
        return viewer.close(), rows_of(path)

    return run


def rows_of(path):
    found = collections.defaultdict(list)
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        values = {}
        for field in batch.schema:
            column = batch.column(field.name)
            timed = str(field.type).startswith("timestamp")
            values[field.name] = column.cast("int64").to_pylist() if timed else column.to_pylist()
        found[str(chunk.entity_path)] += [
            {name: column[row] for name, column in values.items()} for row in range(batch.num_rows)
        ]
    # a file holds rows in batches; their ids count the order in which they were logged
    return {entity: sorted(rows, key=lambda row: row["rerun.controls.RowId"]) for entity, rows in found.items()}


def values(rows, entity, component):
    return [row[component] for row in rows[entity] if row.get(component) is not None]


def later(message, frames=1):
    """The same of so many frames later, a second apart."""
    stamp = message.stamp
    moved = dataclasses.replace(
        stamp, sequence=stamp.sequence + frames, capture_left_ns=stamp.capture_left_ns + frames * 10**9
    )
    return dataclasses.replace(message, stamp=moved)


def words(rows):
    logged = [row for entity, rows in rows.items() if entity.startswith("/log/") for row in rows]
    return " | ".join(row["TextLog:text"][0] for row in logged)


@pytest.fixture(scope="module")
def whole_session(session_messages, tapped, shown):
    return shown(*(tapped(topic, message) for topic, message in session_messages.items()))


def test_every_published_topic_is_shown_and_the_file_holds_what_each_tells(session_messages, whole_session):
    published = {topic for topic in topics.TOPICS if topic.delivery is not Delivery.COMMAND}
    assert set(session_messages) == published
    report, rows = whole_session
    assert report.shown == {str(topic): 1 for topic in published}
    assert not (report.dropped or report.thinned or report.unreadable)
    assert len(RrdReader(report.path).blueprints()) >= 1
    for entity in (
        "/world/left/image", "/world/right/image", "/world/left/mask", "/world/right/mask", "/world/thread/curve",
        "/world/thread/regions", "/world/observations/points", "/world/plan/psm1/path", "/world/plan/psm1/fingers",
        "/world/tool/psm1/fingers", "/world/tool/psm1/shaft", "/world/truth", "/confidence", "/plan/report",
        "/plan/probability", "/robot/joints/psm1", "/robot/jaw_deg/psm1", "/operator/psm1/heartbeat", "/replay/rate",
        "/health/step_ms/perception/p50", "/health/step_ms/perception/p99",
    ):  # fmt: skip
        assert entity in rows, entity


def test_frames_and_what_descends_from_them_stand_at_their_capture_and_the_rest_at_its_own_time(whole_session, scene):
    _, rows = whole_session
    stamp = scene.observations.stamp
    framed = "/world/left/image", "/world/thread/curve", "/world/left/mask", "/plan/probability", "/latency/camera"
    for entity in framed:
        (row,) = [row for row in rows[entity] if row.get("capture_time") is not None]
        assert (row["capture_time"], row["frame"]) == (stamp.capture_left_ns, stamp.sequence), entity
    for entity in ("/robot/jaw_deg/psm1", "/world/truth", "/log/perception", "/operator/psm1/heartbeat"):
        times = [row["capture_time"] for row in rows[entity] if row.get("frame") is None]
        assert stamp.capture_left_ns + 5_000_000 in times, entity
    for stage in ("camera", "perception", "surface", "reconstruction", "planner"):
        assert values(rows, f"/latency/{stage}", "Scalars:scalars") == [[30.0]]
        assert values(rows, f"/step_ms/{stage}", "Scalars:scalars") == [[12.5]]


def test_everything_in_space_is_in_millimetres_whatever_the_calibrations_unit(whole_session, scene):
    _, rows = whole_session
    (curve,) = values(rows, "/world/thread/curve", "LineStrips3D:strips")
    (truth,) = values(rows, "/world/truth", "LineStrips3D:strips")
    for strips in (np.concatenate(curve), np.concatenate(truth)):
        nearest = np.linalg.norm(strips[:, None] - scene.curve[None], axis=2).min(axis=1)
        assert nearest.max() < 0.1
    (path,) = values(rows, "/world/plan/psm1/path", "LineStrips3D:strips")
    assert np.allclose(np.array(path)[:, :, 2], [[50, 70], [70, 75], [75, 75]])
    assert values(rows, "/world/right", "Transform3D:translation") == [[[5.5, 0.0, 0.0]]] * 1


def test_fingers_open_about_the_pin_and_the_shaft_leads_over_the_wrist_towards_the_remote_centre(whole_session):
    _, rows = whole_session
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


def test_residuals_are_those_of_the_frame_that_a_thread_comes_from(refined, tapped, shown):
    observations, reconstruction = refined.observations, refined.reconstruction
    empty = dataclasses.replace(observations, centrelines_left=no_centrelines(), centrelines_right=no_centrelines())
    _, rows = shown(
        tapped(topics.OBSERVATIONS, observations),
        tapped(topics.OBSERVATIONS, later(empty, 1)),
        tapped(topics.THREAD, reconstruction),
        tapped(topics.THREAD, later(reconstruction, 1)),
        tapped(topics.THREAD, later(reconstruction, 2)),
    )
    medians = [value for (value,) in values(rows, "/residual_px/left/median", "Scalars:scalars")]
    assert medians == pytest.approx([0.3, np.nan, np.nan], abs=0.02, nan_ok=True)
    whiskers = values(rows, "/world/left/residuals_x20", "LineStrips2D:strips")
    assert [len(lines) > 100 for lines in whiskers] == [True, False, False]


@pytest.mark.slow
def test_a_failure_empties_the_thread_ends_its_curves_of_trust_and_is_said(
    refined_in_metres, scene, failed, tapped, shown
):
    _, rows = shown(tapped(topics.THREAD, refined_in_metres), tapped(topics.THREAD, later(failed)))
    (corners,) = [c for c in values(rows, "/world/thread/posterior", "Mesh3D:vertex_positions") if c]
    assert len(corners) == 51 * CORNERS
    assert np.linalg.norm(np.array(corners)[:, None] - scene.curve[None], axis=2).min(axis=1).max() < 5, "millimetres"
    assert len(rows["/world/thread/posterior"]) == 2
    for entity, least, most in (
        ("/deviation/mean", 0.3, 0.6),
        ("/deviation/worst", 0.6, 1.01),
        ("/share/unseen", 0.09, 0.11),
    ):
        (before,), (after,) = values(rows, entity, "Scalars:scalars")
        assert least < before < most
        assert np.isnan(after)
    assert values(rows, "/lanes/reconstruction", "StateChange:state") == [["ok"], ["failed"]]
    assert values(rows, "/world/thread/curve", "LineStrips3D:strips")[-1] == []
    assert "is the thread in focus?" in words(rows)


def test_images_go_into_the_file_as_they_travelled(whole_session, session_messages):
    _, rows = whole_session
    frame = session_messages[topics.FRAMES]
    for side, image, media in (("left", frame.left, "image/jpeg"), ("right", frame.right, "image/png")):
        (row,) = rows[f"/world/{side}/image"]
        assert bytes(row["EncodedImage:blob"][0]) == image.data
        assert row["EncodedImage:media_type"] == [media]


def test_images_that_are_not_rectified_stand_apart_from_what_was_measured_and_raw_ones_are_compressed(
    session_messages, tapped, shown
):
    bent = dataclasses.replace(session_messages[topics.CALIBRATION], distortion_left=np.full(5, 0.01))
    raw = Image(ImageEncoding.RAW, 64, 48, 3, bytes(64 * 48 * 3))
    frame = StereoFrame(session_messages[topics.FRAMES].stamp, raw, raw)
    _, rows = shown(tapped(topics.CALIBRATION, bent), tapped(topics.FRAMES, frame))
    assert rows["/camera/raw/left"][0]["EncodedImage:media_type"] == ["image/jpeg"]
    assert "/world/left/image" not in rows


def test_what_was_found_in_a_right_image_that_was_moved_lies_on_the_image_as_it_came(
    refined, session_messages, tapped, shown
):
    calibration = session_messages[topics.CALIBRATION]
    shows = []
    for rows_up in (0, 3):
        observed = dataclasses.replace(refined.observations, rows_moved_up=rows_up)
        messages = ((topics.CALIBRATION, calibration), (topics.OBSERVATIONS, observed))
        _, rows = shown(*(tapped(*one) for one in messages), tapped(topics.THREAD, refined.reconstruction))
        shows.append(rows)
    for what in ("mask", "centrelines", "residuals_x20"):
        for side, down in (("left", 0), ("right", 3)):
            before, after = (values(rows, f"/world/{side}/{what}", "LineStrips2D:strips")[0] for rows in shows)
            for line, moved in zip(before, after, strict=True):
                assert np.allclose(np.array(moved) - line, [0, down], atol=1e-3)
    before, after = (np.array(values(rows, "/world/right", "Pinhole:image_from_camera")[0]).ravel() for rows in shows)
    assert (after - before)[7] == 3


def test_words_of_every_kind_are_in_the_log(whole_session):
    said = words(whole_session[1])
    for text in (
        "planner: nothing in reach", "operator/goal of psm1 at s = 0.400 from surgeon: refused (OFF_THREAD)",
        "phase reached slide", "simulator: grasp held", "the segmenter is slow", "capture at 30%, slide 9 mm",
        "FAULT SWAPPED",
    ):  # fmt: skip
        assert text in said, text
    assert "NOTE SMALL" not in said


def test_health_is_shown_per_agent_and_topic(whole_session):
    _, rows = whole_session
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


def test_lanes_follow_modes_phases_and_results_and_are_logged_when_they_change(session_messages, tapped, shown):
    state, event = session_messages[topics.ROBOT_STATE], session_messages[topics.EXECUTION]
    modes = [RobotMode.IDLE, RobotMode.IDLE, RobotMode.MOVING, RobotMode.MOVING, RobotMode.HOLDING]
    refusal = dataclasses.replace(event, kind=ExecutionKind.REFUSED, phase=None, code="STALE", reason="too old")
    held = dataclasses.replace(refusal, kind=ExecutionKind.HELD, code="HEARTBEAT", reason="no heartbeat")
    missed = dataclasses.replace(session_messages[topics.JUDGEMENT], verdict=Verdict.MISSED)
    _, rows = shown(
        *(
            tapped(topics.ROBOT_STATE, dataclasses.replace(state, mode=mode), number * 100_000_000)
            for number, mode in enumerate(modes)
        ),
        tapped(topics.EXECUTION, event),
        tapped(topics.EXECUTION, refusal),
        tapped(topics.EXECUTION, held),
        tapped(topics.JUDGEMENT, missed),
    )
    assert values(rows, "/lanes/psm1/mode", "StateChange:state") == [["idle"], ["moving"], ["holding"]]
    assert values(rows, "/lanes/psm1/phase", "StateChange:state") == [["slide"], ["held"]]
    assert values(rows, "/lanes/psm1/verdict", "StateChange:state") == [["missed"]]
    assert "refused (STALE): too old" in words(rows)


def test_a_rejected_grasp_says_why_and_empties_the_plan_before_it_and_no_other_arms(session_messages, tapped, shown):
    plan = session_messages[topics.PLAN]
    rejected = dataclasses.replace(plan, status=Status.FAILED, reason="out of reach of psm1", waypoints=())
    other = dataclasses.replace(plan, arm="psm2")
    _, rows = shown(*(tapped(topics.PLAN, each) for each in (plan, other, rejected)))
    assert values(rows, "/world/plan/psm1/path", "LineStrips3D:strips")[-1] == []
    assert values(rows, "/world/plan/psm2/path", "LineStrips3D:strips")[-1] != []
    assert "no plan for psm1: out of reach of psm1" in words(rows)


def test_a_fast_topic_is_thinned_which_is_counted_apart_and_shown(session_messages, tapped, shown):
    state = session_messages[topics.ROBOT_STATE]
    messages = [tapped(topics.ROBOT_STATE, state, number * 10_000_000) for number in range(25)]
    report, rows = shown(*messages)
    assert report.shown["robot_bridge/state"] + report.thinned["robot_bridge/state"] == 25
    assert report.shown["robot_bridge/state"] == 5 + (messages[0].beside.published_ns % 50_000_000 > 0)
    assert not report.dropped
    assert values(rows, "/viewer/thinned/robot_bridge\\/state", "Scalars:scalars")[-1] == [
        float(report.thinned["robot_bridge/state"])
    ]


def test_what_cannot_be_read_is_counted_and_named_and_the_next_message_is_shown(session_messages, tapped, shown):
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
        *(tapped(topic, message) for topic, message in bad),
        tapped(topics.LOG, session_messages[topics.LOG]),
    )
    counted = collections.Counter(str(topic) for topic, _ in bad)
    assert report.unreadable == counted
    assert report.shown == {"*/log": 1}
    said = words(rows)
    assert "ThreadReconstruction" in said
    assert "15 bytes are no JPEG" in said
    assert values(rows, "/viewer/unreadable/camera\\/frames", "Scalars:scalars")[-1] == [2.0]


def test_the_largest_numbers_that_travel_do_no_harm(session_messages, tapped, shown):
    frame, state = session_messages[topics.FRAMES], session_messages[topics.ROBOT_STATE]
    far = dataclasses.replace(frame.stamp, sequence=2**64 - 1, capture_left_ns=2**63 - 1)
    far_off = np.diag([1.0, 1.0, 1.0, 1.0])
    far_off[:3, 3] = 1e300
    report, _ = shown(
        tapped(topics.FRAMES, dataclasses.replace(frame, stamp=far)),
        tapped(topics.ROBOT_STATE, dataclasses.replace(state, T_base_tool=far_off, jaw_rad=1e300)),
        tapped(topics.REPLAY_CLOCK, ReplayClock(-(2**63), 1e308)),
        tapped(topics.LOG, session_messages[topics.LOG]),
    )
    assert sum(report.shown.values()) + sum(report.unreadable.values()) == 4
    assert report.shown["*/log"] == 1


def test_a_message_of_a_foreign_publisher_without_a_number_is_shown(session_messages, tapped, shown):
    published = topics.FRAMES, topics.THREAD, topics.ROBOT_STATE, topics.LOG
    report, rows = shown(*(tapped(topic, session_messages[topic], numbered=False) for topic in published))
    assert report.shown == {str(topic): 1 for topic in published}
    assert "/latency/camera" not in rows


@pytest.fixture
def stuck_file(monkeypatch):
    """Sinks whose first log does not return until it is released."""
    released, entered = threading.Event(), threading.Event()
    log = sinks.Sink.log

    def wait_and_log(self, moment, entities):
        entered.set()
        assert released.wait(60)
        log(self, moment, entities)

    monkeypatch.setattr(sinks.Sink, "log", wait_and_log)
    yield entered, released
    released.set()


def test_a_stuck_sink_never_holds_up_who_puts_and_drops_the_oldest(session_messages, tapped, tmp_path, stuck_file):
    entered, released = stuck_file
    viewer = LiveViewer(tmp_path / "session.rrd", "file", "session")
    viewer.put(tapped(topics.LOG, session_messages[topics.LOG]))
    assert entered.wait(60)
    state = session_messages[topics.ROBOT_STATE]
    for number in range(live.ROOM_LATEST + 70):
        viewer.put(tapped(topics.ROBOT_STATE, state, number * 100_000_000))
    released.set()
    report = viewer.close()
    assert report.dropped == {"robot_bridge/state": 70}
    assert report.shown == {"*/log": 1, "robot_bridge/state": live.ROOM_LATEST}
    rows = rows_of(report.path)
    assert values(rows, "/viewer/dropped/robot_bridge\\/state", "Scalars:scalars")[-1] == [70.0]


def test_a_file_that_stays_stuck_does_not_hold_up_the_end(session_messages, tapped, tmp_path, stuck_file, monkeypatch):
    monkeypatch.setattr(live, "DRAIN_S", 0.2)
    entered, _ = stuck_file
    viewer = LiveViewer(tmp_path / "session.rrd", "file", "session")
    viewer.put(tapped(topics.LOG, session_messages[topics.LOG]))
    assert entered.wait(60)
    assert "the end is not shown" in viewer.close().notes[0]


def test_without_a_screen_the_window_is_said_to_be_missing_and_the_file_is_written(
    session_messages, tapped, tmp_path, monkeypatch
):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    viewer = LiveViewer(tmp_path / "session.rrd", "native", "session")
    viewer.put(tapped(topics.LOG, session_messages[topics.LOG]))
    report = viewer.close()
    assert "no screen" in report.notes[0]
    assert viewer.address in report.notes[0]
    assert report.shown == {"*/log": 1}
    assert "/log/planner" in rows_of(report.path)


def test_a_window_that_closes_at_once_is_said_to_be_missing(tmp_path, monkeypatch):
    monkeypatch.setenv("DISPLAY", "nowhere:99")
    monkeypatch.setattr(sinks, "WINDOW_OPENS_S", 60.0)
    report = LiveViewer(tmp_path / "session.rrd", "native", "session").close()
    assert "closed at once" in report.notes[0]


def test_a_file_that_cannot_be_written_is_refused_with_its_name(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ViewerError, match=r"session\.rrd cannot be written"):
        LiveViewer(tmp_path / "file" / "session.rrd", "file", "session")


def test_a_screen_that_is_frozen_holds_up_neither_the_file_nor_the_end(session_messages, tapped, tmp_path, monkeypatch):
    released = threading.Event()
    log = sinks.Sink.log

    def freeze_the_screen(self, moment, entities):
        if threading.current_thread().name == "screen":
            assert released.wait(60)
        log(self, moment, entities)

    monkeypatch.setattr(sinks.Sink, "log", freeze_the_screen)
    monkeypatch.setattr(screen, "ROOM", 5)
    monkeypatch.setattr(screen, "DRAIN_S", 0.2)
    monkeypatch.setattr(screen, "open_page", lambda _: "http://localhost:9090")
    viewer = LiveViewer(tmp_path / "session.rrd", "web", "session")
    state = session_messages[topics.ROBOT_STATE]
    for number in range(live.ROOM_LATEST):
        viewer.put(tapped(topics.ROBOT_STATE, state, number * 100_000_000))
    report = viewer.close()
    released.set()
    assert report.shown == {"robot_bridge/state": live.ROOM_LATEST}
    assert len(rows_of(report.path)["/robot/jaw_deg/psm1"]) == live.ROOM_LATEST
    assert report.dropped["screen"] >= live.ROOM_LATEST - 6
    assert "http://localhost:9090" in report.notes[0]
