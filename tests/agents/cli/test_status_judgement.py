"""What status judges: from what was heard of a rig to sentences, without sockets."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from agents.configuration.rig import simulated_rig
from agents.configuration.topics import Override
from agents.diagnostics.status.calibrations import Allowed
from agents.diagnostics.status.gathered import ArmHeard, Gathered, expected_rates
from agents.diagnostics.status.health_watch import STARTING, Fare, span_of
from agents.diagnostics.status.judgement import judge
from agents.diagnostics.status.report import document, report, watched
from agents.diagnostics.status.watch import against_use, late_since
from schemas.messages import (
    ExecutionEvent,
    ExecutionKind,
    FrameStamp,
    HostClock,
    HostClocks,
    Judgement,
    LogLevel,
    LogRecord,
    OutputHealth,
    RobotMode,
    RobotState,
    Severity,
    ToolCandidate,
    ToolCorrection,
    ToolStatus,
)
from shared.runtime.clocks import ClockOffset
from tests.agents.cli.heard import DAY_NS, NOW_NS, facts, health, heard

RATES = expected_rates(simulated_rig())
HOSTS = {"video": "10.0.0.2", "desk": "10.0.0.3"}
KEPT = Override("*/log", "kept", 5000, 1000)
STILL = Judgement("frozen", Severity.WARNING, "both eyes show the very same picture", "restart the camera")
SWAPPED = Judgement("left_right_swapped", Severity.FAULT, "left and right look exchanged", "exchange them")


def fare(name="camera", told=None, silent_s=0.2, present: bool | None = True, **more):
    kind, _, instance = name.partition(" ")
    return Fare(name, told if told is not None else health(kind, instance or "main"), silent_s, present, **more)


def out(topic, rate_hz):
    return [OutputHealth(topic, rate_hz, 100)]


def filming(rate_hz, **more):
    return fare(told=health(outputs=out("camera/frames", rate_hz)), **more)


def seeing(frames_hz, rate_hz=None, **more):
    """Perception, which takes frames so often and tells what it sees as often, or less."""
    observed = out("perception/observations", frames_hz if rate_hz is None else rate_hz)
    return fare(
        "perception", health("perception", inputs=[heard("camera/frames", frames_hz)], outputs=observed), **more
    )


def moment(*fares, **more):
    return Gathered(NOW_NS, "lab", "tcp/127.0.0.1:7447", fares=fares, rates_hz=RATES, **more)


def found(*fares, **more):
    return {(wrong.code, wrong.about): wrong for wrong in judge(moment(*fares, **more))}


def page(shown):
    console = Console(width=200)
    with console.capture() as capture:
        console.print(shown)
    return capture.get()


@pytest.mark.parametrize(
    ("one", "code", "told"),
    [
        (Fare("camera", None, 0.1, False, placed="video"), "absent", "camera on video is not there"),
        (fare(silent_s=5.0, present=False), "gone", "camera is gone, last heard 5 s ago"),
        (Fare("camera", None, 4.0, True), "hanging", "its loop has not turned for 4 s"),
        (fare(silent_s=5.0, present=None), "silent", "camera has been silent for 5 s"),
        (Fare("camera", None, 20.0, None), "silent", "camera was never heard of"),
        (fare(told=health(fault="a step failed: x")), "fault", "camera tells a fault: a step failed: x"),
        (Fare("guard psm1", None, 9.0, False, placed="robot"), "guard", "nothing is heard of guard psm1 on robot; run"),
        (fare("guard psm1", silent_s=7.0, present=False), "guard", "psm1: guard psm1 was last heard 7 s ago; run"),
    ],
)
def test_an_agent_that_is_not_well_is_named_with_how(one, code, told):
    (wrong,) = judge(moment(one))
    assert (wrong.code, wrong.about, wrong.grave) == (code, one.name, True)
    assert told in wrong.text


def test_a_process_that_ended_and_was_started_again_is_told_for_a_while_though_all_is_well():
    (note,) = judge(moment(fare(restarts=2, restarted_s=3.0)))
    assert (note.code, note.about, note.grave) == ("restarted", "camera", False)
    assert note.text.startswith("camera began anew 3 s ago, 2 times since this watch began: its process had ended")
    assert judge(moment(fare(restarts=2, restarted_s=30.0))) == []
    assert judge(moment(fare(restarts=0, restarted_s=3.0))) == []


def test_nobody_misses_who_was_just_heard_or_what_no_configuration_has():
    for present in (True, False, None):
        assert judge(moment(fare(silent_s=0.5, present=present))) == []
    assert judge(moment(Fare("planner", None, 0.1, False, expected=False))) == []
    (wrong,) = judge(moment(fare("planner", silent_s=9.0, present=False, expected=False)))
    assert (wrong.code, wrong.grave) == ("gone", False)


def test_a_host_of_which_nothing_is_heard_is_named_in_place_of_its_agents():
    away = [fare(n, silent_s=s, present=False, placed="video") for n, s in (("camera", 4.0), ("perception", 6.0))]
    told = found(*away, fare("planner", placed="desk"), addresses=HOSTS)
    assert list(told) == [("host", "video")]
    assert "host video (10.0.0.2) is away: camera and perception were last heard 4 s ago" in told["host", "video"].text
    never = [Fare(name, None, 0.1, False, placed="video") for name in ("camera", "perception")]
    (wrong,) = judge(moment(*never, addresses=HOSTS))
    assert "nothing is heard from host video (10.0.0.2)" in wrong.text
    # one agent that is away, alone on its host or one of two, does not accuse its host
    assert list(found(away[0], addresses=HOSTS)) == [("gone", "camera")]
    assert list(found(away[0], fare("perception", placed="video"), addresses=HOSTS)) == [("gone", "camera")]


def test_without_router_nothing_else_is_told_and_where_nothing_comes_through_it_its_host_is_named():
    told = Gathered(NOW_NS, "lab", "tcp/x:1", router=False, fares=(Fare("camera", None, 50.0, False),))
    (wrong,) = judge(told)
    assert (wrong.code, wrong.text) == ("router", "no router answers on tcp/x:1, so nothing is known of the rig")
    assert "agent" not in page(report(told, [wrong])).split("\n")[2]
    behind = [fare(name, silent_s=3.4, present=False, placed="desk") for name in ("camera", "perception")]
    for last_s, named in ((0.4, ("host", "desk")), (2.4, ("router", "video"))):
        told = found(*behind, fare("recorder", silent_s=last_s), addresses=HOSTS, router_host="video")
        assert set(told) & {("router", "video"), ("host", "desk")} == {named}


def test_a_topic_that_is_too_slow_is_told_with_its_cause():
    told = found(filming(4.0), seeing(4.0))
    assert told["slow", "camera/frames"].text == "camera/frames comes at 4 Hz, where 30 Hz are expected"
    assert told["slow", "perception/observations"].text.endswith(", for it waits for camera/frames")
    told = found(filming(30.0, silent_s=4.0, present=False), seeing(0.0))
    assert set(told) == {("gone", "camera"), ("slow", "perception/observations")}
    assert told["slow", "perception/observations"].text.endswith(", for it waits for camera/frames")
    # half of a rate is enough, and before rates settle they are not judged
    assert judge(moment(filming(15.0))) == []
    assert judge(moment(fare(told=health(outputs=out("camera/frames", 1.0), uptime_s=2.0)))) == []
    # two that hear each other do not wait for each other
    thread = [heard("reconstruction/thread", 1.0)]
    seen = health("perception", inputs=thread, outputs=out("perception/observations", 1.0))
    inputs = [heard("perception/observations", 1.0)]
    made = health("reconstruction", inputs=inputs, outputs=out("reconstruction/thread", 1.0))
    told = found(fare("perception", seen), fare("reconstruction", made))
    assert "waits" not in told["slow", "perception/observations"].text
    assert told["slow", "reconstruction/thread"].text.endswith(", for it waits for perception/observations")


def test_a_step_is_blamed_only_where_it_fills_the_time():
    def told(rate_hz, step_ms, leaves_out=frozenset({"camera/frames"})):
        one = seeing(rate_hz, leaves_out=leaves_out)
        assert one.health is not None
        seen = replace(one.health, step_ms_p50=step_ms)
        return found(filming(30.0), replace(one, health=seen))["slow", "perception/observations"].text

    assert told(12.0, 80.0).endswith(", for a step takes 80 ms")
    assert told(12.0, 40.0).endswith("where 30 Hz are expected")
    # all that arrives is looked at, and that is little
    assert told(0.6, 40.0, frozenset()).endswith(", for it waits for camera/frames, which reaches it at 1 Hz")


def test_a_link_that_carries_too_little_for_a_while_is_named():
    def links(host="desk", rate_hz=9.0, for_s=6.0, **more):
        fares = filming(30.0, placed="video"), seeing(rate_hz, placed=host, **more)
        wrongs = judge(moment(*fares, late_s={("video", host): for_s}))
        return [wrong.text for wrong in wrongs if wrong.code == "link"]

    how = "camera/frames leaves at 30 Hz and reaches perception at 9 Hz"
    assert links() == [f"the link from video to desk carries too little: {how}"]
    # after a break, the rates of both ends are of different times; what is left out for newer ones crossed the link
    assert links(rate_hz=29.0) == links(host="video") == links(for_s=2.0) == []
    assert links(leaves_out=frozenset({"camera/frames"})) == []
    # at the first look nobody knows since when, and a rig is not looked at right after a break
    assert late_since(None, [("video", "desk")], now_s=9.0) == {("video", "desk"): 0.0}
    assert late_since({}, [("video", "desk")], now_s=9.0) == {("video", "desk"): 9.0}
    assert late_since({("video", "desk"): 9.0}, [("video", "desk")], now_s=11.0) == {("video", "desk"): 9.0}


def test_inputs_tell_what_was_lost_unreadable_or_old():
    inputs = [heard("camera/frames", age_ms=340.0, missed=9), heard("planner/plan", 0.0, missed=1, refused=2)]
    refusing = fare("perception", health("perception", inputs=inputs))
    told = found(refusing)
    assert set(told) == {("old", "camera/frames"), ("missed", "perception"), ("refused", "perception")}
    assert "340 ms after it was sent, where 200 ms are allowed" in told["old", "camera/frames"].text
    assert told["missed", "perception"].text.startswith("1 message of planner/plan never reached perception")
    assert "refused 2 messages of planner/plan since it started 60 s ago" in told["refused", "perception"].text
    assert told["refused", "perception"].grave
    # what was refused a while ago, and never since, is worth knowing and no more
    assert not found(replace(refusing, refused_s=60.0))["refused", "perception"].grave
    # the last age of what no longer comes says nothing of now
    assert judge(moment(fare(told=health(inputs=[heard("camera/frames", 0.0, age_ms=900.0)])))) == []


def robot(mode, **more):
    state = RobotState("psm1", NOW_NS, mode, np.eye(4), np.zeros(6), 0.0, np.eye(4), "")
    return replace(state, **more)


def ended(kind=ExecutionKind.HELD, code="", reason=""):
    return ExecutionEvent("plan-1", "psm1", NOW_NS - 12_000_000_000, kind, None, code, reason)


def tool(status=ToolStatus.CONVERGED, off_m=0.001, age_ns=10**8):
    usable, stamp = status is ToolStatus.CONVERGED, FrameStamp(1, NOW_NS - age_ns, NOW_NS - age_ns, "c")
    px, place = np.zeros((0, 2)), np.zeros(3)
    seen = ToolCandidate(np.zeros(6), np.eye(6), np.zeros((16, 16, 16), np.uint8), 9, 0.9, 0.8, 0.5)
    figures = np.eye(4) if usable else None, place, place, off_m, 0.0, 0.0, 0.0, px, px, px, (seen,), 0, 0, 1
    return ToolCorrection("psm1", stamp, 0, status, "" if usable else "it is not in view", *figures)


LOST = ended(code="heartbeat_lost", reason="none came")
BY_HAND = ended(code="hold_command", reason="cli said hold")
HOLDING, IDLE = robot(RobotMode.HOLDING), robot(RobotMode.IDLE)
CORRECTED = robot(RobotMode.IDLE, T_camera_base_registered=np.eye(4), correction_looked_ns=NOW_NS - 5 * 10**8)


@pytest.mark.parametrize(
    ("state", "last", "followed", "grave", "told"),
    [
        (HOLDING, LOST, None, True, "has held for 12 s (heartbeat_lost): none came"),
        (HOLDING, BY_HAND, None, False, "cli said hold"),
        (HOLDING, ended(ExecutionKind.FINISHED), None, False, "psm1 holds"),
        (robot(RobotMode.FAULT), None, None, True, "psm1 has a fault"),
        (robot(RobotMode.DISABLED), LOST, None, True, "its controller says why (last: none came)"),
        (IDLE, None, tool(off_m=0.006), True, "psm1 is 6.0 mm and 0.0 degrees off by the images (drifted)"),
        (CORRECTED, None, tool(off_m=0.006), False, "which its bridge corrects"),
        (IDLE, None, tool(ToolStatus.LOST), True, "psm1 is not followed in the images: it is not in view"),
        (IDLE, None, tool(ToolStatus.CONVERGING), False, "it is not in view"),
        (IDLE, None, tool(age_ns=9 * 10**9), True, "was last looked for 9 s ago"),
        (
            replace(CORRECTED, correction_looked_ns=NOW_NS - 3 * 10**9),
            None,
            tool(),
            False,
            "by a look of 3 s ago, which",
        ),
    ],
)
def test_an_arm_that_stands_still_or_whose_registration_is_off_is_told(state, last, followed, grave, told):
    (wrong,) = judge(moment(arms=(ArmHeard("psm1", state, last, followed),)))
    assert (wrong.about, wrong.grave) == ("psm1", grave)
    assert told in wrong.text
    # what was held once and went on is well
    for well in (ArmHeard("psm1", robot(RobotMode.MOVING), last), ArmHeard("psm1", CORRECTED, tool=tool())):
        assert judge(moment(arms=(well,))) == []


@pytest.mark.parametrize(("ahead_ms", "within_ms", "wrong"), [(340, 2, True), (-340, 2, True), (340, 300, False)])
def test_a_clock_is_wrong_where_it_is_so_for_certain(ahead_ms, within_ms, wrong):
    clocks = {"camera/main": ClockOffset("b", ahead_ms, within_ms), "planner/main": None}
    told = HostClocks(NOW_NS, (HostClock("camera", "main", "b", ahead_ms, within_ms),))
    for seen in ({"clocks": clocks}, {"planner_clocks": told}, {"clocks": clocks, "planner_clocks": told}):
        assert list(found(**seen)) == [("clock", "b")] * wrong


def test_a_clock_that_is_off_all_others_which_agree_is_that_of_this_machine():
    clocks = {f"{name}/main": ClockOffset(name, ahead_ms, 0.3) for name, ahead_ms in (("a", -2000.0), ("b", -2000.4))}
    clocks["viewer/desk"] = ClockOffset("desk", 0.0, 0.1)
    (wrong,) = judge(moment(fare(), clocks=clocks, here="desk"))
    assert wrong.text.startswith("the clock of this machine is 2000 ms ahead of those of all other hosts, which agree")
    # where one of them is right, the others are off
    clocks["planner/main"] = ClockOffset("c", 0.2, 0.3)
    assert list(found(fare(), clocks=clocks, here="desk")) == [("clock", "a"), ("clock", "b")]


ALLOWED = {"camera/main": Allowed(90.0, "camera.calibration_days", "calibrate")}
OLD = facts(calibrated_ns=NOW_NS - 91 * DAY_NS)
OLDER = health("planner", version="0.1.0")


def of_camera(**told):
    return moment(facts={"camera/main": facts(**told)})


SCHEMAS = {"camera/main": facts(), "planner/main": facts(schemas_hash="t")}
DAYS = "of camera was made 91 d ago, and camera.calibration_days allows 90 days; calibrate"


@pytest.mark.parametrize(
    ("gathered", "code", "about", "told"),
    [
        (
            of_camera(disk_free_bytes=100 << 20, writes_to="/d"),
            "disk",
            "camera",
            "0.1 GiB are free where camera writes",
        ),
        (of_camera(realtime_asked=80, realtime_reason="no"), "realtime", "camera", "priority 80 and has none: no"),
        (of_camera(certificate_expires_ns=NOW_NS + 2 * DAY_NS), "certificate", "camera", "expires in 2 d; renew"),
        (moment(here_expires_ns=NOW_NS - 1), "certificate", "operator", "has expired; renew"),
        (of_camera(overrides=(KEPT.told,)), "topics", "camera", "they differ in */log kept 5000; take the right"),
        (moment(facts={"planner/main": facts()}, overrides=(KEPT,)), "topics", "planner", "in */log kept 5000 (here);"),
        (moment(facts={"camera/main": OLD}, calibrations=ALLOWED), "calibration", "camera", DAYS),
        (moment(facts=SCHEMAS), "schemas", "schemas", "s on camera; t on planner"),
        (moment(fare(), fare("planner", OLDER)), "version", "versions", "0.1.0 on planner; 0.2.0 on camera"),
        (moment(faults=(SWAPPED,)), "images", SWAPPED.code, "the images are of no use: left and right look exchanged;"),
        (moment(other_rigs=("demo",)), "rig", "demo", "no agent of rig lab is on tcp/127.0.0.1:7447, and those of"),
    ],
)
def test_what_agents_tell_of_themselves_and_their_surroundings_is_judged(gathered, code, about, told):
    (wrong,) = judge(gathered)
    assert (wrong.code, wrong.about, wrong.grave) == (code, about, code != "calibration")
    assert told in wrong.text


def test_of_what_perception_finds_faults_are_told_and_a_camera_that_stands_still():
    soft = Judgement("blurred", Severity.WARNING, "edges are soft", "focus")
    assert against_use([soft, STILL, SWAPPED]) == (STILL, SWAPPED)


def test_a_camera_that_stands_still_is_wrong_where_an_arm_may_go_by_it_and_else_a_note():
    for arms in ((), (ArmHeard("psm1"),)):
        (wrong,) = judge(moment(faults=(STILL,), arms=arms))
        assert (wrong.code, wrong.about, wrong.grave) == ("images", "frozen", bool(arms))
        assert wrong.text == "the camera stands still: both eyes show the very same picture; restart the camera"


def test_what_is_not_old_full_or_otherwise_yet_is_well():
    young = facts(calibrated_ns=NOW_NS - 89 * DAY_NS, overrides=(KEPT.told,))
    assert judge(moment(facts={"camera/main": young}, calibrations=ALLOWED, overrides=(KEPT,))) == []
    assert judge(moment(facts={"camera/main": facts()}, calibrations=ALLOWED)) == []
    assert judge(moment(here_expires_ns=NOW_NS + 10 * DAY_NS)) == []


def test_errors_of_the_log_are_told_for_a_minute_once_each():
    def said(seconds, text, level=LogLevel.ERROR, agent="camera"):
        return LogRecord(NOW_NS - round(seconds * 1e9), agent, "main", level, text)

    errors = [said(*one) for one in ((50, "lost"), (10, "lost"), (100, "long ago"), (5, "a fault"))]
    wrongs = judge(moment(fare(told=health(fault="a fault")), said=(*errors, said(5, "w", LogLevel.WARNING))))
    assert [(w.code, w.grave) for w in wrongs] == [("fault", True), ("error", True), ("warning", False)]
    assert wrongs[1].text == "camera told an error 2 times, last 10 s ago: lost"
    (refused,) = judge(moment(said=(said(1, "a link was refused", LogLevel.WARNING, "router"),)))
    assert refused.grave


def test_status_and_up_show_hosts_topics_told_otherwise_and_what_is_wrong():
    there = fare("planner", health("planner", host="b"))
    told = moment(fare(), there, clocks={"planner/main": ClockOffset("b", 3.0, 0.5)}, overrides=(KEPT,))
    shown = page(report(told, []))
    assert re.search(r"agent +host +state", shown)
    assert re.search(r"b +3\.0 +0\.5 +planner", shown)
    assert "\notherwise than the table of topics: */log kept 5000\n" in shown
    assert document(told, [])["topics"] == [{"topic": "*/log", "setting": "kept", "value": 5000, "table": 1000}]
    alone = page(report(moment(fare()), []))
    assert "all is well" in alone and "host" not in alone and "otherwise" not in alone
    silent = page(watched([fare(silent_s=5.0, present=None), fare("planner")], RATES))
    assert re.search(r"camera +silent for 5 s", silent)
    assert "WRONG  camera has been silent for 5 s" in silent
    # one that is not heard yet is not called well
    unheard = moment(fare(), Fare("planner", None, 0.5, None))
    assert "planner was not heard yet" in page(report(unheard, []))
    assert "all is well" not in page(watched(unheard.fares, {}))


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
    told = moment(*fares, addresses=HOSTS if hosts else {})
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
