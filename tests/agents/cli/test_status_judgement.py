"""What status judges: from what was heard of a rig to sentences, without sockets."""

import dataclasses
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from agents.cli.rig.config import CameraSection, RigConfig, simulated_rig
from agents.cli.rig.hosts import HostSection
from agents.cli.rig.topics import Override
from agents.cli.status.agents import judge_agents
from agents.cli.status.calibrations import Allowed
from agents.cli.status.gathered import ArmHeard, Gathered, expected_rates, placed_agents, placed_beside
from agents.cli.status.health_watch import STARTING, Fare, HealthWatch, span_of
from agents.cli.status.judgement import judge
from agents.cli.status.report import document, report, watched
from schemas.codec import encode
from schemas.messages import (
    AgentFacts,
    AgentHealth,
    ExecutionEvent,
    ExecutionKind,
    FrameStamp,
    HostClock,
    HostClocks,
    InputHealth,
    LogLevel,
    LogRecord,
    OutputHealth,
    RobotMode,
    RobotState,
    ToolCandidate,
    ToolCorrection,
    ToolStatus,
)
from schemas.topics import HEALTH, key
from shared.runtime.clocks import ClockOffset
from shared.runtime.config import load_config
from shared.runtime.taps import Tapped

NOW_NS = 1_800_000_000_000_000_000
DAY_S = 86400
RATES = expected_rates(simulated_rig())


def health(agent="camera", instance="main", inputs=(), outputs=(), fault="", uptime_s=60.0, version="0.2.0", host="a"):
    return AgentHealth(
        agent, instance, host, version, "hash", NOW_NS, uptime_s, 7, 2.0, 3.0, tuple(inputs), tuple(outputs), fault
    )


def fare(name="camera", told=None, silent_s=0.2, present: bool | None = True, **more):
    kind, _, instance = name.partition(" ")
    told = told if told is not None else health(kind, instance or "main")
    return Fare(name, told, silent_s, present, **more)


def heard(topic, rate_hz=30.0, age_ms=5.0, missed=0, refused=0):
    return InputHealth(topic, rate_hz, age_ms, 100, 0, missed, refused)


def facts(**told):
    values: dict[str, Any] = {
        "agent": "camera", "instance": "main", "host": "a", "at_ns": NOW_NS, "version": "0.2.0", "schemas_hash": "s",
        "config_hash": "c", "python": "3.11", "zenoh": "1", "shared_memory": True, "shared_memory_reason": "",
        "realtime_asked": None, "realtime_granted": None, "realtime_reason": "", "writes_to": "",
        "disk_free_bytes": None, "calibrated_ns": None, "certificate_expires_ns": None, "processor_s": 1.0,
        "resident_bytes": 1,
    }  # fmt: skip
    return AgentFacts(**(values | told))


def moment(*fares, **more):
    return Gathered(NOW_NS, "lab", "tcp/127.0.0.1:7447", fares=fares, rates_hz=RATES, **more)


def sentences(*fares, **more):
    return {(wrong.code, wrong.about): wrong for wrong in judge(moment(*fares, **more))}


def test_a_rig_that_is_well_has_nothing_wrong():
    camera = health(outputs=[OutputHealth("camera/frames", 29.5, 100)])
    perception = health("perception", inputs=[heard("camera/frames")])
    told = moment(fare(told=camera), fare("perception", perception), facts={"camera/main": facts()})
    assert judge(told) == []
    assert document(told, [])["well"] is True
    assert "all is well" in page(report(told, []))


def test_of_what_was_not_heard_yet_nobody_says_that_it_is_well():
    told = moment(fare(), Fare("planner", None, 0.5, None))
    assert judge(told) == []
    assert document(told, [])["well"] is None
    assert "planner was not heard yet" in page(report(told, [])) and "all is well" not in page(watched(told.fares, {}))
    assert document(moment(Fare("planner", None, 0.5, None, expected=False)), [])["well"] is True


def page(shown):
    console = Console(width=200)
    with console.capture() as capture:
        console.print(shown)
    return capture.get()


