"""A rig on several machines: who runs what, routers of other sites, topics told otherwise, and unequal files."""

import json
import socket
import subprocess

import pytest

from agents.cli.recordings.record import recorded_topics
from agents.configuration.digest import differing, rig_sections
from agents.configuration.reading_session import session_as
from agents.configuration.rig import RigConfig
from agents.configuration.this_host import at_host, certificates_of
from agents.configuration.topics import in_words, overrides
from agents.diagnostics.doctor.rig import files
from agents.diagnostics.status.files import judge_files
from agents.diagnostics.status.gathered import Gathered
from agents.diagnostics.status.health_watch import Fare
from agents.diagnostics.status.judgement import judge
from agents.launch.agent_process import surroundings
from schemas.topics import COMMANDS, FRAMES, HEALTH, LOG, OBSERVATIONS, PLAN, TOPICS, Priority, key
from shared.runtime.access import Sites
from shared.runtime.config import ConfigError, parse_config
from shared.runtime.connection import connected
from shared.runtime.delivery import as_told, declare_publisher
from tests.agents.cli.conftest import REPOSITORY, SCRIPT
from tests.agents.cli.heard import facts
from tests.agents.cli.test_rig_mistakes import DESK, WHOLE

LAB = (REPOSITORY / "deploy" / "lab.toml").read_text(encoding="utf-8")
SECTIONS = "[camera]\n[perception]\n[robot.psm1]\n[recorder]\n"
TOLD = '[topics."perception/observations"]\npriority = "data_low"\n[topics."*/log"]\nkept = 5000\nrecorded = false\n'


def rig(text=LAB, name="rig.toml"):
    return parse_config(text, RigConfig, name)


def test_each_host_runs_its_own_and_all_find_the_router():
    video, strong = at_host(rig(WHOLE), "video"), at_host(rig(WHOLE), "strong")
    assert video.agents_here() == [("camera", "main")]
    assert strong.agents_here() == [("perception", "main")]
    assert at_host(rig(WHOLE), "robot").agents_here() == [("robot_bridge", "psm1")]
    assert video.runs_here("router") and video.runs_here("recorder")
    assert not strong.runs_here("router") and not strong.runs_here("recorder")
    assert video.router_endpoint == strong.session.endpoint == "tls/198.51.100.1:7447"
    named = 'host = "robot"\n' + WHOLE
    assert (at_host(rig(named), None).host, at_host(rig(named), "strong").host) == ("robot", "strong")
    for text, host, told in (
        (WHOLE, None, "which of the hosts video, strong, robot is this one"),
        (WHOLE, "vide", "'vide' is none of the rig's hosts"),
        (SECTIONS, "video", r"has no \[hosts\]"),
    ):
        with pytest.raises(ConfigError, match=told):
            at_host(rig(text), host)


def test_each_process_shows_a_certificate_of_its_own():
    strong = at_host(rig(WHOLE), "strong")
    beside = ["camera.main", "recorder.video", "perception.main", "operator.strong", "robot_bridge.psm1"]
    assert strong.common_names() == beside
    for name, own in (("operator", "operator.strong"), ("perception", "perception.main"), ("router", "router.main")):
        identity = strong.identity_of(name)
        assert identity is not None and str(identity.certificate) == f"certificates/{own}.pem"
    assert strong.session.identity == strong.identity_of("operator")
    plain = at_host(rig(SECTIONS), None)
    assert (len(plain.agents_here()), plain.runs_here("router"), plain.session.identity) == (3, True, None)
    secured = rig(f'[router]\nendpoint = "tls/127.0.0.1:7447"\n[security]\n{SECTIONS}')
    names = ["camera.main", "perception.main", "robot_bridge.psm1", "recorder.main", "operator.main"]
    assert secured.common_names() == names
    assert secured.identity_of("recorder") is not None


