"""The doctor: what it finds here, and across a rig on a real router, with certificates and without."""

import datetime
import errno
import json
import socket

import pytest

from agents.cli.live.doctor import examine
from agents.configuration.hosts import HostSection, SecuritySection
from agents.configuration.reading_session import certificate_names, reading_session
from agents.configuration.rig import PlannerSection, RigConfig, RouterSection, simulated_rig
from agents.deployment.certificates import issue
from agents.deployment.layout import ROUTER, Host, Layout, Process
from agents.diagnostics.doctor.finding import Finding
from agents.diagnostics.doctor.here import CHRONYC, examine_here, synchronisation
from agents.diagnostics.doctor.rig import clocks, granted, guards, links, running, streams, versions
from agents.diagnostics.doctor.router import unreached, why_not
from agents.diagnostics.doctor.rules import Trial, verdict
from agents.diagnostics.status.gathered import Gathered
from agents.diagnostics.status.health_watch import Fare
from agents.launch.agent_process import calibrated_ns, surroundings
from agents.launch.preflight import already_running
from agents.planner.agent import Planner
from shared.clock import now_ns
from shared.runtime.access import access_control
from shared.runtime.clocks import ClockOffset
from shared.runtime.config import load_config, parse_config
from shared.runtime.connection import connected
from shared.runtime.facts import Link, schemas_hash
from shared.runtime.identity import identity_in
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router
from tests.agents.cli.conftest import REPOSITORY
from tests.agents.cli.heard import DAY_NS, NOW_NS, facts, health, heard

RIG = "lab"
EYE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.fixture
def quick(monkeypatch):
    """As if nothing else had been installed: looking through every distribution takes longer than all the rest."""
    monkeypatch.setattr("importlib.metadata.packages_distributions", dict)


def by_what(findings):
    return {finding.what: finding for finding in findings}


@pytest.mark.slow
def test_doctor_names_what_is_wrong_with_its_remedy(suturegrasp, tmp_path, monkeypatch):
    monkeypatch.setattr("agents.cli.live.doctor.ROUTER_WAIT_S", 0.2)
    config = tmp_path / "rig.toml"
    config.write_text(
        f'[router]\nendpoint = "{free_local_endpoint()}"\nstart = false\n'
        '[camera]\nsource = "images"\nleft = "nowhere"\ncalibration = "c"\n[planner]\n'
    )
    ended = suturegrasp("doctor", "--config", config)
    assert (ended.status, ended.err) == (1, "")
    camera, router = (line for line in ended.out.splitlines() if line.startswith("WRONG"))
    assert "agent camera: cannot start" in camera and "nowhere" in camera
    assert "router: none answers" in router and "suturegrasp router" in router
    assert "ok agent planner: can start" in ended.out


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_doctor_finds_the_router_and_who_is_there(settings, running, until, suturegrasp, rig_file):
    running(Planner())
    with connected(settings, 60.0) as connection:
        until(lambda: connection.facts() and "planner/main" in connection.present())
    ended = suturegrasp("doctor", "--json", "--config", rig_file("[planner]"))
    told = json.loads(ended.out)
    assert (ended.status, ended.err, told["rig"], told["well"]) == (0, "", "test", True)
    found = {finding["what"]: finding["found"] for finding in told["findings"]}
    assert found["router"] == f"answers on {settings.endpoint}"
    assert found["running agents"] == "planner"
    assert found["schemas"] == f"{schemas_hash()} everywhere"
    assert found["link to planner"].endswith("MB/s to it")
    assert "planner" in found["shared memory"]
    assert found["clocks of other hosts"].startswith("unknown")
    assert found["access rules"].startswith("none are in force: the router listens on this machine alone")
    assert {finding["state"] for finding in told["findings"]} == {"ok", "unknown"}