@pytest.mark.parametrize(
    ("one", "code", "told"),
    [
        (Fare("camera", None, 0.1, False), "absent", "camera is not there"),
        (Fare("camera", None, 0.1, False, placed="video"), "absent", "camera on video is not there"),
        (fare(silent_s=5.0, present=False), "gone", "camera is gone, last heard 5 s ago"),
        (fare(silent_s=5.0), "hanging", "its loop has not turned for 5 s"),
        (Fare("camera", None, 4.0, True), "hanging", "its loop has not turned for 4 s"),
        (fare(silent_s=5.0, present=None), "silent", "camera has been silent for 5 s"),
        (Fare("camera", None, 20.0, None), "silent", "camera was never heard of"),
        (fare(told=health(fault="a step failed: x")), "fault", "camera tells a fault: a step failed: x"),
    ],
)
def test_an_agent_that_is_not_well_is_named_with_how(one, code, told):
    (wrong,) = judge(moment(one))
    assert (wrong.code, wrong.about, wrong.grave) == (code, "camera", True)
    assert told in wrong.text


@pytest.mark.parametrize(
    ("one", "told"),
    [
        (Fare("guard psm1", None, 9.0, False, placed="robot"), "nothing is heard of guard psm1 on robot"),
        (fare("guard psm1", silent_s=7.0, present=False), "guard psm1 was last heard 7 s ago"),
    ],
)
def test_an_arm_by_which_no_guard_stands_is_named(one, told):
    (wrong,) = judge(moment(one))
    assert (wrong.code, wrong.about, wrong.grave) == ("guard", "guard psm1", True)
    assert wrong.text == f"no guard stands by psm1: {told}; run suturegrasp guard on its computer"


@pytest.mark.parametrize("present", [True, False, None])
def test_an_agent_that_was_heard_just_now_is_there_whatever_is_told_of_its_session(present):
    assert judge(moment(fare(silent_s=0.5, present=present))) == []


def test_nobody_misses_what_no_configuration_has():
    assert judge(moment(Fare("planner", None, 0.1, False, expected=False))) == []
    (wrong,) = judge(moment(fare("planner", silent_s=9.0, present=False, expected=False)))
    assert (wrong.code, wrong.grave) == ("gone", False)


def test_a_host_of_which_nothing_is_heard_is_named_in_place_of_its_agents():
    away = [fare(n, silent_s=s, present=False, placed="video") for n, s in (("camera", 4.0), ("perception", 6.0))]
    there = fare("planner", placed="desk")
    found = sentences(*away, there, addresses={"video": "10.0.0.2", "desk": "10.0.0.3"})
    assert list(found) == [("host", "video")]
    assert found["host", "video"].text.startswith(
        "host video (10.0.0.2) is away: camera and perception were last heard 4 s ago"
    )
    never = [Fare(name, None, 0.1, False, placed="video") for name in ("camera", "perception")]
    (wrong,) = judge(moment(*never, there, addresses={"video": "10.0.0.2"}))
    assert "nothing is heard from host video (10.0.0.2)" in wrong.text


def test_one_agent_of_a_host_that_is_away_does_not_accuse_its_host():
    found = sentences(
        fare("camera", silent_s=4.0, present=False, placed="video"),
        fare("perception", placed="video"),
        addresses={"video": "10.0.0.2"},
    )
    assert list(found) == [("gone", "camera")]


def test_a_topic_that_is_too_slow_is_told_with_its_cause():
    camera = health(outputs=[OutputHealth("camera/frames", 4.0, 100)])
    perception = health(
        "perception", inputs=[heard("camera/frames", 4.0)], outputs=[OutputHealth("perception/observations", 4.0, 9)]
    )
    found = sentences(fare(told=camera), fare("perception", perception))
    assert found["slow", "camera/frames"].text == "camera/frames comes at 4 Hz, where 30 Hz are expected"
    assert found["slow", "perception/observations"].text.endswith(", for it waits for camera/frames")