def test_a_router_links_to_what_its_file_says_and_otherwise_to_nothing():
    assert RigConfig().sites == Sites((), (), read_by_others=False)
    told = rig(f'{DESK}connect = ["tls/10.0.0.9:7447"]\nreads = ["north"]\nread_by_others = true')
    assert told.sites == Sites(("tls/10.0.0.9:7447",), ("north",), read_by_others=True)
    assert rig('[router]\nconnect = ["tcp/127.0.0.1:7448"]').sites.connect == ("tcp/127.0.0.1:7448",)


def test_what_is_told_otherwise_of_topics_reaches_every_process_of_the_rig(session):
    told = rig(f"{TOLD}[camera]\n[robot.psm1]\n")
    sessions = (told.session, told.session_of("recorder"), session_as(told, "camera.main"))
    for rows in (told.rows_otherwise, *(session.otherwise for session in sessions)):
        assert as_told(OBSERVATIONS, rows).priority is Priority.DATA_LOW
        assert as_told(LOG, rows).kept == 5000
        assert as_told(PLAN, rows) is PLAN
    around = surroundings(told, "camera", "main")
    assert (around.overrides, around.rig_sections) == (told.overrides, rig_sections(told))
    in_order = ["perception/observations priority data_low", "*/log recorded false", "*/log kept 5000"]
    assert list(map(in_words, told.overrides)) == in_order
    # what is said as the table has it is no override
    assert overrides(rig('[topics."*/command"]\nkept = 1000\nrecorded = true').topics) == ()
    (one,) = overrides(rig('[topics."*/command"]\nkept = 1001').topics)
    assert (one.topic, one.setting, one.value, one.table) == (str(COMMANDS), "kept", 1001, COMMANDS.kept)
    less = rig('[topics."camera/frames"]\nrecorded = false')
    assert recorded_topics(rig("")) == tuple(topic for topic in TOPICS if topic.recorded)
    assert set(recorded_topics(rig(""))) - set(recorded_topics(less)) == {FRAMES}
    for text, priority in ((TOLD, "Priority.DATA_LOW"), ("", "Priority.REAL_TIME")):
        row = as_told(OBSERVATIONS, rig(text).rows_otherwise)
        publisher = declare_publisher(session, key("test", OBSERVATIONS), row)
        assert str(publisher.priority) == priority
        publisher.undeclare()


@pytest.mark.rig
def test_a_process_of_a_rig_publishes_as_its_file_says_and_doctor_and_status_tell_of_it(
    settings, session, suturegrasp, rig_file, until
):
    here, priorities = rig_file("[planner]", "here.toml"), []
    there = rig_file('[planner]\nattempts = 2\n[topics."*/health"]\npriority = "background"\n', "there.toml")
    heard = session.declare_subscriber(
        key("test", HEALTH, "main", "planner"), lambda sample: priorities.append(str(sample.priority))
    )
    process = subprocess.Popen([SCRIPT, "run", "planner", "--config", str(there)], stderr=subprocess.DEVNULL)
    try:
        until(lambda: priorities, "health of the planner")
        with connected(settings, 60.0) as connection:
            until(connection.facts, "facts of the planner")
        agree = suturegrasp("doctor", "--config", there)
        differ = suturegrasp("doctor", "--config", here)
        told = json.loads(suturegrasp("status", "--once", "--json", "--config", here).out)
    finally:
        process.terminate()
        process.wait(60)
    heard.undeclare()
    assert set(priorities) == {"Priority.BACKGROUND"}
    assert "topics: otherwise than the table: */health priority background (the table: real_time)" in agree.out
    assert "topics of planner" not in agree.out
    assert "WRONG topics of planner: planner began with another file of the rig" in differ.out
    assert "file of the rig: every agent began with the same as here" in agree.out
    assert f"planner on {socket.gethostname()} began with another file of the rig" in differ.out
    assert "file" in [wrong["code"] for wrong in told["wrong"]]
    assert ("topics", "planner") in [(wrong["code"], wrong["about"]) for wrong in told["wrong"]]
    (override,) = told["agents"][0]["facts"]["overrides"]
    assert override == {"topic": "*/health", "setting": "priority", "value": "background"}