@pytest.mark.parametrize(
    ("raised", "told"),
    [
        (None, "its host is there, and nobody listens; start it there: systemctl start suturegrasp-router"),
        (socket.gaierror(-2, "unknown"), "its host's name is not known here"),
        (TimeoutError("timed out"), "did not answer): is it on, on this network, and is the port"),
        (OSError(errno.EHOSTUNREACH, "No route to host"), "(no route to host): is it on"),
    ],
)
def test_a_router_that_is_not_reached_is_told_by_what_is_in_the_way(monkeypatch, raised, told):
    def create_connection(*_, **__):
        raise raised

    if raised is not None:
        monkeypatch.setattr(socket, "create_connection", create_connection)
    assert told in unreached(free_local_endpoint())


@pytest.mark.usefixtures("quick")
def test_room_for_recordings_and_certificates_are_looked_for_where_they_are_needed(tmp_path, monkeypatch):
    monkeypatch.setattr(RigConfig, "agents_here", lambda _: [])
    lab = load_config(REPOSITORY / "deploy" / "lab.toml", RigConfig)
    without = {"security": SecuritySection(certificates=tmp_path / "none")}
    desk, video = (by_what(examine_here(lab.model_copy(update={"host": host} | without))) for host in ("desk", "video"))
    assert "disk" not in desk
    assert "GiB free for recordings in /" in video["disk"].found
    assert "there are none in" in desk["certificates"].found


@pytest.mark.parametrize(
    ("offset", "found", "wrong"),
    [
        (ClockOffset("b", 340.0, 2.0), "340 ms ahead of this host", True),
        (ClockOffset("b", -340.0, 2.0), "340 ms behind this host", True),
        (ClockOffset("b", 3.0, 0.5), "3 ms ahead of this host, give or take 0.5 ms", False),
        (ClockOffset("b", 340.0, 300.0), "unknown, for its answer takes 600 ms", False),
        # another host of the same name
        (ClockOffset("here", 340.0, 2.0), "340 ms ahead of this host", True),
    ],
)
def test_doctor_tells_a_clock_that_is_off_by_the_one_here(offset, found, wrong):
    (finding,) = clocks({"planner/main": offset}, "here")
    assert finding.what == f"clock of {offset.host}"
    assert finding.found.startswith(found)
    assert ("chrony" in finding.remedy) is wrong
    silent, others = clocks({"camera/main": None, "planner/main": ClockOffset("here", 0.0, 0.1)}, "here")
    assert (silent.what, silent.remedy) == ("clock of camera/main", "")
    assert others.found == "unknown, for no agent answers from another host"


TRACKING = "C0A80001,ntp.lab,3,1700000000.1,{},0.0001,0.0001,1,0,0.01,0.02,0.001,64.2,{}"


@pytest.mark.parametrize(
    ("chrony", "systemd", "several", "state", "found"),
    [
        (TRACKING.format("-0.000250", "Normal"), None, True, "ok", "by chrony with ntp.lab, 0.250 ms off"),
        (TRACKING.format("1", "Not synchronised"), "yes", True, "WRONG", "chrony runs and says 'Not"),
        (None, "yes", True, "ok", "by the system's own service"),
        (None, "no", True, "WRONG", "none, as timedatectl tells"),
        (None, "no", False, "ok", "none, as timedatectl tells"),
        ("506 Cannot talk to daemon", None, True, "?", "unknown"),
    ],
)
def test_what_keeps_the_clock_right_is_told_as_far_as_the_system_tells(chrony, systemd, several, state, found):
    finding = synchronisation(several, lambda command: chrony if command == CHRONYC else systemd)
    assert (finding.state, finding.found.startswith(found)) == (state, True), finding


@pytest.fixture
def rig():
    """The simulated rig on two hosts."""
    video = HostSection(address="10.0.0.1", runs=("camera",), realtime=True)
    desk = HostSection(address="10.0.0.2", runs=("planner", "operator"))
    return simulated_rig().model_copy(update={"hosts": {"video": video, "desk": desk}})


def test_agents_are_told_by_host_and_those_missing_are_wrong_once_any_runs(rig):
    (none,) = running(rig, [Fare("camera", None, 1.0, False, placed="video")], "desk")
    assert (none.state, none.found.split(";")[0]) == ("ok", f"none of rig {rig.rig}")
    (other,) = running(rig, [], "desk", ("lab",))
    assert (other.state, other.found) == ("WRONG", f"none of rig {rig.rig}, but of rig lab")
    found = by_what(running(rig, [Fare("planner", None, 1.0, True, placed="desk")], "desk"))
    assert found["agents on desk (here)"] == Finding("agents on desk (here)", "planner")
    assert "camera does not run; on video, systemctl start suturegrasp.target" in found["agents on video"].remedy