def test_a_topic_waits_for_an_agent_that_is_gone():
    perception = health(
        "perception", inputs=[heard("camera/frames", 0.0)], outputs=[OutputHealth("perception/observations", 0.0, 9)]
    )
    camera = health(outputs=[OutputHealth("camera/frames", 30.0, 100)])
    found = sentences(fare(told=camera, silent_s=4.0, present=False), fare("perception", perception))
    assert set(found) == {("gone", "camera"), ("slow", "perception/observations")}
    assert found["slow", "perception/observations"].text.endswith(", for it waits for camera/frames")


def test_rates_are_not_judged_before_they_settle_and_half_is_enough():
    young = health(outputs=[OutputHealth("camera/frames", 1.0, 1)], uptime_s=2.0)
    half = health(outputs=[OutputHealth("camera/frames", 15.0, 100)])
    assert judge(moment(fare(told=young))) == judge(moment(fare(told=half))) == []


def test_what_follows_from_frames_is_expected_as_often_as_the_camera_films():
    rates = expected_rates(RigConfig(camera=CameraSection(rate_hz=25)))
    assert [rates[t] for t in ("camera/frames", "reconstruction/thread", "robot_bridge/state")] == [25, 25, 5]
    assert "perception/surface" not in rates


def test_inputs_tell_what_was_lost_unreadable_or_old():
    perception = health(
        "perception",
        inputs=[
            heard("camera/frames", age_ms=340.0, missed=9),
            heard("planner/plan", None or 0.0, missed=1, refused=2),
        ],
    )
    found = sentences(fare("perception", perception))
    assert set(found) == {("old", "camera/frames"), ("missed", "perception"), ("refused", "perception")}
    assert "340 ms after it was sent, where 200 ms are allowed" in found["old", "camera/frames"].text
    assert found["missed", "perception"].text.startswith("1 message of planner/plan never reached perception")
    assert "refused 2 messages of planner/plan since it started 60 s ago" in found["refused", "perception"].text


def test_the_age_of_what_no_longer_comes_is_not_told():
    assert judge(moment(fare("perception", health(inputs=[heard("camera/frames", 0.0, age_ms=900.0)])))) == []


def test_versions_and_schemas_must_be_equal():
    told = {"camera/main": facts(), "planner/main": facts(agent="planner", schemas_hash="t")}
    found = sentences(fare(), fare("planner", health("planner", version="0.1.0")), facts=told)
    assert set(found) == {("version", "versions"), ("schemas", "schemas")}
    assert "0.1.0 on planner; 0.2.0 on camera" in found["version", "versions"].text


def test_an_agent_that_was_told_other_things_of_topics_is_named():
    here = (Override("*/log", "kept", 5000, 1000),)
    agree, none = facts(overrides=tuple(one.told for one in here)), facts(overrides=())
    assert judge(moment(facts={"camera/main": agree}, overrides=here)) == []
    (wrong,) = judge(moment(facts={"camera/main": agree, "robot_bridge/psm1": none}, overrides=here))
    assert (wrong.code, wrong.about, wrong.grave) == ("topics", "robot_bridge psm1", True)
    assert wrong.text.endswith("differ in */log kept 5000 (here); take the right one there and restart it")
    (wrong,) = judge(moment(facts={"camera/main": agree}))
    assert "differ in */log kept 5000;" in wrong.text


def test_a_calibration_that_is_older_than_the_rig_allows_is_worth_knowing():
    allowed = {"camera/main": Allowed(90.0, "camera.calibration_days", "calibrate")}
    old = facts(calibrated_ns=NOW_NS - 91 * DAY_S * 10**9)
    (wrong,) = judge(moment(facts={"camera/main": old}, calibrations=allowed))
    assert (wrong.code, wrong.about, wrong.grave) == ("calibration", "camera", False)
    assert wrong.text == (
        "the calibration of camera was made 91 d ago, and camera.calibration_days allows 90 days; calibrate"
    )
    for told in ({"camera/main": facts(calibrated_ns=NOW_NS - 89 * DAY_S * 10**9)}, {"camera/main": facts()}, {}):
        assert judge(moment(facts=told, calibrations=allowed)) == []


