"""What status judges: from what was heard of a rig to sentences, without sockets."""

import dataclasses
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from agents.configuration.hosts import HostSection
from agents.configuration.rig import CameraSection, RigConfig, simulated_rig
from agents.configuration.topics import Override
from agents.diagnostics.status.agents import judge_agents
from agents.diagnostics.status.calibrations import Allowed
from agents.diagnostics.status.gathered import ArmHeard, Gathered, expected_rates, placed_agents, placed_beside
from agents.diagnostics.status.health_watch import STARTING, Fare, HealthWatch, span_of
from agents.diagnostics.status.judgement import judge
from agents.diagnostics.status.report import document, report, watched
from agents.diagnostics.status.watch import StatusWatch
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
    Judgement,
    LogLevel,
    LogRecord,
    OutputHealth,
    ReplayClock,
    RobotMode,
    RobotState,
    Severity,
    ToolCandidate,
    ToolCorrection,
    ToolStatus,
)
from schemas.topics import HEALTH, REPLAY_CLOCK, key
from shared.runtime.attachment import Attachment
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


def page(shown):
    console = Console(width=200)
    with console.capture() as capture:
        console.print(shown)
    return capture.get()


def test_a_rig_that_is_well_has_nothing_wrong_and_one_not_heard_yet_is_not_called_well():
    camera = health(outputs=[OutputHealth("camera/frames", 29.5, 100)])
    perception = health("perception", inputs=[heard("camera/frames")])
    told = moment(fare(told=camera), fare("perception", perception), facts={"camera/main": facts()})
    assert judge(told) == []
    assert document(told, [])["well"] is True
    assert "all is well" in page(report(told, []))
    unheard = moment(fare(), Fare("planner", None, 0.5, None))
    assert judge(unheard) == []
    assert document(unheard, [])["well"] is None
    assert "planner was not heard yet" in page(report(unheard, []))
    assert "all is well" not in page(watched(unheard.fares, {}))


def test_status_and_up_show_hosts_topics_told_otherwise_and_what_is_wrong():
    there = fare("planner", health("planner", host="b"))
    told = moment(
        fare(),
        there,
        clocks={"planner/main": ClockOffset("b", 3.0, 0.5)},
        overrides=(Override("*/log", "recorded", False, True), Override("*/log", "kept", 5000, 1000)),
    )
    shown = page(report(told, []))
    assert re.search(r"agent +host +state", shown)
    assert re.search(r"b +3\.0 +0\.5 +planner", shown)
    assert "\notherwise than the table of topics: */log recorded false, */log kept 5000\n" in shown
    first = {"topic": "*/log", "setting": "recorded", "value": False, "table": True}
    assert document(told, [])["topics"][0] == first
    alone = page(report(moment(fare()), []))
    assert "host" not in alone and "otherwise" not in alone
    silent = page(watched([fare(silent_s=5.0, present=None), fare("planner")], RATES))
    assert re.search(r"camera +silent for 5 s", silent)
    assert "WRONG  camera has been silent for 5 s" in silent


def test_what_was_refused_a_while_ago_and_never_since_is_worth_knowing_and_no_more():
    told = health("perception", inputs=[heard("camera/frames", refused=2)])
    lasting, over = (dataclasses.replace(fare("perception", told), refused_s=ago_s) for ago_s in (0.0, 60.0))
    assert sentences(lasting)["refused", "perception"].grave
    assert not sentences(over)["refused", "perception"].grave
    assert document(moment(over), judge(moment(over)))["well"] is True


def test_a_clock_that_is_off_all_others_which_agree_is_that_of_this_machine():
    clocks = {f"{name}/main": ClockOffset(name, ahead_ms, 0.3) for name, ahead_ms in (("a", -2000.0), ("b", -2000.4))}
    own = {"viewer/desk": ClockOffset("desk", 0.0, 0.1)}
    (wrong,) = judge(moment(fare(), clocks=clocks | own, here="desk"))
    assert wrong.text.startswith("the clock of this machine is 2000 ms ahead of those of all other hosts, which agree")
    # where one of them is right, the others are off
    some = judge(moment(fare(), clocks=clocks | {"planner/main": ClockOffset("c", 0.2, 0.3)}, here="desk"))
    assert [one.about for one in some] == ["a", "b"]


