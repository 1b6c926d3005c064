"""What a rig's configuration keeps from a real arm: two bridges, absurd ages, and a base that nobody vouches for."""

import json
from pathlib import Path

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

DEPLOY = Path(__file__).parents[3] / "deploy"
T = SIMULATED_BASES["psm1"].tolist()
DAY_NS = 86_400 * 10**9
HERE = "tcp/127.0.0.1:7448"


def rig(text: str) -> RigConfig:
    return parse_config(text, RigConfig, "rig.toml")


def real_arm(arm: str, of: str = "PSM1", endpoint: str = HERE, more: str = "") -> str:
    """The sections of a real arm that is called `of` at its console; each stands in a place of its own."""
    base = [[1, 0, 0, 0.1 * int(arm[-1])], [0, 1, 0, 0], [0, 0, 1, -0.08], [0, 0, 0, 1]]
    told = f'[robot.{arm}]\nbackend = "dvrk"\nT_camera_base = {base}\n'
    return f'{told}[robot.{arm}.dvrk]\nendpoint = "{endpoint}"\narm = "{of}"\n{more}\n'


def two_hosts(second: str) -> str:
    """A rig whose arms have their bridges on a host each, the second reaching its console at that endpoint."""
    hosts = "".join(
        f'[hosts.{name}]\naddress = "{name}.lab"\nruns = ["robot_bridge {arm}", "guard {arm}"]\n'
        for name, arm in (("one", "psm1"), ("two", "psm2"))
    ).replace('"guard psm2"]', '"guard psm2", "operator"]')
    head = f'[security]\n[router]\nhost = "one"\n{hosts}'
    return head + real_arm("psm1") + real_arm("psm2", endpoint=second)


@pytest.mark.parametrize(
    ("second", "more"),
    [
        (HERE, "dry_run = true"),
        ("tcp/localhost:7448", ""),
        ("tcp/[::1]:7448", ""),
        # which of the ROS domains it is zenoh-bridge-ros2dds has been told itself
        (HERE, "domain = 3"),
        (HERE, 'codec = "rmw_zenoh"\ndomain = 3'),
    ],
)
def test_two_arms_on_one_console_arm_are_refused(second, more):
    same = r"robot\.psm1 and robot\.psm2 are both PSM1 of the console at tcp/127.* fight"
    with pytest.raises(ConfigError, match=same):
        rig(real_arm("psm1") + real_arm("psm2", endpoint=second, more=more))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({}, {"of": "PSM2"}),
        ({}, {"endpoint": "tcp/127.0.0.1:7449"}),
        ({"more": 'codec = "rmw_zenoh"'}, {"more": 'codec = "rmw_zenoh"\ndomain = 3'}),
    ],
)
def test_two_arms_of_a_console_or_of_two_consoles_are_not(first, second):
    assert set(rig(real_arm("psm1", **first) + real_arm("psm2", **second)).robot) == {"psm1", "psm2"}


def test_on_loopback_each_host_has_a_console_of_its_own():
    assert set(rig(two_hosts(HERE)).robot) == {"psm1", "psm2"}
    with pytest.raises(ConfigError, match="are both PSM1"):
        rig(two_hosts("tls/ONE.lab:7448").replace('"robot_bridge psm2", "guard psm2", ', '"robot_bridge psm2", '))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[robot.psm1]\nmaximum_plan_age_s = 1e9", "maximum_plan_age_s = 1000000000.0: it must be less than or equal"),
        ("[robot.psm1]\nmaximum_frame_age_s = 2.1", "maximum_frame_age_s = 2.1: it must be less than or equal to 2"),
        ("[robot.psm1]\nmaximum_motion_s = 601", "maximum_motion_s = 601: it must be less than or equal to 600"),
        ("[robot.psm1]\nT_camera_base_days = 366", "T_camera_base_days = 366: it must be less than or equal to 365"),
        ("[camera]\ncalibration_days = 1e4", "calibration_days = 10000.0: it must be less than or equal to 365"),
        ("[robot.psm1]\nT_camera_base_made = 5", "5 is no day; write year, month and day, such as 2026-11-24"),
        (real_arm("psm1", more="through_guard = false"), "set points go through the guard always: leave through_guard"),
        (real_arm("psm1", more='has_no = ["camera"]'), "'teleoperation', 'endoscope_arm', 'clutch' or 'tissue'"),
        (real_arm("psm1", more='pedal = "camera"'), "'footpedals/operator_present' or 'console/operator_present'"),
    ],
)
def test_what_no_rig_may_say_is_refused(text, said):
    with pytest.raises(ConfigError) as caught:
        rig(text)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_older_file_that_has_set_points_go_through_the_guard_still_opens():
    assert rig(real_arm("psm1", more="through_guard = true")).robot == rig(real_arm("psm1")).robot