def test_a_viewer_that_nobody_expects_is_shown_on_its_host():
    lab = load_config(Path(__file__).parents[3] / "deploy" / "lab.toml", RigConfig)
    taken = []
    connection: Any = SimpleNamespace(listen=lambda _topics, take: taken.append(take))
    watch = HealthWatch(connection, ["camera"], {"camera": "video"} | placed_beside(lab))
    told = encode(health("viewer", "desk"))
    taken[0](Tapped(HEALTH, key("lab", HEALTH, "desk", "viewer"), told, None))
    fares = {one.name: (one.placed, one.expected) for one in watch.fares()}
    assert fares == {"camera": ("video", True), "viewer desk": ("desk", False)}


def test_what_a_rig_does_otherwise_with_topics_is_shown():
    told = moment(overrides=(Override("*/log", "recorded", False, True), Override("*/log", "kept", 5000, 1000)))
    assert "\notherwise than the table of topics: */log recorded false, */log kept 5000\n" in page(report(told, []))
    first = {"topic": "*/log", "setting": "recorded", "value": False, "table": True}
    assert document(told, [])["topics"][0] == first
    assert "otherwise" not in page(report(moment(), []))


@pytest.mark.parametrize(("ahead_ms", "within_ms", "wrong"), [(340, 2, True), (-340, 2, True), (340, 300, False)])
def test_a_clock_is_wrong_where_it_is_so_for_certain(ahead_ms, within_ms, wrong):
    here = sentences(clocks={"camera/main": ClockOffset("b", ahead_ms, within_ms), "planner/main": None})
    told = HostClocks(NOW_NS, (HostClock("camera", "main", "b", ahead_ms, within_ms),))
    planners = sentences(planner_clocks=told)
    assert (("clock", "b") in here) == (("clock", "b") in planners) == wrong
    both = judge(moment(clocks={"camera/main": ClockOffset("b", ahead_ms, within_ms)}, planner_clocks=told))
    assert len(both) == wrong


def robot(mode):
    return RobotState("psm1", NOW_NS, mode, np.eye(4), np.zeros(6), 0.0, np.eye(4), "")


def event(kind, code="", reason=""):
    return ExecutionEvent("plan-1", "psm1", NOW_NS - 12_000_000_000, kind, None, code, reason)


@pytest.mark.parametrize(
    ("arm", "grave", "told"),
    [
        (
            ArmHeard("psm1", robot(RobotMode.HOLDING), event(ExecutionKind.HELD, "heartbeat_lost", "no heartbeat")),
            True,
            "psm1 has held for 12 s (heartbeat_lost): no heartbeat",
        ),
        (
            ArmHeard("psm1", robot(RobotMode.HOLDING), event(ExecutionKind.HELD, "hold_command", "cli said hold")),
            False,
            "cli said hold",
        ),
        (ArmHeard("psm1", robot(RobotMode.HOLDING), event(ExecutionKind.FINISHED)), False, "psm1 holds"),
        (ArmHeard("psm1", robot(RobotMode.FAULT)), True, "psm1 has a fault"),
        (
            ArmHeard("psm1", robot(RobotMode.DISABLED), event(ExecutionKind.HELD, "not_ready", "it was disabled")),
            True,
            "psm1 is disabled and cannot be armed; its controller says why (last: it was disabled)",
        ),
    ],
)
def test_an_arm_that_stands_still_says_why(arm, grave, told):
    (wrong,) = judge(moment(arms=(arm,)))
    assert (wrong.about, wrong.grave) == ("psm1", grave)
    assert told in wrong.text


def tool(status=ToolStatus.CONVERGED, off_m=0.001, age_ns=10**8):
    usable, stamp = status is ToolStatus.CONVERGED, FrameStamp(1, NOW_NS - age_ns, NOW_NS - age_ns, "c")
    px, place = np.zeros((0, 2)), np.zeros(3)
    found = ToolCandidate(np.zeros(6), np.eye(6), np.zeros((16, 16, 16), np.uint8), 9, 0.9, 0.8, 0.5)
    figures = np.eye(4) if usable else None, place, place, off_m, 0.0, 0.0, 0.0, px, px, px, (found,), 0, 0, 1
    return ToolCorrection("psm1", stamp, 0, status, "" if usable else "it is not in view", *figures)