def test_without_router_nothing_else_is_told():
    told = Gathered(NOW_NS, "lab", "tcp/x:1", router=False, fares=(Fare("camera", None, 50.0, False),))
    (wrong,) = judge(told)
    assert (wrong.code, wrong.text) == ("router", "no router answers on tcp/x:1, so nothing is known of the rig")
    assert "agent" not in page(report(told, [wrong])).split("\n")[2]


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
        (
            Fare("guard psm1", None, 9.0, False, placed="robot"),
            "guard",
            "no guard stands by psm1: nothing is heard of guard psm1 on robot; run suturegrasp guard on its computer",
        ),
        (fare("guard psm1", silent_s=7.0, present=False), "guard", "psm1: guard psm1 was last heard 7 s ago; run"),
    ],
)
def test_an_agent_that_is_not_well_is_named_with_how(one, code, told):
    (wrong,) = judge(moment(one))
    assert (wrong.code, wrong.about, wrong.grave) == (code, one.name, True)
    assert told in wrong.text


def test_nobody_misses_who_was_just_heard_or_what_no_configuration_has():
    for present in (True, False, None):
        assert judge(moment(fare(silent_s=0.5, present=present))) == []
    assert judge(moment(Fare("planner", None, 0.1, False, expected=False))) == []
    assert document(moment(Fare("planner", None, 0.5, None, expected=False)), [])["well"] is True
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
    # one agent of two that is away does not accuse its host
    found = sentences(away[0], fare("perception", placed="video"), addresses={"video": "10.0.0.2"})
    assert list(found) == [("gone", "camera")]


def test_a_topic_that_is_too_slow_is_told_with_its_cause():
    def observing(rate_hz):
        observed = OutputHealth("perception/observations", rate_hz, 9)
        return fare("perception", health("perception", inputs=[heard("camera/frames", rate_hz)], outputs=[observed]))

    def filming(rate_hz, uptime_s=60.0):
        return health(outputs=[OutputHealth("camera/frames", rate_hz, 100)], uptime_s=uptime_s)

    found = sentences(fare(told=filming(4.0)), observing(4.0))
    assert found["slow", "camera/frames"].text == "camera/frames comes at 4 Hz, where 30 Hz are expected"
    assert found["slow", "perception/observations"].text.endswith(", for it waits for camera/frames")
    found = sentences(fare(told=filming(30.0), silent_s=4.0, present=False), observing(0.0))
    assert set(found) == {("gone", "camera"), ("slow", "perception/observations")}
    assert found["slow", "perception/observations"].text.endswith(", for it waits for camera/frames")
    starved = dataclasses.replace(filming(1.0), step_ms_p99=3678.0, processor_share=0.26)
    told = sentences(fare(told=starved))["slow", "camera/frames"].text
    assert told.endswith(
        "; half of its steps take over 2 ms, one in a hundred over 3678 ms, and it gets 26% of a processor"
    )
    # half of a rate is enough, and before rates settle they are not judged
    assert judge(moment(fare(told=filming(1.0, uptime_s=2.0)))) == judge(moment(fare(told=filming(15.0)))) == []


def test_what_follows_from_frames_is_expected_as_often_as_the_camera_films():
    rates = expected_rates(RigConfig(camera=CameraSection(rate_hz=25)))
    assert [rates[t] for t in ("camera/frames", "reconstruction/thread", "robot_bridge/state")] == [25, 25, 5]
    assert "perception/surface" not in rates


def test_inputs_tell_what_was_lost_unreadable_or_old():
    frames, plans = heard("camera/frames", age_ms=340.0, missed=9), heard("planner/plan", 0.0, missed=1, refused=2)
    found = sentences(fare("perception", health("perception", inputs=[frames, plans])))
    assert set(found) == {("old", "camera/frames"), ("missed", "perception"), ("refused", "perception")}
    assert "340 ms after it was sent, where 200 ms are allowed" in found["old", "camera/frames"].text
    assert found["missed", "perception"].text.startswith("1 message of planner/plan never reached perception")
    assert "refused 2 messages of planner/plan since it started 60 s ago" in found["refused", "perception"].text
    # the last age of what no longer comes says nothing of now
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

    def told(days):
        calibrated = facts(calibrated_ns=NOW_NS - days * DAY_S * 10**9)
        return judge(moment(facts={"camera/main": calibrated}, calibrations=allowed))

    (wrong,) = told(91)
    assert (wrong.code, wrong.about, wrong.grave) == ("calibration", "camera", False)
    assert "of camera was made 91 d ago, and camera.calibration_days allows 90 days; calibrate" in wrong.text
    assert told(89) == judge(moment(facts={"camera/main": facts()}, calibrations=allowed)) == []


