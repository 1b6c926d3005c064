"""`track-tool`: a recorded instrument is found, the registration said to be off, and put right."""

import json

import numpy as np
import pytest

from agents.camera.agent import Camera, CameraConfig
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.codec import encode
from schemas.messages import FrameStamp, ImageEncoding, RobotMode, RobotState, StereoCalibration, StereoFrame
from schemas.topics import CALIBRATION, FRAMES, ROBOT_STATE, key
from shared.calibration.hand_eye.file import read_hand_eye
from shared.calibration.identity import calibration_id
from shared.calibration.made import made_ns
from shared.images import encode_image
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER as PSM
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as T_TRUE
from shared.recording.entry import Entry
from shared.recording.writer import RecordingWriter
from shared.rigid_transforms import exp_se3
from tests.agents.cli.conftest import refused
from tests.rigs.drawn_tool import JAW, joints, pair

ZERO_NS = 1_760_000_000_000_000_000
EVERY_S = 0.2
WRONG = exp_se3(np.array((0.005, -0.004, 0.003, 0.0, 0.0, 0.0))) @ T_TRUE
K = np.array([[660.0, 0, 319.5], [0, 660.0, 179.5], [0, 0, 1]])
SHIFT = np.array([[1.0, 0, 0, -5.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
STEREO = StereoCalibration(640, 360, K, K, np.zeros(0), np.zeros(0), SHIFT, 1e-3)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two seconds of a drawn tool, which is told 7 mm from where it is."""
    path = tmp_path_factory.mktemp("recorded") / "session.mcap"
    said = [(CALIBRATION, "main", STEREO, ZERO_NS)]
    for i in range(8):
        at_ns, q = ZERO_NS + round(1e9 * EVERY_S * i), joints(EVERY_S * i)
        state = RobotState("psm1", at_ns, RobotMode.IDLE, PSM.forward(q), q, JAW, WRONG, "")
        left, right = (encode_image(one, ImageEncoding.JPEG) for one in pair(EVERY_S * i, i))
        frame = StereoFrame(FrameStamp(i, at_ns, at_ns, "c"), left, right)
        said += [(ROBOT_STATE, "psm1", state, at_ns), (FRAMES, "main", frame, at_ns)]
    writer = RecordingWriter(path)
    for number, (topic, instance, message, at_ns) in enumerate(said, start=1):
        writer.write(topic, Entry(key("lab", topic, instance), 1, number, encode(message), at_ns, at_ns))
    writer.close()
    return path


@pytest.mark.slow
def test_it_tells_by_how_much_the_registration_is_off_and_writes_what_it_should_be(suturegrasp, recording, tmp_path):
    corrected, tips, pictures = tmp_path / "psm1.json", tmp_path / "tips.csv", tmp_path / "pictures"
    files = ("--output", corrected, "--tips", tips, "--pictures", pictures)
    ended = suturegrasp("track-tool", recording, *files)
    assert ended.status == 1, ended.err
    assert "followed" in ended.out
    assert "mm off, more than the 3 mm allowed" in ended.err
    T = np.array(json.loads(corrected.read_text())["T_camera_base"])
    assert read_hand_eye(corrected).calibration_id == calibration_id(STEREO), "a real arm needs a known one"
    assert made_ns([corrected]) == ZERO_NS + 10**9, "when what was looked at was recorded, to a second"
    pin = PSM.forward(joints(1.4))
    assert np.linalg.norm((T @ pin)[:3, 3] - (T_TRUE @ pin)[:3, 3]) < 1e-3
    assert len(tips.read_text().splitlines()) > 1
    assert list(pictures.glob("*.jpg"))
    refused(suturegrasp("track-tool", recording, "--arm", "psm7"), "no state of an arm 'psm7'")


class Held:
    """A camera that shows one pair again and again."""

    taken_ns = 0, 0

    def __init__(self):
        self._pair = pair(0.0, 1)

    def read(self):
        return self._pair

    def close(self):
        pass


@pytest.mark.slow
def test_on_a_running_rig_it_warns_that_the_registration_has_drifted(suturegrasp, settings, in_threads, rig_file):
    camera = Camera(Held(), STEREO, CameraConfig(rate_hz=5.0, encoding=ImageEncoding.JPEG))
    bridge = RobotBridge(RobotBridgeConfig("psm1", WRONG), SimulatedPsm(tuple(joints(0.0)), JAW))
    with in_threads(settings, camera, bridge):
        ended = suturegrasp("track-tool", "--live", "--config", rig_file(), "--views", 8)
    assert ended.status == 1, (ended.out, ended.err)
    assert "warning: the registration is" in ended.err
    assert "from where registration and joints have it" in ended.out
