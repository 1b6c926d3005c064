"""Which machine runs what: checked as a whole, with one sentence for what is wrong."""

import pytest

from agents.cli.recordings.record import recorded_topics
from agents.configuration.rig import RigConfig
from agents.configuration.this_host import at_host
from schemas.topics import FRAMES, TOPICS
from shared.runtime.config import ConfigError, parse_config

SECTIONS = """
[camera]
[perception]
[robot.psm1]
[recorder]
"""
HOSTS = """
[hosts.video]
address = "198.51.100.1"
runs = ["camera", "recorder"]
[hosts.strong]
address = "198.51.100.2"
runs = ["perception", "operator"]
[hosts.robot]
address = "robot.lab"
runs = ["robot_bridge psm1"]
realtime = true
"""
ROUTER = '[router]\nhost = "video"\n'
WHOLE = f'rig = "lab"\n[security]\n{ROUTER}{SECTIONS}{HOSTS}'
DVRK = """[robot.psm1]
backend = "dvrk"
T_camera_base = [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
[robot.psm1.dvrk]
endpoint = "tls/robot.lab:7447"
"""
FAR = WHOLE.replace("[robot.psm1]\n", DVRK)
MISTAKES = {
    WHOLE.replace('"perception", ', ""): "no host runs 'perception'",
    WHOLE.replace('"perception", ', '"perception", "camera", '): "'camera' runs on video and strong",
    WHOLE.replace('"perception", ', '"perception", "planner", '): "runs 'planner', for which there is no section",
    WHOLE.replace("198.51.100.2", "198.51.100.1"): "two hosts have the address 198.51.100.1",
    WHOLE.replace("198.51.100.2", "198.51.100"): "'198.51.100' is no address",
    WHOLE.replace("198.51.100.2", "198.51.100.2:7447"): "write an IP address or a host name alone",
    WHOLE.replace("198.51.100.2", "localhost"): "localhost is no address that other hosts reach",
    WHOLE.replace("198.51.100.2", "255.255.255.255"): "write the one it has on the lab's network",
    WHOLE.replace("198.51.100.2", "fe80::1%eth0"): "fe80::1%eth0 is no address that other hosts reach",
    WHOLE.replace("hosts.strong", "hosts.authority"): "its folder would hold the authority's key; call it otherwise",
    WHOLE.replace("psm1", "a" * 41): "40 at most, such as video_2",
    WHOLE.replace('"operator"', '"operator", "operator"'): "runs 'operator' twice; leave it there once",
    WHOLE.replace("[security]", "[security]\nauthority_days = 30"): "no certificate holds for longer than its author",
    WHOLE.replace("[router]", "[router]\nport = true"): "port must be a number, not true",
    WHOLE.replace("hosts.strong", "hosts.Strong-PC"): "'Strong-PC' cannot be used; write small letters, digits and _",
    WHOLE.replace('"perception", ', '"perception", "router", '): "is no agent; name its host in router.host",
    WHOLE.replace('"perception", ', '"percepton", '): "'percepton', for which there is no section; did you mean 'perc",
    WHOLE.replace('"robot_bridge psm1"', '"robot-bridge psm1"'): "write a section's name, and an arm's after a space",
    WHOLE.replace('["robot_bridge psm1"]', '"robot_bridge psm1"'): "must be a list in brackets",
    WHOLE.replace("[robot.psm1]", '[robot]\nbackend = "simulated"'): "a name before them, [robot.NAME]",
    WHOLE.replace('"perception", ', '"operater", "perception", '): "did you mean 'operator'?",
    WHOLE.replace("[hosts.video]", "[host.video]"): "[host.video] is no section; did you mean [hosts.NAME]?",
    WHOLE.replace("address = ", "adress = "): "hosts.video.adress is unknown; did you mean address?",
    WHOLE.replace('host = "video"', 'host = "vide"'): "'vide' is none of the hosts video, strong, robot",
    WHOLE.replace('host = "video"', ""): "router.host is missing",
    WHOLE.replace('host = "video"', 'endpoint = "tcp/198.51.100.1:7447"'): "exclude each other",
    WHOLE.replace("[security]\n", ""): "[security] is missing",
    '[router]\nendpoint = "tcp/198.51.100.1:7447"': "which needs mutual TLS",
    '[router]\nendpoint = "tls/198.51.100.1:7447"': "needs [security]",
    '[router]\nhost = "video"': "there are no [hosts]",
    FAR: "no host runs 'guard psm1'",
    FAR.replace('"perception", ', '"perception", "guard psm1", '): "'guard psm1' must run on robot",
    FAR.replace("tls/robot", "tcp/robot"): "leaves this machine, which needs tls",
    WHOLE + "[links]\ndirect = true": "[links] is gone: images go through the router",
    "[topics.camera.frames]\nrecorded = false": 'a topic is written in quotes: [topics."camera/frames"]',
}