def test_a_step_is_blamed_only_where_it_fills_the_time_and_no_agent_that_waits_for_what_does_not_arrive():
    camera = fare(told=health(outputs=[OutputHealth("camera/frames", 30.0, 100)]))

    def told(frames_hz, rate_hz, step_ms, **of_fare):
        inputs = [heard("camera/frames", frames_hz), heard("reconstruction/thread", frames_hz)]
        seen = health("perception", inputs=inputs, outputs=[OutputHealth("perception/observations", rate_hz, 9)])
        seen = dataclasses.replace(seen, step_ms_p50=step_ms, step_ms_p99=165.0, processor_share=0.91)
        return sentences(camera, fare("perception", seen, **of_fare))["slow", "perception/observations"].text

    leaves_out = frozenset({"camera/frames"})
    assert told(12.0, 12.0, 80.0, leaves_out=leaves_out).endswith(", for a step takes 80 ms")
    assert told(12.0, 12.0, 40.0, leaves_out=leaves_out).endswith(
        "; it takes 24 messages a second, half of its steps take over 40 ms, one in a hundred over 165 ms, and it gets "
        "91% of a processor"
    )
    # all that arrives is looked at, and that is little
    assert told(0.6, 0.6, 40.0).endswith(", for it waits for camera/frames, which reaches it at 1 Hz")


def test_images_that_perception_cannot_use_are_wrong_though_every_agent_is_well():
    swapped = Judgement("left_right_swapped", Severity.FAULT, "left and right look exchanged", "exchange them")
    (wrong,) = judge(moment(faults=(swapped,)))
    assert (wrong.code, wrong.about, wrong.grave) == ("images", "left_right_swapped", True)
    assert wrong.text == "the images are of no use: left and right look exchanged; exchange them"


def test_agents_of_another_rig_on_the_router_are_named_where_none_of_this_one_is_there():
    (wrong,) = judge(moment(other_rigs=("demo",)))
    assert wrong.text.startswith("no agent of rig lab is on ")
    assert "those of rig demo are: name it as rig in the file" in wrong.text


def test_two_that_hear_each_other_do_not_wait_for_each_other():
    thread, observations = heard("reconstruction/thread", 1.0), heard("perception/observations", 1.0)
    seen = health("perception", inputs=[thread], outputs=[OutputHealth("perception/observations", 1.0, 9)])
    made = health("reconstruction", inputs=[observations], outputs=[OutputHealth("reconstruction/thread", 1.0, 9)])
    found = sentences(fare("perception", seen), fare("reconstruction", made))
    assert "waits" not in found["slow", "perception/observations"].text
    assert found["slow", "reconstruction/thread"].text.endswith(", for it waits for perception/observations")


@pytest.mark.parametrize("last_s", [0.4, 2.4])
def test_where_nothing_comes_through_the_router_its_host_is_named_and_not_those_behind_it(last_s):
    fares = [fare(name, silent_s=3.4, present=False, placed="compute") for name in ("camera", "perception")]
    told = judge(moment(*fares, fare("recorder", silent_s=last_s), addresses={"compute": "a"}, router_host="video"))
    named = ("router", "video") if last_s > 1 else ("host", "compute")
    assert named in [(wrong.code, wrong.about) for wrong in told]
    assert len({wrong.code for wrong in told} & {"router", "host"}) == 1


def test_a_viewer_that_nobody_expects_is_shown_on_its_host():
    lab = load_config(Path(__file__).parents[3] / "deploy" / "lab.toml", RigConfig)
    taken = []
    connection: Any = SimpleNamespace(listen=lambda _topics, take: taken.append(take))
    watch = HealthWatch(connection, ["camera"], {"camera": "video"} | placed_beside(lab))
    told = encode(health("viewer", "desk"))
    taken[0](Tapped(HEALTH, key("lab", HEALTH, "desk", "viewer"), told, None))
    fares = {one.name: (one.placed, one.expected) for one in watch.fares()}
    assert fares == {"camera": ("video", True), "viewer desk": ("desk", False)}