@pytest.mark.parametrize(
    ("heard", "corrected", "grave", "told"),
    [
        (
            tool(off_m=0.006),
            None,
            True,
            "the registration of psm1 is 6.0 mm and 0.0 degrees off by the images (drifted)",
        ),
        (tool(off_m=0.006), np.eye(4), False, "which its bridge corrects"),
        (tool(ToolStatus.LOST), None, True, "the tool of psm1 is not followed in the images: it is not in view"),
        (tool(ToolStatus.CONVERGING), None, False, "it is not in view"),
        (tool(age_ns=9 * 10**9), None, True, "was last looked for 9 s ago"),
        (tool(), None, None, ""),
    ],
)
def test_a_tool_that_is_lost_in_the_images_or_off_its_registration_is_told(heard, corrected, grave, told):
    state = dataclasses.replace(robot(RobotMode.IDLE), T_camera_base_registered=corrected)
    wrongs = judge(moment(arms=(ArmHeard("psm1", state, tool=heard),)))
    assert [wrong.grave for wrong in wrongs] == ([] if grave is None else [grave])
    assert all(told in wrong.text for wrong in wrongs)


def test_a_look_that_is_held_is_told():
    def told(age_ns):
        changes = {"T_camera_base_registered": np.eye(4), "correction_looked_ns": NOW_NS - age_ns}
        arm = ArmHeard("psm1", dataclasses.replace(robot(RobotMode.IDLE), **changes), tool=tool())
        return [(one.code, one.grave, one.text) for one in judge(moment(arms=(arm,)))]

    assert told(5 * 10**8) == []
    ((code, grave, text),) = told(3 * 10**9)
    assert (code, grave) == ("held", False)
    assert "the base of psm1 is corrected by a look of 3 s ago, which is held" in text


@pytest.mark.parametrize("mode", [RobotMode.IDLE, RobotMode.MOVING])
def test_an_arm_that_was_held_once_and_went_on_is_well(mode):
    assert judge(moment(arms=(ArmHeard("psm1", robot(mode), event(ExecutionKind.HELD, "stale", "old")),))) == []


def test_facts_tell_of_disk_real_time_and_certificates():
    told = facts(
        disk_free_bytes=100 << 20,
        writes_to="/data",
        realtime_asked=80,
        realtime_reason="it is not permitted",
        certificate_expires_ns=NOW_NS + 2 * DAY_S * 10**9,
    )
    found = sentences(facts={"camera/main": told})
    assert set(found) == {("disk", "camera"), ("realtime", "camera"), ("certificate", "camera")}
    assert "0.1 GiB are free where camera writes (/data)" in found["disk", "camera"].text
    assert "expires in 2 d" in found["certificate", "camera"].text
    assert "has expired" in sentences(here_expires_ns=NOW_NS - 1)["certificate", "operator"].text
    assert sentences(here_expires_ns=NOW_NS + 10 * DAY_S * 10**9) == {}


def test_errors_of_the_log_are_told_for_a_minute_once_each():
    def said(seconds, text, level=LogLevel.ERROR, agent="camera"):
        return LogRecord(NOW_NS - round(seconds * 1e9), agent, "main", level, text)

    records = (
        said(50, "lost"),
        said(10, "lost"),
        said(100, "long ago"),
        said(5, "a fault"),
        said(5, "w", LogLevel.WARNING),
    )
    wrongs = judge(moment(fare(told=health(fault="a fault")), said=records))
    assert [(w.code, w.grave) for w in wrongs] == [("fault", True), ("error", True), ("warning", False)]
    assert wrongs[1].text == "camera told an error 2 times, last 10 s ago: lost"
    (refused,) = judge(moment(said=(said(1, "a link was refused", LogLevel.WARNING, "router"),)))
    assert refused.grave


def test_without_router_nothing_else_is_told():
    told = Gathered(NOW_NS, "lab", "tcp/x:1", router=False, fares=(Fare("camera", None, 50.0, False),))
    (wrong,) = judge(told)
    assert (wrong.code, wrong.text) == ("router", "no router answers on tcp/x:1, so nothing is known of the rig")
    assert "agent" not in page(report(told, [wrong])).split("\n")[2]