def rig(text):
    return parse_config(text, RigConfig, "rig.toml")


@pytest.mark.parametrize("text", MISTAKES, ids=list(MISTAKES.values()))
def test_a_mistake_in_who_runs_where_is_one_sentence(text):
    with pytest.raises(ConfigError) as caught:
        rig(text)
    assert MISTAKES[text] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_each_host_runs_its_own_and_all_find_the_router():
    video, strong = at_host(rig(WHOLE), "video"), at_host(rig(WHOLE), "strong")
    assert video.agents_here() == [("camera", "main")]
    assert strong.agents_here() == [("perception", "main")]
    assert at_host(rig(WHOLE), "robot").agents_here() == [("robot_bridge", "psm1")]
    assert video.runs_here("router") and video.runs_here("recorder")
    assert not strong.runs_here("router") and not strong.runs_here("recorder")
    assert video.router_endpoint == strong.session.endpoint == "tls/198.51.100.1:7447"


def test_each_process_shows_a_certificate_of_its_own():
    strong = at_host(rig(WHOLE), "strong")
    assert strong.common_names() == [
        "camera.main", "recorder.video", "perception.main", "operator.strong", "robot_bridge.psm1",
    ]  # fmt: skip
    shown = {name: strong.identity_of(name) for name in ("operator", "perception", "router")}
    assert {name: identity and str(identity.certificate) for name, identity in shown.items()} == {
        "operator": "certificates/operator.strong.pem",
        "perception": "certificates/perception.main.pem",
        "router": "certificates/router.main.pem",
    }
    assert strong.session.identity == shown["operator"]


def test_a_host_is_told_by_option_or_file_and_otherwise_asked_for():
    assert at_host(rig(f'host = "robot"\n{WHOLE}'), None).host == "robot"
    assert at_host(rig(f'host = "robot"\n{WHOLE}'), "strong").host == "strong"
    with pytest.raises(ConfigError, match="which of the hosts video, strong, robot is this one"):
        at_host(rig(WHOLE), None)
    with pytest.raises(ConfigError, match="'vide' is none of the rig's hosts"):
        at_host(rig(WHOLE), "vide")
    with pytest.raises(ConfigError, match=r"has no \[hosts\]"):
        at_host(rig(SECTIONS), "video")


def test_a_rig_records_what_the_table_says_or_otherwise_what_it_says_itself():
    less = rig('[topics."camera/frames"]\nrecorded = false')
    assert recorded_topics(rig("")) == tuple(topic for topic in TOPICS if topic.recorded)
    assert set(recorded_topics(rig(""))) - set(recorded_topics(less)) == {FRAMES}


def test_without_hosts_everything_runs_here_and_certificates_are_for_all_that_is_configured():
    plain = at_host(rig(SECTIONS), None)
    assert len(plain.agents_here()) == 3
    assert plain.runs_here("router") and plain.session.identity is None
    secured = rig(f'[router]\nendpoint = "tls/127.0.0.1:7447"\n[security]\n{SECTIONS}')
    names = ["camera.main", "perception.main", "robot_bridge.psm1", "recorder.main", "operator.main"]
    assert secured.common_names() == names
    assert secured.identity_of("recorder") is not None