def test_a_guard_is_wrong_where_it_is_needed_and_is_not_there_reaches_nothing_or_does_not_answer():
    dvrk = {"endpoint": "tcp/127.0.0.1:7448", "dry_run": False}
    arm = {"backend": "dvrk", "dvrk": dvrk, "T_camera_base": EYE}
    rig = RigConfig.model_validate({"robot": {"psm1": arm}})
    bridge, guard = Fare("robot_bridge psm1", None, 0.1, True), health("guard", "psm1", host="robot")
    answers = {"guard/psm1": facts(agent="guard", host="robot")}

    def found(*fares, **more):
        return [
            (finding.found, finding.remedy) for finding in guards(rig, Gathered(NOW_NS, RIG, "", fares=fares, **more))
        ]

    assert found() == []
    assert [found for found, remedy in found(bridge) if "before anything is armed" in remedy] == ["none stands by"]
    there = Fare("guard psm1", guard, 0.1, True)
    assert found(bridge, there, facts=answers) == [("stands by on robot, reaches the arm's Zenoh, and answers", "")]
    away = Fare("guard psm1", health("guard", "psm1", fault="its Zenoh is away"), 0.1, True)
    assert found(away, facts=answers)[0][1] == "its Zenoh is away"
    assert "no answer" in found(there)[0][0]


def test_versions_that_differ_from_those_here_and_links_that_are_slow_are_wrong():
    told = {"camera/main": facts(version="0.1.0"), "robot_bridge/psm1": facts(schemas_hash="t", zenoh="2")}
    found = by_what(versions(told, "0.2.0", "s", "1"))
    assert found["versions"].found == "0.2.0 here, 0.1.0 on camera"
    assert found["schemas"].found == "s here, t on robot_bridge psm1"
    assert all(finding.remedy for finding in found.values())
    assert all(not finding.remedy for finding in versions({"camera/main": facts()}, "0.2.0", "s", "1"))
    near, far = Link(0.4, 1.2, 9e8, 1e6), Link(90.0, 120.0, 1e6, 1e6)
    quick, slow, silent = links({"camera/main": near, "planner/main": far, "robot_bridge/psm1": None})
    much = "900 MB/s from it, 1.00 MB/s to it"
    assert (quick.state, quick.found) == ("ok", f"0.4 ms there and back (99 % within 1.2 ms), {much}")
    assert (slow.state, silent.state, silent.what) == ("WRONG", "?", "link to robot_bridge psm1")


def test_what_agents_were_granted_is_told_and_unknown_where_nobody_knows(rig):
    def found(**told):
        return by_what(granted({"camera/main": facts(**told)}, rig, NOW_NS))

    plain = found()
    assert plain["shared memory"].found == "not used by camera: it is far"
    assert "calibration of camera" not in plain, "that of a simulated field is as it was told"
    assert plain["real time for camera"].found.startswith("it has not asked for it")
    ends = {"certificate_expires_ns": NOW_NS + DAY_NS, "calibrated_ns": NOW_NS}
    wrong = found(realtime_asked=50, realtime_reason="allow it", disk_free_bytes=1, writes_to="/data", **ends)
    assert wrong["real time for camera"] == Finding("real time for camera", "asked for 50, and not granted", "allow it")
    assert wrong["disk of camera"].remedy
    assert wrong["certificate that camera runs with"].remedy.startswith("renew it")
    had = found(realtime_granted=50)["real time for camera"]
    assert (had.state, had.found) == ("ok", "priority 50")


FILMS = '[camera]\nsource = "video"\nleft = "/dev/video0"\ncalibration = "c.json"\n'
DVRK = '[robot.psm1]\nbackend = "dvrk"\n{}[robot.psm1.dvrk]\nendpoint = "tcp/127.0.0.1:7448"\n'
BASE = DVRK.format('T_camera_base_file = "c.json"\n')


