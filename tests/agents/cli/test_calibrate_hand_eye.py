"""`calibrate hand-eye` from files, and the rig that reads what it wrote."""

import json
from pathlib import Path

import numpy as np
import pytest

from agents.cli.recordings.recompute import with_simulated_arms
from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from agents.robot_bridge.agent import RobotBridge
from schemas.messages import RectifiedStereo
from shared.calibration import read_calibration
from shared.calibration.hand_eye.samples import Motion, Sightings
from shared.calibration.identity import calibration_id
from shared.calibration.made import made_ns
from shared.kinematics.psm import JOINT_NAMES, forward
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as X
from shared.rigid_transforms import apply
from shared.runtime.config import ConfigError, parse_config

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 0.0055, 1.0)
JOINTS = [name.replace(" ", "_") for name in JOINT_NAMES]


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A tool that moves for twelve seconds before a camera which is 40 ms behind."""
    rng = np.random.default_rng(3)
    t = np.arange(0, 12, 0.02)
    swing = np.sin(2 * np.pi * rng.uniform(0.1, 0.4, 6) * t[:, None] + rng.uniform(0, 6, 6))
    joints = np.array((0, 0, 0.18, 0, 0, 0)) + swing * (0.15, 0.12, 0.02, 0.6, 0.5, 0.5)
    at = np.arange(0, 12, 0.3)
    tips = apply(X, Motion(t, forward(joints)).at(at - 0.04, np.array((0, 0, 0.0102))))
    px = Sightings(at, np.zeros((len(at), 4)), CAMERA).predicted(tips) + rng.normal(0, 0.5, (len(at), 4))
    for name, head, rows in (
        ("tips", ["left_u", "left_v", "right_u", "right_v"], np.column_stack((at, px))),
        ("poses", JOINTS, np.column_stack((t, joints))),
    ):
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header=",".join(["time_s", *head]), comments="")
    K = [[1000, 0, 479.5], [0, 1000, 269.5], [0, 0, 1]]
    camera = {"K": K, "baseline_mm": 5.5, "width": 960, "height": 540}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    return tmp_path


def test_what_it_writes_is_where_the_rig_takes_the_base_to_be(suturegrasp, recorded):
    files = ("--tips", recorded / "tips.csv", "--poses", recorded / "poses.csv")
    written = recorded / "psm1.json"
    ended = suturegrasp("calibrate", "hand-eye", *files, "--calibration", recorded / "camera.json", "--output", written)
    assert ended.status == 0, ended.err
    assert "+40." in ended.out or "+39." in ended.out
    assert "held out" in ended.out
    bridge = build(
        parse_config(f"[robot.psm1]\nT_camera_base_file = '{written}'", RigConfig, "rig"), "robot_bridge", "psm1"
    )
    assert isinstance(bridge, RobotBridge)
    np.testing.assert_allclose(bridge.config.T_camera_base, X, atol=1e-3)
    camera = read_calibration(recorded / "camera.json", unit=None, image_size=(960, 540)).calibration
    assert bridge.config.calibration_id == calibration_id(camera)
    assert made_ns((written,)) is not None


def as_points(recorded: Path, metres_per_unit: float) -> tuple[object, ...]:
    """The same motion as places before the camera and before the base, in files of their own, in some unit."""
    poses = np.loadtxt(recorded / "poses.csv", delimiter=",", skiprows=1)
    t, places = poses[:, 0], forward(poses[:, 1:])[:, :3, 3]
    folder = recorded / f"points_{metres_per_unit}"
    folder.mkdir()
    for name, points in (("poses", places), ("tips", apply(X, places))):
        rows = np.column_stack((t, points / metres_per_unit))[:: 1 if name == "poses" else 15]
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header="time_s,x,y,z", comments="")
    return "--tips", folder / "tips.csv", "--poses", folder / "poses.csv"


def test_a_base_where_none_can_be_is_not_written_and_one_of_no_known_calibration_is_with_a_warning(
    suturegrasp, recorded
):
    written = recorded / "psm1.json"
    ended = suturegrasp("calibrate", "hand-eye", *as_points(recorded, 1e-3), "--output", written)
    assert (ended.status, len(ended.complaints), written.exists()) == (3, 1, False)
    assert "m from the camera, and 0.02 to 0.85 m make sense: see that tips and poses are in metres" in ended.err
    ended = suturegrasp("calibrate", "hand-eye", *as_points(recorded, 1.0), "--output", written)
    assert ended.status == 0, ended.err
    assert "does not say of which camera calibration it is, which a real arm needs: give --calibration" in ended.err
    assert "calibration_id" not in json.loads(written.read_text())


@pytest.mark.parametrize(
    ("name", "text", "said", "status"),
    [
        ("poses.csv", "time_s,x\n1,2\n", "give columns yaw, pitch", 2),
        ("poses.csv", "x,y\n1,2\n", "time_s among them", 2),
        ("tips.csv", "time_s,left_u,left_v,right_u,right_v\n1,2,three,4,5\n", "line 2 does not hold 5 finite", 2),
        ("tips.csv", "time_s,x,y,z\n1,0,0,0.1\n", "1 of 1 sightings", 3),
        ("tips.csv", "", "first line must name its columns", 2),
    ],
)
def test_bad_input_gets_one_sentence(suturegrasp, recorded, name, text, said, status):
    (recorded / name).write_text(text)
    files = ("--tips", recorded / "tips.csv", "--poses", recorded / "poses.csv")
    ended = suturegrasp("calibrate", "hand-eye", *files, "--calibration", recorded / "camera.json")
    assert (ended.status, len(ended.complaints)) == (status, 1)
    assert said in ended.complaints[0]


def test_a_replay_does_without_the_file_of_a_real_arm():
    text = "T_camera_base_file = 'elsewhere.json'\nbackend = 'dvrk'\ndvrk = {endpoint = 'tcp/127.0.0.1:7'}"
    real = {arm: parse_config(f"[robot.{arm}]\n{text}", RigConfig, "rig") for arm in ("psm1", "left")}
    bridge = build(with_simulated_arms(real["psm1"]), "robot_bridge", "psm1")
    assert isinstance(bridge, RobotBridge)
    np.testing.assert_array_equal(bridge.config.T_camera_base, X)
    with pytest.raises(ConfigError, match="left needs T_camera_base"):
        build(with_simulated_arms(real["left"]), "robot_bridge", "left")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (json.dumps({"base-frame": {"transform": X.tolist()}}), "whose axes its camera has"),
        (json.dumps({"name": "PSM1", "measured_cp": X.tolist()}), "from an ECM, which needs backend 'dvrk'"),
    ],
)
def test_a_rig_refuses_a_file_that_does_not_place_its_arm(tmp_path, text, said):
    path = tmp_path / "base.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        build(parse_config(f"[robot.psm1]\nT_camera_base_file = '{path}'", RigConfig, "rig"), "robot_bridge", "psm1")
