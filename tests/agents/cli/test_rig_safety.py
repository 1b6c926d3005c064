"""What a rig's configuration keeps from a real arm: two bridges, a base that nobody vouches for, another's file."""

import json
import re

import numpy as np
import pytest

from agents.camera.scene_source import calibration_of
from agents.configuration.base_file import base_of, registered_ns
from agents.configuration.rig import RigConfig
from agents.configuration.sections import ArmSection
from agents.launch.builders import build
from agents.robot_bridge.agent import RobotBridge
from agents.simulator.agent import Simulator, SimulatorConfig
from schemas.topics import SIMULATOR_STATE
from shared.calibration.identity import calibration_id
from shared.calibration.made import made_text
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.runtime.agent import Output, Tick
from shared.runtime.config import ConfigError, load_config, parse_config
from tests.agents.cli.conftest import REPOSITORY
from tests.agents.cli.heard import DAY_NS

T = SIMULATED_BASES["psm1"].tolist()
HERE = "tcp/127.0.0.1:7448"
ROS_2 = 'codec = "rmw_zenoh"'


def rig(text: str) -> RigConfig:
    return parse_config(text, RigConfig, "rig.toml")


def real_arm(arm: str, of: str = "PSM1", endpoint: str = HERE, more: str = "") -> str:
    """The sections of a real arm that is called `of` at its console; each stands in a place of its own."""
    base = [[1, 0, 0, 0.1 * int(arm[-1])], [0, 1, 0, 0], [0, 0, 1, -0.08], [0, 0, 0, 1]]
    told = f'[robot.{arm}]\nbackend = "dvrk"\nT_camera_base = {base}\n'
    return f'{told}[robot.{arm}.dvrk]\nendpoint = "{endpoint}"\narm = "{of}"\n{more}\n'


def two_hosts(second: str) -> str:
    """A rig whose arms have their bridges on a host each, the second reaching its console at that endpoint."""
    hosts = '[hosts.one]\naddress = "one.lab"\nruns = ["robot_bridge psm1", "guard psm1"]\n'
    hosts += '[hosts.two]\naddress = "two.lab"\nruns = ["robot_bridge psm2", "guard psm2", "operator"]\n'
    return f'[security]\n[router]\nhost = "one"\n{hosts}{real_arm("psm1")}{real_arm("psm2", endpoint=second)}'


@pytest.mark.parametrize(
    ("first", "second", "refused"),
    [
        ({}, {"more": "dry_run = true"}, True),
        ({}, {"endpoint": "tcp/localhost:7448"}, True),
        ({}, {"endpoint": "tcp/[::1]:7448"}, True),
        # which of the ROS domains it is zenoh-bridge-ros2dds has been told itself
        ({}, {"more": "domain = 3"}, True),
        ({}, {"more": f"{ROS_2}\ndomain = 3"}, True),
        ({}, {"of": "PSM2"}, False),
        ({}, {"endpoint": "tcp/127.0.0.1:7449"}, False),
        ({"more": ROS_2}, {"more": f"{ROS_2}\ndomain = 3"}, False),
    ],
)
def test_two_arms_on_one_console_arm_are_refused_and_others_are_not(first, second, refused):
    text = real_arm("psm1", **first) + real_arm("psm2", **second)
    if not refused:
        assert set(rig(text).robot) == {"psm1", "psm2"}
        return
    with pytest.raises(
        ConfigError, match=r"robot\.psm1 and robot\.psm2 are both PSM1 of the console at tcp/127.* fight"
    ):
        rig(text)


def test_on_loopback_each_host_has_a_console_of_its_own():
    assert set(rig(two_hosts(HERE)).robot) == {"psm1", "psm2"}
    with pytest.raises(ConfigError, match="are both PSM1"):
        rig(two_hosts("tls/ONE.lab:7448").replace('"robot_bridge psm2", "guard psm2", ', '"robot_bridge psm2", '))


def test_an_older_file_that_has_set_points_go_through_the_guard_still_opens():
    assert rig(real_arm("psm1", more="through_guard = true")).robot == rig(real_arm("psm1")).robot


FILE = 'calibration = "c"\nleft = "a"\n'
ROS_AT = 'source = "ros"\nleft_topic = "l"\nright_topic = "r"\nendpoint = '
PIPE = 'source = "pipe"\nleft = "-"\nwidth = 8\nheight = 8\ncalibration = "c"'


def video(name: str, other: str = "/dev/video1") -> str:
    return f'source = "video"\nleft = "{other}"\nright = "{name}"\ncalibration = "c"'


@pytest.mark.parametrize(
    ("camera", "refused"),
    [
        ("", "'scene' shows no field"),
        (f'source = "images"\n{FILE}', "'images' shows no field"),
        (f'source = "images"\nloop = false\n{FILE}', "'images' shows no field"),
        (f'source = "bag"\n{FILE}', "'bag' shows no field"),
        (video("yesterday.mp4"), "films 'yesterday.mp4', a file"),
        (video("/dev/shm/yesterday.mp4"), "a file"),  # noqa: S108
        (video("/dev/../home/yesterday.mp4"), "a file"),
        (video("rtsp://10.0.0.9/stereo"), "may be seconds old"),
        (f'{ROS_AT}"tls/robot.lab:7448"', "run the camera agent on the host of the camera"),
        (f'{ROS_AT}"{HERE}"', ""),
        (video("/dev/v4l/by-id/usb-left"), ""),
        (video("1", "0"), ""),
        (PIPE, ""),
        ('source = "plugin"\nplugin = "ours"\ncalibration = "c"', ""),
    ],
)
def test_before_a_real_arm_the_camera_films_what_is_there_now(camera, refused):
    def told(more: str) -> RigConfig:
        return rig(f"[security]\n[camera]\n{camera}\n{real_arm('psm1', more=more)}")

    told("dry_run = true")
    told(f'dry_run = false\nemulated_at = "{HERE}"')
    if not refused:
        told("dry_run = false")
        return
    with pytest.raises(ConfigError, match=rf"{re.escape(refused)}.*; psm1 is real"):
        told("dry_run = false")