@pytest.mark.parametrize(
    ("text", "name", "days", "state", "found"),
    [
        (FILMS, "camera/main", 89.0, "ok", "made 89 d ago, and camera.calibration_days allows 90 days"),
        (FILMS, "camera/main", 91.0, "WRONG", "made 91 d ago, and camera.calibration_days allows 90 days"),
        (f"{FILMS}calibration_days = 7\n", "camera/main", 8.0, "WRONG", "made 8 d ago, and camera.calibration_days"),
        (FILMS, "camera/main", None, "?", "unknown when it was made: its file does not tell, as those of suturegrasp"),
        (FILMS, "camera/main", -2.0, "?", "unknown how old it is, for by its file it is yet to be made"),
        (BASE, "robot_bridge/psm1", 31.0, "WRONG", "made 31 d ago"),
        (
            DVRK.format(f"T_camera_base = {EYE}\n"),
            "robot_bridge/psm1",
            None,
            "?",
            "unknown when it was made: it is typ",
        ),
    ],
)
def test_a_calibration_is_judged_by_its_age_and_unknown_where_nobody_states_that(text, name, days, state, found):
    rig = parse_config(text, RigConfig, "rig.toml")
    made_ns = None if days is None else NOW_NS - round(days * DAY_NS)
    (finding,) = [f for f in granted({name: facts(calibrated_ns=made_ns)}, rig, NOW_NS) if "calibration" in f.what]
    assert (finding.state, finding.found.startswith(found)) == (state, True), finding
    assert ("suturegrasp calibrate" in finding.remedy) == (state == "WRONG")


def test_an_agent_tells_when_its_calibration_was_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.json").write_text('{"made": "2023-11-14T22:13:20+00:00"}')
    films, arm = (parse_config(text, RigConfig, "rig.toml") for text in (FILMS, BASE))
    assert surroundings(films, "camera", "main").calibrated_ns == 1_700_000_000 * 10**9
    assert calibrated_ns(arm, "robot_bridge", "psm1") == 1_700_000_000 * 10**9
    assert calibrated_ns(simulated_rig(), "camera", "main") is None


def test_streams_are_told_and_what_status_finds_wrong_with_them():
    idle = [heard(topic, 0.0, None) for topic in ("operator/heartbeat", "reconstruction/thread")]
    inputs = (heard("camera/frames", 29.5, 8.25), *idle, heard("camera/calibration", 0.0, 3.0))
    fares = (Fare("perception", health("perception", inputs=inputs), 0.5, True), Fare("camera", None, 5.0, True))
    frames, heartbeat, threads, hanging = streams(Gathered(NOW_NS, RIG, "e", fares=fares))
    assert frames == Finding("stream camera/frames to perception", "29.5 Hz, 8.2 ms after it was sent")
    assert (heartbeat.found, heartbeat.state) == ("none was taken in the last two seconds", "ok")
    assert (threads.found, threads.state) == ("unknown, for none was taken in the last two seconds", "?")
    assert (hanging.what, hanging.state) == ("status (hanging)", "WRONG")


@pytest.mark.parametrize(
    ("trial", "asked", "may_command", "state", "told"),
    [
        (Trial(True, (), 12), True, True, "ok", "and so did a command; 12 ways to speak for others were denied"),
        (Trial(True, (), 12), False, False, "ok", "a command of it was denied"),
        (Trial(True, (), 12), None, True, "ok", "commands were not tried, for no agent runs"),
        (Trial(True, (), 12), True, False, "WRONG", "a command of it reached camera/main"),
        (Trial(True, (), 12), False, True, "WRONG", "too narrow"),
        (Trial(False, (), 12), None, True, "WRONG", "nothing is known of what it may not"),
        (Trial(True, ("presence under camera/main",), 11), None, True, "WRONG", "presence under camera/main arrived"),
    ],
)
def test_a_trial_shows_whether_rules_are_in_force(trial, asked, may_command, state, told):
    finding = verdict("rules", trial, asked, may_command, "camera/main")
    assert (finding.state, told in finding.found) == (state, True), finding


