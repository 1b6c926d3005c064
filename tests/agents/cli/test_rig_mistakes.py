"""What a rig's file may not say: each mistake is one sentence that names the key and what is allowed."""

import pytest

from agents.configuration.rig import RigConfig
from schemas.topics import HEARTBEAT, ROBOT_STATE, TOPICS, Delivery, Priority
from shared.runtime.config import ConfigError, parse_config
from tests.agents.cli.conftest import refused

WHOLE = """rig = "lab"
[security]
[router]
host = "video"
[camera]
[perception]
[robot.psm1]
[recorder]
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
ASIDE = "[[1, 0, 0, 0.05], [0, 1, 0, 0], [0, 0, 1, -0.08], [0, 0, 0, 1]]"
DVRK = '[robot.psm1]\nbackend = "dvrk"\n[robot.psm1.dvrk]\n'
ARM = f'[robot.psm1]\nT_camera_base = {ASIDE}\nbackend = "dvrk"\n[robot.psm1.dvrk]\nendpoint = "tcp/127.0.0.1:7448"\n'
FOOT = f'{ARM}pedal = "footpedals/operator_present"\n'
OTHER_FOOT = FOOT.replace("psm1", "psm2").replace("0.05", "-0.05")
STREAM = '[camera]\nsource = "video"\nleft = "rtsp://10.0.0.9/stereo"\ncalibration = "c"'
FAR = WHOLE.replace("[robot.psm1]\n", ARM.replace("tcp/127.0.0.1:7448", "tls/robot.lab:7447"))
DESK = '[security]\n[hosts.desk]\naddress = "10.0.0.1"\nruns = ["operator"]\n[router]\nhost = "desk"\n'


def base(rows, arm="psm1"):
    return f"[robot.{arm}]\nT_camera_base = {rows}"


OF_ONE_MACHINE = {
    '[camera]\nsource = "images"': "camera: source 'images' needs left",
    '[camera]\nsource = "video"\nleft = "a"': "camera: source 'video' needs calibration",
    '[camera]\nsource = "pipe"\nleft = "-"\ncalibration = "c"': "needs width and height",
    '[camera]\nsource = "ros"\nleft_topic = "a"': "source 'ros' needs endpoint, left_topic and right_topic",
    '[camera]\nsource = "plugin"\nplugin = "a"': "needs plugin, the name of what is installed, and calibration",
    "[camera]\nrate_hz = 0": "camera.rate_hz = 0: it must be greater than 0",
    '[camera]\nsource = "ros"\nendpoint = "tcp/10.0.0.9:7"\nleft_topic = "a"\nright_topic = "b"': "camera.endpoint",
    "[camera]\ncalibration_days = 1e4": "calibration_days = 10000.0: it must be less than or equal to 365",
    '[router]\nendpoint = "localhost"': "'localhost' is no endpoint; write protocol, host and port",
    '[router]\nendpoint = "tcp/198.51.100.1:7447"': "which needs mutual TLS",
    '[router]\nendpoint = "tls/198.51.100.1:7447"': "needs [security]",
    '[router]\nhost = "video"': "there are no [hosts]",
    '[router]\nconnect = ["tcp/10.0.0.9:7447"]': "router.connect 'tcp/10.0.0.9:7447' leaves this machine",
    f'{DESK}connect = ["tcp/10.0.0.9:7447"]': "needs tls and [security]",
    'rig = "south"\n[router]\nreads = ["south"]': "router.reads names 'south', this rig itself",
    'rig = "my rig"': "rig: 'my rig' cannot be used; write small letters",
    '[robot.psm1]\nbackend = "dvrk"': "robot.psm1: backend 'dvrk' and a section dvrk with its endpoint go together",
    f'{DVRK}endpoint = "tcp/127.0.0.1:7448"': "backend 'dvrk' needs T_camera_base",
    ARM.replace("127.0.0.1", "10.0.0.9"): "needs tls and [security]; or",
    f"{ARM}through_guard = false": "set points go through the guard always: leave through_guard",
    f'{ARM}has_no = ["camera"]': "'teleoperation', 'endoscope_arm', 'clutch', 'set_up_joints' or 'tissue'",
    f'{FOOT}{OTHER_FOOT}arm = "PSM2"': "robot.psm1 and robot.psm2 both count the pedal of the console",
    f"{ARM}dry_run = false\n{STREAM}": "film by a device; psm1 is real and would go by it: leave dry_run on",
    f'{ARM}pedal = "camera"': "'footpedals/operator_present' or 'console/operator_present'",
    "[robot.psm1]\nmaximum_plan_age_s = 1e9": "maximum_plan_age_s = 1000000000.0: it must be less than or equal",
    "[robot.psm1]\nmaximum_frame_age_s = 2.1": "maximum_frame_age_s = 2.1: it must be less than or equal to 2",
    "[robot.psm1]\nmaximum_motion_s = 601": "maximum_motion_s = 601: it must be less than or equal to 600",
    "[robot.psm1]\nT_camera_base_days = 366": "T_camera_base_days = 366: it must be less than or equal to 365",
    "[robot.psm1]\nT_camera_base_made = 5": "5 is no day; write year, month and day, such as 2026-11-24",
    "[robot.psm1]\nbakend = 1": "robot.psm1.bakend is unknown; did you mean backend?",
    "[robot.psm3]": "robot: psm3 needs T_camera_base; only psm1 and psm2 have a place of their own",
    base("[[1, 0, 0, nan], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"): "write four rows of four numbers",
    base("[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 2]]"): "its last row must be 0, 0, 0, 1",
    base("[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]"): "must be a rotation",
    base("[[1, 0, 0, 45], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"): "the base would be 45 m from the camera",
    f"{base(ASIDE)}\n{base(ASIDE, 'psm2')}": "robot: psm1 and psm2 stand in the same place",
    '[perception]\nmatching = false\n[reconstruction]\nmethod = "paper"': "matching = true",
    "[sim]": "sim is unknown; allowed here: rig, router, camera",
}
OF_HOSTS = {
    WHOLE.replace('"perception", ', ""): "no host runs 'perception'",
    WHOLE.replace('"perception", ', '"perception", "camera", '): "'camera' runs on video and strong",
    WHOLE.replace('"perception", ', '"perception", "planner", '): "runs 'planner', for which there is no section",
    WHOLE.replace("198.51.100.2", "198.51.100.1"): "two hosts have the address 198.51.100.1",
    WHOLE.replace("198.51.100.2", "198.51.100"): "'198.51.100' is no address",
    WHOLE.replace("198.51.100.2", "localhost"): "localhost is no address that other hosts reach",
    WHOLE.replace('["robot_bridge psm1"]', '"robot_bridge psm1"'): "must be a list in brackets",
    WHOLE.replace("[robot.psm1]", '[robot]\nbackend = "simulated"'): "a name before them, [robot.NAME]",
    WHOLE.replace("198.51.100.2", "255.255.255.255"): "write the one it has on the lab's network",
    WHOLE.replace("198.51.100.2", "fe80::1%eth0"): "fe80::1%eth0 is no address that other hosts reach",
    WHOLE.replace("hosts.strong", "hosts.authority"): "its folder would hold the authority's key; call it otherwise",
    WHOLE.replace('"operator"', '"operator", "operator"'): "runs 'operator' twice; leave it there once",
    WHOLE.replace("[security]", "[security]\nauthority_days = 30"): "no certificate holds for longer than its author",
    WHOLE.replace("[router]", "[router]\nport = true"): "port must be a number, not true",
    WHOLE.replace("hosts.strong", "hosts.Strong-PC"): "'Strong-PC' cannot be used; write small letters, digits and _",
    WHOLE.replace('"perception", ', '"perception", "router", '): "is no agent; name its host in router.host",
    WHOLE.replace('"perception", ', '"percepton", '): "'percepton', for which there is no section; did you mean 'perc",
    WHOLE.replace("[hosts.video]", "[host.video]"): "[host.video] is no section; did you mean [hosts.NAME]?",
    WHOLE.replace('host = "video"', 'host = "vide"'): "'vide' is none of the hosts video, strong, robot",
    WHOLE.replace('host = "video"', ""): "router.host is missing",
    WHOLE.replace('host = "video"', 'endpoint = "tcp/198.51.100.1:7447"'): "exclude each other",
    WHOLE.replace("[security]\n", ""): "[security] is missing",
    FAR: "no host runs 'guard psm1'",
    FAR.replace('"perception", ', '"perception", "guard psm1", '): "'guard psm1' must run on robot",
    FAR.replace("tls/robot", "tcp/robot"): "leaves this machine, which needs tls",
    WHOLE + "[links]\ndirect = true": "[links] is gone: images go through the router",
}
OF_TOPICS = {
    "[topics.camera.frames]\nrecorded = false": 'a topic is written in quotes: [topics."camera/frames"]',
    '[topics."perception/observation"]\nrecorded = false': "did you mean perception/observations? known are",
    '[topics."*/log"]': "it says nothing; set recorded, priority, kept, or leave the section out",
    '[topics."robot_bridge/execution"]\nkept = 999': "with fewer than 1000 a router's restart could lose events of",
    '[topics."robot_bridge/execution"]\npriority = "background"': "an event waits for the network",
    '[topics."operator/hold"]\npriority = "data"': "a command waits for the network",
    '[topics."operator/hold"]\nrecorded = false': "as its receiver tells it, as */command; set it there",
    '[topics."camera/frames"]\nkept = 2000': "only events are kept for those who were away (planner/plan,",
}
MISTAKES = OF_ONE_MACHINE | OF_HOSTS | OF_TOPICS


@pytest.mark.parametrize("text", MISTAKES, ids=list(MISTAKES.values()))
def test_a_mistake_is_one_sentence_that_names_the_key_and_what_is_allowed(text):
    with pytest.raises(ConfigError) as caught:
        parse_config(text, RigConfig, "rig.toml")
    assert MISTAKES[text] in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("command", ["run planner", "up", "doctor", "goal --s 0.5", "arm x", "record"])
def test_every_command_tells_a_mistake_in_one_line(suturegrasp, tmp_path, command):
    config = tmp_path / "rig.toml"
    config.write_text("[planer]")
    refused(suturegrasp(*command.split(), "--config", config), "planer is unknown; did you mean planner?")


def test_no_rig_has_what_moves_a_robot_wait_or_kept_for_less_long():
    for topic in TOPICS:
        told = [f"kept = {kept}" for kept in (0, 1, topic.kept - 1)]
        if topic.delivery is not Delivery.LATEST:
            told += [f'priority = "{priority.value}"' for priority in Priority]
        elif topic in (ROBOT_STATE, HEARTBEAT):
            told += [f'priority = "{priority.value}"' for priority in Priority if priority is not topic.priority]
        for line in told:
            with pytest.raises(ConfigError):
                parse_config(f'[topics."{topic}"]\n{line}', RigConfig, "rig.toml")
