"""What a rehearsal has in place of hardware, and what its hosts run."""

from pathlib import Path

import pytest

from agents.cli.lab.deploy import layout_of
from agents.cli.lab.options import Deploy
from agents.cli.lab.rehearsal.network import Network
from agents.cli.lab.rehearsal.rehearse import breaks_of
from agents.cli.lab.rehearsal.rehearsed import SIMULATED_CALIBRATION, started_on, without_hardware
from agents.configuration.rig import RigConfig
from shared.runtime.config import ConfigError, load_config, parse_config
from tests.agents.cli.conftest import REPOSITORY

REAL = """
rig = "lab"
[hosts.video]
address = "10.0.0.11"
runs = ["camera", "recorder"]
[hosts.robot]
address = "10.0.0.13"
runs = ["robot_bridge psm1", "guard psm1", "tool_tracker psm1", "recorder"]
[hosts.desk]
address = "desk.lab"
runs = ["perception", "reconstruction", "planner", "operator"]
[router]
host = "video"
[security]
[camera]
source = "bag"
left = "somewhere.bag"
[perception]
[tool_tracker.psm1]
[reconstruction]
[planner]
[recorder]
[robot.psm1]
backend = "dvrk"
T_camera_base_file = "registered.json"
[robot.psm1.dvrk]
endpoint = "tls/10.0.0.13:7448"
"""


@pytest.fixture
def rehearsed():
    return without_hardware(parse_config(REAL, RigConfig, "lab.toml"))


def test_no_hardware_is_left_and_what_took_its_place_is_said(rehearsed):
    rig, told = rehearsed
    assert (rig.camera.source, rig.camera.left) == ("scene", None)
    assert "simulator" in rig.hosts["video"].runs
    arm = rig.robot["psm1"]
    assert (arm.T_camera_base_file, arm.T_camera_base_calibration) == (None, SIMULATED_CALIBRATION)
    assert arm.dvrk.dry_run, "what the file says of moving holds here too"
    assert any("the simulated field in place of the camera's bag" in line for line in told)
    assert any("an emulated console in place of that of psm1" in line for line in told)


def test_an_arm_that_would_move_is_led_by_the_simulated_field_for_its_console_is_emulated():
    filmed = 'source = "video"\nleft = "/dev/video0"\ncalibration = "c"'
    text = REAL.replace('source = "bag"\nleft = "somewhere.bag"', filmed)
    moving = parse_config(f"{text}dry_run = false\n", RigConfig, "lab.toml")
    dvrk = without_hardware(moving)[0].robot["psm1"].dvrk
    assert dvrk is not None
    assert (dvrk.dry_run, dvrk.emulated_at) == (False, dvrk.endpoint)


def test_every_host_runs_what_its_units_start_with_its_own_credentials_and_folders(rehearsed, tmp_path):
    layout = layout_of(rehearsed[0])
    started = {one.name: one for host in layout.hosts for one in started_on(layout, host, tmp_path)}
    assert set(started) == {
        "router", "camera", "simulator", "recorder video", "recorder robot", "guard psm1", "robot_bridge psm1",
        "console", "perception", "tool_tracker psm1", "reconstruction", "planner",
    }  # fmt: skip
    for one in started.values():
        words = " ".join(one.command)
        assert not [place for place in ("/etc/", "/var/lib", "/opt/") if place in words], words
        if one.name != "console":
            files = {path.name for path in Path(one.environment["CREDENTIALS_DIRECTORY"]).iterdir()}
            assert {name.rpartition(".")[2] for name in files} == {"pem", "key"}
            assert len(files) == 3, "its own certificate and key, and the authority's certificate"
            assert f"--host {one.host}" in words


@pytest.mark.parametrize("file", ["lab.toml", "emulated_far.toml"])
def test_the_shipped_rigs_can_be_rehearsed(file, tmp_path):
    rig, _ = without_hardware(load_config(REPOSITORY / "deploy" / file, RigConfig))
    layout = layout_of(rig)
    names = [one.name for host in layout.hosts for one in started_on(layout, host, tmp_path)]
    assert len(names) == len(set(names))
    network = Network(1, "10.213.7", ("video", "desk"), {"video": "10.0.0.11", "desk": "desk.lab"})
    assert (network.address("video"), network.address("desk")) == ("10.0.0.11", "10.213.7.3")


def test_what_is_asked_for_several_times_is_played_as_often(rehearsed):
    def breaks(**asked):
        return [one.what for one in breaks_of(Deploy("rehearse", **asked), rehearsed[0], layout_of(rehearsed[0]))]

    asked = {"cut": ("video", "robot"), "kill": ("planner",), "slow": (("desk", "5Mbit"),), "skew": (("desk", "2s"),)}
    assert breaks(**asked) == [
        "video is cut off",
        "robot is cut off",
        "the link of desk carries 5 Mbit/s",
        "planner is killed",
        "the clock of desk is +2 s off",
    ]
    with pytest.raises(ConfigError, match="0Mbit is no rate"):
        breaks(slow=(("desk", "0Mbit"),))