@pytest.mark.parametrize(("ahead_ms", "within_ms", "wrong"), [(340, 2, True), (-340, 2, True), (340, 300, False)])
def test_a_clock_is_wrong_where_it_is_so_for_certain(ahead_ms, within_ms, wrong):
    clocks = {"camera/main": ClockOffset("b", ahead_ms, within_ms), "planner/main": None}
    told = HostClocks(NOW_NS, (HostClock("camera", "main", "b", ahead_ms, within_ms),))
    for seen in ({"clocks": clocks}, {"planner_clocks": told}, {"clocks": clocks, "planner_clocks": told}):
        assert [(one.code, one.about) for one in judge(moment(**seen))] == [("clock", "b")] * wrong


def robot(mode):
    return RobotState("psm1", NOW_NS, mode, np.eye(4), np.zeros(6), 0.0, np.eye(4), "")


def event(kind, code="", reason=""):
    return ExecutionEvent("plan-1", "psm1", NOW_NS - 12_000_000_000, kind, None, code, reason)


def held(code, reason):
    return event(ExecutionKind.HELD, code, reason)


@pytest.mark.parametrize(
    ("mode", "last", "grave", "told"),
    [
        (RobotMode.HOLDING, held("heartbeat_lost", "none came"), True, "has held for 12 s (heartbeat_lost): none came"),
        (RobotMode.HOLDING, held("hold_command", "cli said hold"), False, "cli said hold"),
        (RobotMode.HOLDING, event(ExecutionKind.FINISHED), False, "psm1 holds"),
        (RobotMode.FAULT, None, True, "psm1 has a fault"),
        (RobotMode.DISABLED, held("not_ready", "it was off"), True, "its controller says why (last: it was off)"),
    ],
)
def test_an_arm_that_stands_still_says_why(mode, last, grave, told):
    (wrong,) = judge(moment(arms=(ArmHeard("psm1", robot(mode), last),)))
    assert (wrong.about, wrong.grave) == ("psm1", grave)
    assert told in wrong.text
    # what was held once and went on is well
    assert judge(moment(arms=(ArmHeard("psm1", robot(RobotMode.MOVING), last),))) == []


def tool(status=ToolStatus.CONVERGED, off_m=0.001, age_ns=10**8):
    usable, stamp = status is ToolStatus.CONVERGED, FrameStamp(1, NOW_NS - age_ns, NOW_NS - age_ns, "c")
    px, place = np.zeros((0, 2)), np.zeros(3)
    found = ToolCandidate(np.zeros(6), np.eye(6), np.zeros((16, 16, 16), np.uint8), 9, 0.9, 0.8, 0.5)
    figures = np.eye(4) if usable else None, place, place, off_m, 0.0, 0.0, 0.0, px, px, px, (found,), 0, 0, 1
    return ToolCorrection("psm1", stamp, 0, status, "" if usable else "it is not in view", *figures)


def of_tool(followed, **state):
    """Whether what is wrong with an arm's tool is grave, and what is said of it."""
    arm = ArmHeard("psm1", dataclasses.replace(robot(RobotMode.IDLE), **state), tool=followed)
    return [(wrong.grave, wrong.text) for wrong in judge(moment(arms=(arm,)))]


@pytest.mark.parametrize(
    ("followed", "corrected", "grave", "told"),
    [
        (tool(off_m=0.006), None, True, "registration of psm1 is 6.0 mm and 0.0 degrees off by the images (drifted)"),
        (tool(off_m=0.006), np.eye(4), False, "which its bridge corrects"),
        (tool(ToolStatus.LOST), None, True, "the tool of psm1 is not followed in the images: it is not in view"),
        (tool(ToolStatus.CONVERGING), None, False, "it is not in view"),
        (tool(age_ns=9 * 10**9), None, True, "was last looked for 9 s ago"),
    ],
)
def test_a_tool_that_is_lost_in_the_images_or_off_its_registration_is_told(followed, corrected, grave, told):
    ((is_grave, text),) = of_tool(followed, T_camera_base_registered=corrected)
    assert is_grave == grave
    assert told in text


def test_a_tool_that_is_followed_is_well_and_a_look_that_is_held_is_told():
    assert of_tool(tool()) == []
    looked = {"T_camera_base_registered": np.eye(4)}
    assert of_tool(tool(), **looked, correction_looked_ns=NOW_NS - 5 * 10**8) == []
    ((grave, text),) = of_tool(tool(), **looked, correction_looked_ns=NOW_NS - 3 * 10**9)
    assert not grave
    assert "the base of psm1 is corrected by a look of 3 s ago, which is held" in text