def test_an_emulated_arm_beside_a_real_one_lets_no_recording_lead_the_real_one():
    both = [real_arm("psm1", more=f'dry_run = false\nemulated_at = "{HERE}"')]
    both += [real_arm("psm2", of="PSM2", endpoint="tcp/127.0.0.1:7449", more="dry_run = false")]
    with pytest.raises(ConfigError, match="psm2 is real"):
        rig("[camera]\n" + "".join(both))


def test_the_file_of_an_emulated_arm_whose_endpoint_alone_becomes_a_real_one_is_refused():
    text = (REPOSITORY / "deploy" / "emulated.toml").read_text()
    with pytest.raises(ConfigError, match="leave emulated_at out where the console is real"):
        rig(text.replace('\nendpoint = "tcp/127.0.0.1:7448"', '\nendpoint = "tcp/127.0.0.1:7450"'))


def section(**told: object) -> ArmSection:
    return ArmSection.model_validate(told)


@pytest.fixture
def base_file(tmp_path):
    def write(file, **told):
        (tmp_path / file).write_text(json.dumps(told))
        return tmp_path / file

    return write


def test_the_calibration_of_a_base_is_that_of_its_file_or_the_one_that_the_section_says(base_file):
    says, silent = base_file("says.json", T_camera_base=T, calibration_id="abc"), base_file("s.json", T_camera_base=T)

    def of(says="", **told):
        return base_of("psm1", section(**told, **({"T_camera_base_calibration": says} if says else {}))).calibration_id

    assert of(T_camera_base=T) == of(T_camera_base_file=silent) == ""
    assert of("abc", T_camera_base=T) == of("abc", T_camera_base_file=silent) == "abc"
    assert of(T_camera_base_file=says) == of("abc", T_camera_base_file=says) == "abc"
    other = r"robot\.psm1: its file says abc, and T_camera_base_calibration d; keep what"
    with pytest.raises(ConfigError, match=other):
        of("d", T_camera_base_file=says)


def test_when_an_arm_was_registered_is_known_from_its_section_or_its_file_and_the_earlier_counts(base_file):
    on_day_100 = base_file("made.json", T_camera_base=T, made=made_text(100 * DAY_NS))
    silent, day_200 = base_file("silent.json", T_camera_base=T), {"T_camera_base_made": "1970-07-20"}
    for told, days in (
        ({"T_camera_base": T} | day_200, 200),
        ({"T_camera_base_file": silent} | day_200, 200),
        ({"T_camera_base_file": on_day_100} | day_200, 100),
    ):
        assert registered_ns(section(**told)) == days * DAY_NS
    assert registered_ns(section(T_camera_base_file=silent)) is None


def test_a_real_arm_does_not_start_with_a_base_where_none_can_be():
    for away_m in (0.0, 0.9):
        T_away = np.eye(4)
        T_away[0, 3] = away_m
        told = {"T_camera_base": T_away.tolist()}
        with pytest.raises(ConfigError, match=rf"base would be {away_m:g} m from the camera, and 0\.02 to 0\.85 m"):
            base_of("psm1", section(backend="dvrk", dvrk={"endpoint": HERE}, **told))
        # a simulated arm may be of another kind
        assert base_of("psm1", section(**told)).T[0, 3] == away_m


def test_the_registration_of_another_arm_is_refused(base_file):
    told = {
        "backend": "dvrk",
        "T_camera_base_file": base_file("PSM2-registration-dVRK.json", name="PSM2", measured_cp=T),
    }
    assert base_of("psm1", section(dvrk={"endpoint": HERE, "arm": "PSM2"}, **told)).arm == "PSM2"
    with pytest.raises(ConfigError, match=r"is of PSM2, and this arm is PSM1 of its console; name the file of its own"):
        base_of("psm1", section(dvrk={"endpoint": HERE}, **told))


@pytest.mark.parametrize("name", ["emulated.toml", "emulated_far.toml"])
def test_the_emulated_arm_is_registered_before_the_camera_that_its_simulator_has(name):
    emulated = load_config(REPOSITORY / "deploy" / name, RigConfig)
    arm = emulated.robot["psm1"]
    assert emulated.simulator is not None
    said = Simulator(SimulatorConfig(**emulated.simulator.model_dump())).step(Tick(0))
    (state,) = [o.message for o in said if isinstance(o, Output) and o.topic is SIMULATOR_STATE]
    assert base_of("psm1", arm).calibration_id == calibration_id(calibration_of(state.camera))
    np.testing.assert_allclose(base_of("psm1", arm).T, SIMULATED_BASES["psm1"], atol=1e-8)
    assert registered_ns(arm) is not None


def test_a_real_arm_moves_only_where_tissue_was_measured_unless_its_rig_has_none(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for more, needed in (("", True), ('has_no = ["clutch"]', True), ('has_no = ["tissue"]', False)):
        bridge = build(rig(real_arm("psm1", more=more)), "robot_bridge", "psm1")
        assert isinstance(bridge, RobotBridge)
        assert bridge.config.tissue_needed is needed