def section(**told: object) -> ArmSection:
    return ArmSection.model_validate(told)


def base_file(tmp_path, name, **told):
    path = tmp_path / name
    path.write_text(json.dumps({"T_camera_base": T, **told}))
    return path


def test_the_calibration_of_a_base_is_that_of_its_file_or_the_one_that_the_section_says(tmp_path):
    says, silent = base_file(tmp_path, "says.json", calibration_id="abc"), base_file(tmp_path, "silent.json")

    def of(**told):
        return base_of("psm1", section(**told)).calibration_id

    assert of(T_camera_base=T) == of(T_camera_base_file=silent) == ""
    assert of(T_camera_base=T, T_camera_base_calibration="abc") == "abc"
    assert of(T_camera_base_file=silent, T_camera_base_calibration="abc") == "abc"
    assert of(T_camera_base_file=says) == of(T_camera_base_file=says, T_camera_base_calibration="abc") == "abc"
    other = r"robot\.psm1: its file says abc, and T_camera_base_calibration d; keep what"
    with pytest.raises(ConfigError, match=other):
        of(T_camera_base_file=says, T_camera_base_calibration="d")


def test_when_an_arm_was_registered_is_known_from_its_section_or_its_file_and_the_earlier_counts(tmp_path):
    on_day_100, on_day_200 = base_file(tmp_path, "made.json", made=made_text(100 * DAY_NS)), "1970-07-20"
    silent = base_file(tmp_path, "silent.json")

    def of(**told):
        return registered_ns(section(**told))

    assert of(T_camera_base_file=silent) is None
    assert of(T_camera_base=T, T_camera_base_made=on_day_200) == 200 * DAY_NS
    assert of(T_camera_base_file=silent, T_camera_base_made=on_day_200) == 200 * DAY_NS
    assert of(T_camera_base_file=on_day_100, T_camera_base_made=on_day_200) == 100 * DAY_NS


def test_a_real_arm_does_not_start_with_a_base_where_none_can_be():
    for away_m in (0.0, 0.9):
        T_away = np.eye(4)
        T_away[0, 3] = away_m
        told = {"T_camera_base": T_away.tolist()}
        with pytest.raises(ConfigError, match=rf"base would be {away_m:g} m from the camera, and 0\.02 to 0\.85 m"):
            base_of("psm1", section(backend="dvrk", dvrk={"endpoint": HERE}, **told))
        # a simulated arm may be of another kind
        assert base_of("psm1", section(**told)).T[0, 3] == away_m


def test_the_registration_of_another_arm_is_refused(tmp_path):
    path = tmp_path / "PSM2-registration-dVRK.json"
    path.write_text(json.dumps({"name": "PSM2", "measured_cp": T}))
    told = {"backend": "dvrk", "T_camera_base_file": path}
    assert base_of("psm1", section(dvrk={"endpoint": HERE, "arm": "PSM2"}, **told)).arm == "PSM2"
    with pytest.raises(ConfigError, match=r"is of PSM2, and this arm is PSM1 of its console; name the file of its own"):
        base_of("psm1", section(dvrk={"endpoint": HERE}, **told))


@pytest.mark.parametrize("name", ["emulated.toml", "emulated_far.toml"])
def test_the_emulated_arm_is_registered_before_the_camera_that_its_simulator_has(name):
    emulated = load_config(DEPLOY / name, RigConfig)
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