class Secured:
    """A rig with certificates on one machine, and a router with rules or with none."""

    def __init__(self, folder, ruled=True, days_ago=0):
        endpoint = free_local_endpoint().replace("tcp/", "tls/")
        at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC) - datetime.timedelta(days=days_ago)
        runs = tuple(map(Process, (ROUTER, "camera", "planner", "operator", "viewer")))
        layout = Layout(RIG, endpoint, (Host("desk", "127.0.0.1", runs),), 30, 3650)
        issue(layout, folder, at)
        self.certificates = folder / "desk" / "certificates"
        self.access = access_control(RIG, layout.common_names()) if ruled else None
        self.rig = RigConfig(
            rig=RIG,
            router=RouterSection(endpoint=endpoint, start=False),
            security=SecuritySection(certificates=self.certificates),
            planner=PlannerSection(),
        )

    def router(self):
        return open_router(self.rig.router_endpoint, identity_in(self.certificates, "router.main"), self.access)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_rules_are_proved_by_trying_with_every_certificate_of_this_host_or_found_missing(tmp_path, in_threads, until):
    secured, ruleless = Secured(tmp_path / "a"), Secured(tmp_path / "b", ruled=False)
    planner = SessionSettings(RIG, secured.rig.router_endpoint, secured.rig.identity_of("planner"))
    with secured.router(), in_threads(planner, Planner()), connected(secured.rig.session, 60.0) as connection:
        until(lambda: connection.facts() and "planner/main" in connection.present())
        findings = by_what(examine(secured.rig))
    told = {what.removeprefix("access rules for "): f for what, f in findings.items() if what.startswith("access rule")}
    assert set(told) == {"operator.main", "camera.main", "planner.main", "viewer.main"}
    assert all(finding.state == "ok" and "in force" in finding.found for finding in told.values()), told
    assert "and so did a command; 4 ways" in told["operator.main"].found
    assert "a command of it was denied; 4 ways" in told["camera.main"].found
    assert {f.state for what, f in findings.items() if what.startswith("certificate ")} == {"ok"}
    assert {"certificate authority", "certificate router.main"} <= set(findings)
    with ruleless.router():
        finding = by_what(examine(ruleless.rig))["access rules for operator.main"]
    assert finding.state == "WRONG"
    for way in ("message", "message of a history", "answer to a history", "presence"):
        assert f"{way} under planner/main" in finding.found


@pytest.mark.slow
def test_a_certificate_that_a_router_does_not_know_is_told_as_that(tmp_path):
    ours, theirs = Secured(tmp_path / "a"), Secured(tmp_path / "b")
    mixed = identity_in(tmp_path, "mixed")
    mixed.authority.write_bytes((ours.certificates / "authority.pem").read_bytes())
    mixed.certificate.write_bytes((theirs.certificates / "operator.main.pem").read_bytes())
    mixed.key.write_bytes((theirs.certificates / "operator.main.key").read_bytes())
    with ours.router():
        for identity, told in (
            (identity_in(theirs.certificates, "operator.main"), "make certificates anew"),
            (mixed, "it refuses the certificate here, which is of another authority"),
        ):
            assert told in why_not(SessionSettings(RIG, ours.rig.router_endpoint, identity))
        assert why_not(ours.rig.session) == ""


@pytest.mark.usefixtures("quick")
def test_expired_certificates_are_found_before_anything_is_tried(tmp_path):
    findings = by_what(examine(Secured(tmp_path, days_ago=31).rig))
    assert findings["certificate operator.main"].found == "has expired"
    assert findings["certificate authority"].state == "ok"
    assert "has expired; renew it" in findings["router"].remedy


def test_a_host_without_operator_looks_with_what_it_has(tmp_path):
    secured = Secured(tmp_path)
    for name in ("operator.main.pem", "viewer.main.key"):
        (secured.certificates / name).unlink()
    assert certificate_names(secured.certificates) == ["camera.main", "planner.main"]
    with secured.router(), connected(reading_session(secured.rig), 60.0) as connection:
        assert connection.has_router()
        assert already_running(secured.rig) == ""