def test_facts_tell_of_disk_real_time_and_certificates():
    full, ends_ns = {"disk_free_bytes": 100 << 20, "writes_to": "/data"}, NOW_NS + 2 * DAY_S * 10**9
    told = facts(**full, realtime_asked=80, realtime_reason="not permitted", certificate_expires_ns=ends_ns)
    found = sentences(facts={"camera/main": told})
    assert set(found) == {("disk", "camera"), ("realtime", "camera"), ("certificate", "camera")}
    assert "0.1 GiB are free where camera writes (/data)" in found["disk", "camera"].text
    assert "expires in 2 d" in found["certificate", "camera"].text
    assert "has expired" in sentences(here_expires_ns=NOW_NS - 1)["certificate", "operator"].text
    assert sentences(here_expires_ns=NOW_NS + 10 * DAY_S * 10**9) == {}


def test_errors_of_the_log_are_told_for_a_minute_once_each():
    def said(seconds, text, level=LogLevel.ERROR, agent="camera"):
        return LogRecord(NOW_NS - round(seconds * 1e9), agent, "main", level, text)

    errors = [said(*one) for one in ((50, "lost"), (10, "lost"), (100, "long ago"), (5, "a fault"))]
    records = (*errors, said(5, "w", LogLevel.WARNING))
    wrongs = judge(moment(fare(told=health(fault="a fault")), said=records))
    assert [(w.code, w.grave) for w in wrongs] == [("fault", True), ("error", True), ("warning", False)]
    assert wrongs[1].text == "camera told an error 2 times, last 10 s ago: lost"
    (refused,) = judge(moment(said=(said(1, "a link was refused", LogLevel.WARNING, "router"),)))
    assert refused.grave


def test_agents_are_placed_as_the_rig_says():
    assert set(placed_agents(simulated_rig())) == {
        "camera", "perception", "reconstruction", "planner", "simulator", "robot_bridge psm1", "recorder",
    }  # fmt: skip
    hosts = {
        "video": HostSection(address="10.0.0.1", runs=("camera", "recorder")),
        "desk": HostSection(address="10.0.0.2", runs=("robot_bridge psm1", "operator", "viewer")),
    }
    rig = simulated_rig().model_copy(update={"hosts": hosts})
    assert placed_agents(rig) == {"camera": "video", "recorder video": "video", "robot_bridge psm1": "desk"}
    # a guard is expected where something is sent to the arm
    for dry_run, expected in ((False, {"robot_bridge psm1", "guard psm1"}), (True, {"robot_bridge psm1"})):
        dvrk = {"endpoint": "tcp/127.0.0.1:7448", "dry_run": dry_run}
        arm = {"backend": "dvrk", "dvrk": dvrk, "T_camera_base": np.eye(4).tolist()}
        assert set(placed_agents(RigConfig.model_validate({"robot": {"psm1": arm}}))) == expected


NUMBERS = st.floats(0, 1e4)
TOPIC_NAMES = st.sampled_from([*RATES, "planner/plan", "of/another"])
COUNTS = st.integers(0, 9)
INPUTS = st.builds(heard, TOPIC_NAMES, NUMBERS, st.none() | st.floats(-1e5, 1e5), COUNTS, COUNTS)
OUTPUTS = st.builds(OutputHealth, TOPIC_NAMES, NUMBERS, COUNTS)
HEALTHS = st.builds(
    health, inputs=st.lists(INPUTS, max_size=3), outputs=st.lists(OUTPUTS, max_size=3), uptime_s=NUMBERS
)
FARES = st.builds(
    Fare,
    st.sampled_from(["camera", "planner", "robot_bridge psm1"]),
    st.none() | HEALTHS,
    NUMBERS,
    st.sampled_from([True, False, None]),
    st.integers(0, 3),
    st.booleans(),
    st.sampled_from(["", "video", "desk"]),
)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.lists(FARES, max_size=4, unique_by=lambda f: f.name), st.booleans())
def test_whatever_is_heard_is_judged_and_shown(fares, hosts):
    told = moment(*fares, addresses={"video": "10.0.0.1"} if hosts else {})
    wrongs = judge(told)
    whole = document(told, wrongs)
    assert json.loads(json.dumps(whole)).keys() == whole.keys()
    unheard = any(fare.expected and fare.state == STARTING for fare in fares)
    assert whole["well"] == (False if any(wrong.grave for wrong in wrongs) else None if unheard else True)
    shown = page(report(told, wrongs)).replace("\n", " ")
    assert all(wrong.text in shown or len(wrong.text) > 150 for wrong in wrongs)
    ill = {f.name for f in fares if f.expected and f.health is None and f.present is False}
    assert ill <= {name for wrong in wrongs for name in ill if name in wrong.text}


