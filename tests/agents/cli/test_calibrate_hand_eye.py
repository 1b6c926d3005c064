"""`calibrate hand-eye` from files, and the rig that reads what it wrote."""

import json

import numpy as np
import pytest

from agents.cli.recordings.recompute import with_simulated_arms
from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from agents.robot_bridge.agent import RobotBridge
from schemas.messages import RectifiedStereo
from shared.calibration import read_calibration
from shared.calibration.hand_eye.estimate import Motion, Sightings
from shared.calibration.identity import calibration_id
from shared.calibration.made import made_ns
from shared.kinematics.psm import JOINT_NAMES, forward
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as X
from shared.rigid_transforms import apply
from shared.runtime.config import ConfigError, parse_config
from tests.agents.cli.conftest import refused

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 0.0055, 1.0)
JOINTS = [name.replace(" ", "_") for name in JOINT_NAMES]
POINTS = ["x", "y", "z"]


def built(text, arm="psm1", change=lambda rig: rig):
    return build(change(parse_config(text, RigConfig, "rig.toml")), "robot_bridge", arm)


def files(folder, poses, tips):
    """The options for files of poses and tips, each a head and rows that begin with a time."""
    folder.mkdir(exist_ok=True)
    for name, (head, *columns) in (("poses", poses), ("tips", tips)):
        told = ",".join(["time_s", *head])
        np.savetxt(folder / f"{name}.csv", np.column_stack(columns), delimiter=",", header=told, comments="")
    return "--tips", folder / "tips.csv", "--poses", folder / "poses.csv"


@pytest.fixture
def moved():
    """Times and joints of a tool that moves for twelve seconds."""
    rng, t = np.random.default_rng(3), np.arange(0, 12, 0.02)
    swing = np.sin(2 * np.pi * rng.uniform(0.1, 0.4, 6) * t[:, None] + rng.uniform(0, 6, 6))
    return t, np.array((0, 0, 0.18, 0, 0, 0)) + swing * (0.15, 0.12, 0.02, 0.6, 0.5, 0.5)


@pytest.fixture
def recorded(moved, tmp_path):
    """Those files of that motion before a camera which is 40 ms behind."""
    (t, joints), at = moved, np.arange(0, 12, 0.3)
    tips = apply(X, Motion(t, forward(joints)).at(at - 0.04, np.array((0, 0, 0.0102))))
    px = Sightings(at, np.zeros((len(at), 4)), CAMERA).predicted(tips)
    px += np.random.default_rng(4).normal(0, 0.5, px.shape)
    K = [[1000, 0, 479.5], [0, 1000, 269.5], [0, 0, 1]]
    (tmp_path / "camera.json").write_text(json.dumps({"K": K, "baseline_mm": 5.5, "width": 960, "height": 540}))
    named = ["left_u", "left_v", "right_u", "right_v"]
    return *files(tmp_path, (JOINTS, t, joints), (named, at, px)), "--calibration", tmp_path / "camera.json"


def test_what_it_writes_is_where_the_rig_takes_the_base_to_be(suturegrasp, recorded, tmp_path):
    written = tmp_path / "psm1.json"
    ended = suturegrasp("calibrate", "hand-eye", *recorded, "--output", written)
    assert ended.status == 0, ended.err
    assert "+40." in ended.out or "+39." in ended.out
    assert "held out" in ended.out
    bridge = built(f"[robot.psm1]\nT_camera_base_file = '{written}'")
    assert isinstance(bridge, RobotBridge)
    np.testing.assert_allclose(bridge.config.T_camera_base, X, atol=1e-3)
    camera = read_calibration(tmp_path / "camera.json", unit=None, image_size=(960, 540)).calibration
    assert bridge.config.calibration_id == calibration_id(camera)
    assert made_ns((written,)) is not None


def test_a_base_where_none_can_be_is_not_written_and_one_of_no_known_calibration_is_with_a_warning(
    suturegrasp, moved, tmp_path
):
    (t, joints), written = moved, tmp_path / "psm1.json"
    places = forward(joints)[:, :3, 3]
    tips = apply(X, places)[::15]
    in_mm = files(tmp_path / "mm", (POINTS, t, 1e3 * places), (POINTS, t[::15], 1e3 * tips))
    ended = suturegrasp("calibrate", "hand-eye", *in_mm, "--output", written)
    assert (ended.status, len(ended.complaints), written.exists()) == (3, 1, False)
    assert "m from the camera, and 0.02 to 0.85 m make sense: see that tips and poses are in metres" in ended.err
    in_m = files(tmp_path / "m", (POINTS, t, places), (POINTS, t[::15], tips))
    ended = suturegrasp("calibrate", "hand-eye", *in_m, "--output", written)
    assert ended.status == 0, ended.err
    assert "does not say of which camera calibration it is, which a real arm needs" in ended.err
    assert "calibration_id" not in json.loads(written.read_text())
    refused(suturegrasp("calibrate", "hand-eye", *in_m, "--output", written), "exists already")


@pytest.mark.parametrize(
    ("name", "text", "told", "status"),
    [
        ("poses.csv", "time_s,x\n1,2\n", "give columns yaw, pitch", 2),
        ("poses.csv", "x,y\n1,2\n", "time_s among them", 2),
        ("tips.csv", "time_s,left_u,left_v,right_u,right_v\n1,2,three,4,5\n", "line 2 does not hold 5 finite", 2),
        ("tips.csv", "time_s,x,y,z\n1,0,0,0.1\n", "1 of 1 sightings", 3),
        ("tips.csv", "", "first line must name its columns", 2),
    ],
)
def test_bad_input_gets_one_sentence(suturegrasp, recorded, tmp_path, name, text, told, status):
    (tmp_path / name).write_text(text)
    refused(suturegrasp("calibrate", "hand-eye", *recorded), told, status=status)


def test_a_replay_does_without_the_file_of_a_real_arm():
    text = "T_camera_base_file = 'elsewhere.json'\nbackend = 'dvrk'\ndvrk = {endpoint = 'tcp/127.0.0.1:7'}"
    bridge = built(f"[robot.psm1]\n{text}", change=with_simulated_arms)
    assert isinstance(bridge, RobotBridge)
    np.testing.assert_array_equal(bridge.config.T_camera_base, X)
    with pytest.raises(ConfigError, match="left needs T_camera_base"):
        built(f"[robot.left]\n{text}", "left", with_simulated_arms)