def test_agents_are_placed_as_the_rig_says():
    assert set(placed_agents(simulated_rig())) == {
        "camera", "perception", "reconstruction", "planner", "simulator", "robot_bridge psm1", "recorder",
    }  # fmt: skip
    rig = simulated_rig().model_copy(
        update={
            "hosts": {
                "video": HostSection(address="10.0.0.1", runs=("camera", "recorder")),
                "desk": HostSection(address="10.0.0.2", runs=("robot_bridge psm1", "operator", "viewer")),
            }
        }
    )
    assert placed_agents(rig) == {"camera": "video", "recorder video": "video", "robot_bridge psm1": "desk"}


@pytest.mark.parametrize(
    ("dry_run", "expected"), [(False, {"robot_bridge psm1", "guard psm1"}), (True, {"robot_bridge psm1"})]
)
def test_a_guard_is_expected_where_something_is_sent_to_the_arm(dry_run, expected):
    dvrk = {"endpoint": "tcp/127.0.0.1:7448", "dry_run": dry_run}
    arm = {"backend": "dvrk", "dvrk": dvrk, "T_camera_base": np.eye(4).tolist()}
    assert set(placed_agents(RigConfig.model_validate({"robot": {"psm1": arm}}))) == expected


def test_up_shows_the_same_judgement_below_its_table():
    shown = page(watched([fare(silent_s=5.0, present=None), fare("planner")], RATES))
    assert re.search(r"camera +silent for 5 s", shown)
    assert "WRONG  camera has been silent for 5 s" in shown
    assert [w.code for w in judge_agents([fare(silent_s=5.0, present=None)], RATES)] == ["silent"]


def test_hosts_have_a_column_and_a_table_where_there_are_several():
    two = moment(
        fare(), fare("planner", health("planner", host="b")), clocks={"planner/main": ClockOffset("b", 3.0, 0.5)}
    )
    shown = page(report(two, []))
    assert re.search(r"agent +host +state", shown)
    assert re.search(r"b +3\.0 +0\.5 +planner", shown)
    assert "host" not in page(report(moment(fare()), []))


NUMBERS = st.floats(0, 1e4)
INPUTS = st.builds(
    heard,
    st.sampled_from([*RATES, "planner/plan", "of/another"]),
    NUMBERS,
    st.none() | st.floats(-1e5, 1e5),
    st.integers(0, 9),
    st.integers(0, 9),
)
OUTPUTS = st.builds(OutputHealth, st.sampled_from([*RATES, "of/another"]), NUMBERS, st.integers(0, 9))
FARES = st.builds(
    Fare,
    st.sampled_from(["camera", "planner", "robot_bridge psm1"]),
    st.none()
    | st.builds(health, inputs=st.lists(INPUTS, max_size=3), outputs=st.lists(OUTPUTS, max_size=3), uptime_s=NUMBERS),
    NUMBERS,
    st.sampled_from([True, False, None]),
    st.integers(0, 3),
    st.booleans(),
    st.sampled_from(["", "video", "desk"]),
)


@given(st.lists(FARES, max_size=4, unique_by=lambda f: f.name), st.booleans())
def test_whatever_is_heard_is_judged_and_shown(fares, hosts):
    told = moment(*fares, addresses={"video": "10.0.0.1"} if hosts else {})
    wrongs = judge(told)
    whole = document(told, wrongs)
    assert json.loads(json.dumps(whole)).keys() == whole.keys()
    unheard = any(fare.expected and fare.state == STARTING for fare in fares)
    assert whole["well"] == (False if any(wrong.grave for wrong in wrongs) else None if unheard else True)
    assert all(wrong.text in page(report(told, wrongs)).replace("\n", " ") or len(wrong.text) > 150 for wrong in wrongs)
    ill = {f.name for f in fares if f.expected and f.health is None and f.present is False}
    assert ill <= {name for wrong in wrongs for name in ill if name in wrong.text}


@given(st.floats(0, 1e8))
def test_spans_are_short_and_grow(seconds):
    number, unit = span_of(seconds).split()
    size = {"s": 1, "min": 60, "h": 3600, "d": 86400}[unit]
    assert abs(float(number) * size - seconds) <= size / 2