def gathered(here=LAB, **theirs):
    """What is heard of a rig of which each host has its own file, by the host's name; others have the lab's."""
    told, fares = {}, []
    for kind, host in (("camera", "video"), ("perception", "strong"), ("planner", "strong"), ("robot_bridge", "robot")):
        text = theirs.get(host, LAB)
        told[f"{kind}/main"] = facts(agent=kind, rig_sections=rig_sections(rig(text)) if text else ())
        fares.append(Fare(kind, None, 0.1, True, placed=host))
    return Gathered(0, "lab", "", fares=tuple(fares), facts=told, rig_sections=rig_sections(rig(here)))


SLOW = LAB.replace("rate_hz = 30.0", "rate_hz = 25.0")
OTHER = LAB.replace("leaf_days = 30", "leaf_days = 20")


@pytest.mark.parametrize(
    ("old", "new", "sections"),
    [
        ("leaf_days = 30", "leaf_days = 20", ("security",)),
        ("rate_hz = 30.0", "rate_hz = 25.0", ("camera",)),
        ('address = "10.0.0.12"', 'address = "10.0.0.22"', ("hosts.strong",)),
        ('backend = "simulated"', "speed_share = 0.5", ("robot.psm1",)),
        # how a file is written makes no difference, and topics are compared word by word
        ("rate_hz = 30.0", "# as it films\nrate_hz = 30", ()),
        ("[perception]", '[topics."*/log"]\nkept = 2000\n[perception]', ()),
    ],
)
def test_the_section_that_differs_is_named(old, new, sections):
    assert old in LAB
    assert differing(rig_sections(rig()), rig_sections(rig(LAB.replace(old, new, 1)))) == sections


def test_what_each_host_has_of_its_own_makes_no_difference(tmp_path):
    own = rig_sections(certificates_of(at_host(rig(), "robot"), tmp_path / "rig.toml"))
    assert rig_sections(rig()) == own == rig_sections(rig(rig().model_dump_json(exclude_none=True), "rig.json"))


def test_the_host_whose_file_differs_is_named_with_its_agents_and_the_sections():
    both = gathered(strong=SLOW.replace("leaf_days = 30", "leaf_days = 20"))
    (wrong,) = judge_files(both)
    assert (wrong.code, wrong.about, wrong.grave, wrong in judge(both)) == ("file", "strong", True, True)
    assert wrong.text == (
        "perception and planner on strong began with another file of the rig than the one here, and they differ in "
        "[camera] and [security]; take the right one there and restart them"
    )
    assert list(judge_files(gathered())) == []
    # where all others agree, it is the file here that differs
    (wrong,) = judge_files(gathered(here=SLOW))
    assert wrong.about == "here"
    assert "differs from the one that every agent began with, in [camera]" in wrong.text
    # two that disagree with each other say nothing of which is right
    assert len(list(judge_files(gathered(here=SLOW, strong=OTHER)))) == 3


def test_doctor_says_so_and_what_it_cannot_tell():
    assert [(f.state, f.found) for f in files(gathered())] == [("ok", "every agent began with the same as here")]
    (wrong,) = files(gathered(robot=SLOW))
    assert (wrong.state, wrong.what) == ("WRONG", "file of the rig on robot")
    assert next(files(gathered(here=SLOW))).what == "file of the rig here"
    assert list(files(Gathered(0, "lab", ""))) == []
    (unknown,) = files(gathered(robot=None))
    assert (unknown.state, unknown.found) == ("?", "unknown of robot_bridge, whose version does not tell")


def test_a_file_of_0_2_means_what_it_meant():
    hosts = '[hosts.one]\naddress = "10.0.0.11"\nruns = ["perception", "perception psm1", "robot_bridge psm1"]\n'
    arm = '[robot.psm1]\ncorrection = "perception"\n'
    old = rig(f'[perception]\ntrack_tool = ["psm1"]\n{arm}{hosts}[router]\nhost = "one"\n[security]\n', "lab.toml")
    assert old.agents() == [("perception", "main"), ("tool_tracker", "psm1"), ("robot_bridge", "psm1")]
    assert old.hosts["one"].runs == ("perception", "tool_tracker psm1", "robot_bridge psm1")
    assert old.robot["psm1"].correction == "tool_tracker"