@given(st.floats(0, 1e8))
def test_spans_are_short_and_grow(seconds):
    number, unit = span_of(seconds).split()
    size = {"s": 1, "min": 60, "h": 3600, "d": 86400}[unit]
    assert abs(float(number) * size - seconds) <= size / 2


def test_a_link_that_carries_less_than_is_sent_is_named_and_a_receiver_on_the_same_host_is_not():
    sender = fare(told=health(outputs=[OutputHealth("camera/frames", 30.0, 100)]), placed="video")
    for host, rate_hz, named in (("compute", 9.0, True), ("compute", 29.0, False), ("video", 9.0, False)):
        slow = fare("perception", health("perception", inputs=[heard("camera/frames", rate_hz)]), placed=host)
        rates, late_s = {"camera/frames": 30.0}, {("video", host): 6.0}
        texts = [w.text for w in judge_agents([sender, slow], rates, None, late_s) if w.code == "link"]
        how = "camera/frames leaves at 30 Hz and reaches perception at 9 Hz"
        assert texts == [f"the link from video to compute carries too little: {how}"] * int(named)
    # what arrives and is left out for newer ones crossed the link
    slow = fare(
        "perception",
        health("perception", inputs=[heard("camera/frames", 9.0)]),
        placed="compute",
        leaves_out=frozenset({"camera/frames"}),
    )
    assert not [w for w in judge_agents([sender, slow], {"camera/frames": 30.0}) if w.code == "link"]


def test_a_link_is_named_only_where_it_carries_too_little_for_a_while():
    """After a break, the rates of both ends are of different times."""
    sender = fare(told=health(outputs=[OutputHealth("camera/frames", 30.0, 100)]), placed="video")
    slow = fare("perception", health("perception", inputs=[heard("camera/frames", 9.0)]), placed="compute")
    rates, pair = {"camera/frames": 30.0}, ("video", "compute")
    assert not [w for w in judge_agents([sender, slow], rates, None, {pair: 2.0}) if w.code == "link"]
    watch = object.__new__(StatusWatch)
    watch._rates, watch._late_since = rates, None
    # at the first look nobody knows since when, and a rig is not looked at right after a break
    assert watch._late_s((sender, slow))[pair] > 6.0
    assert watch._late_s((sender,)) == {}
    assert watch._late_s((sender, slow))[pair] < 6.0


def test_what_a_replay_tells_for_agents_is_not_judged():
    deaf: Any = SimpleNamespace(listen=lambda *_: None)
    watch = HealthWatch(deaf)

    def hear(topic, agent, message, epoch):
        watch._take(Tapped(topic, key("lab", topic, agent=agent), encode(message), Attachment(epoch, 0, 0, 0.0)))

    hear(REPLAY_CLOCK, "replay", ReplayClock(NOW_NS, 1.0), 5)
    hear(HEALTH, "camera", health(version="0.1.0"), 5)
    hear(HEALTH, "planner", health("planner"), 6)
    watch.note_present(["camera/main", "planner/main"])
    assert [(one.name, one.state) for one in watch.fares()] == [("camera", "replayed"), ("planner", "well")]
    hear(HEALTH, "perception", health("perception"), 5)
    watch.note_present(["camera/main", "planner/main", "perception/main"])
    useless = Judgement("swapped", Severity.FAULT, "the eyes look exchanged", "exchange them")
    (wrong,) = judge(moment(*watch.fares(), faults=(useless,)))
    assert not wrong.grave and wrong.text.startswith("a recording is replayed into this rig and stands for camera and")
    # once it has ended, whoever it stood for is not there
    watch._newest["camera"] = dataclasses.replace(watch._newest["camera"], expected=True, silent_s=-9.0)
    watch.note_present(["planner/main"])
    assert [w.about for w in judge(moment(*watch.fares())) if w.code == "absent"] == ["camera"]
