"""Live image topics, as another library writes them, over a real router, by either codec."""

import contextlib
import threading

import numpy as np
import pytest

from agents.camera.ros import RosSource
from agents.camera.sources import SourceError
from agents.configuration.rig import RigConfig
from agents.emulator.messages import header
from agents.emulator.wire import HASHES, BridgeWire, RmwWire
from agents.launch.builders import build
from schemas.messages import StereoCalibration, StereoFrame
from shared.clock import now_ns
from shared.ros import types
from shared.ros.naming import Ros2dds
from shared.runtime.agent import Output, Tick
from shared.runtime.config import parse_config
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session
from tests.rigs.robot.image_messages import CameraInfo, Image

W, H, BASELINE, F = 64, 48, 0.005, 60.0
IMAGE, INFO = "sensor_msgs::msg::dds_::Image_", "sensor_msgs::msg::dds_::CameraInfo_"
SECOND_NS, PERIOD_NS, AHEAD_NS = 10**9, 33_000_000, 5 * 10**12
"""The clock of the emulated console's computer is elsewhere."""


def camera_info(side):
    k = [F, 0.0, W / 2, 0.0, F, H / 2, 0.0, 0.0, 1.0]
    p = [F, 0.0, W / 2, -F * BASELINE * side, 0.0, F, H / 2, 0.0, 0.0, 0.0, 1.0, 0.0]
    return CameraInfo(header(0), H, W, "plumb_bob", [0.0] * 5, k, np.eye(3).ravel().tolist(), p)


class Endoscope:
    """Publishes both eyes from a thread, the left one ten milliseconds before the right one, until closed."""

    def __init__(self, wire):
        self._puts = [
            tuple(
                wire.publish(f"jhu/{eye}/{name}", kind, latched=False)
                for name, kind in (("image_raw", IMAGE), ("camera_info", INFO))
            )
            for eye in ("left", "right")
        ]
        self.frame, self._stopped = 0, threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        while not self._stopped.wait(PERIOD_NS / SECOND_NS):
            self.frame = self.frame % 200 + 1
            at_ns = now_ns()
            for side, (image, info) in enumerate(self._puts):
                info.put(camera_info(side).serialize(), at_ns)
                at = header(at_ns + AHEAD_NS - (10_000_000 if side == 0 else 0))
                pixels = bytes([self.frame, side, 7]) * (W * H)
                image.put(Image(at, H, W, "bgr8", 0, 3 * W, pixels).serialize(), at_ns)

    def close(self):
        self._stopped.set()
        self._thread.join()


@pytest.mark.parametrize("codec", ["ros2dds", "rmw_zenoh"])
def test_a_camera_shows_pairs_of_live_topics_with_their_calibration(codec, monkeypatch):
    monkeypatch.setitem(HASHES, IMAGE, types.type_hash(types.IMAGE))
    monkeypatch.setitem(HASHES, INFO, types.type_hash(types.CAMERA_INFO))
    endpoint = free_local_endpoint()
    text = f'[camera]\nsource = "ros"\nendpoint = "{endpoint}"\ncodec = "{codec}"\nencoding = "raw"\n'
    text += 'left_topic = "/jhu/left/image_raw"\nright_topic = "/jhu/right/image_raw"\nunit = "m"\n'
    with open_router(endpoint), open_session(SessionSettings(endpoint=endpoint)) as session:
        wire = BridgeWire(session) if codec == "ros2dds" else RmwWire(session, 0)
        with contextlib.closing(Endoscope(wire)):
            camera = build(parse_config(text, RigConfig, "rig.toml"), "camera", "main")
            with contextlib.closing(camera):  # pyright: ignore[reportArgumentType] this agent has a close
                frames, asked, calibration = [], 0, None
                while len(frames) < 3:
                    asked += 1
                    assert asked < 10_000
                    said = [o.message for o in camera.step(Tick(now_ns())) if isinstance(o, Output)]
                    frames += [(m, now_ns()) for m in said if isinstance(m, StereoFrame)]
                    if asked == 1:
                        calibration = said[0]
                    threading.Event().wait(0.01)
        wire.close()
    assert isinstance(calibration, StereoCalibration)
    assert calibration.metres_per_unit == 1.0
    stamps = [frame.stamp for frame, _ in frames]
    for frame, at_ns in frames:
        left, right = (np.frombuffer(eye.data, np.uint8).reshape(H, W, 3) for eye in (frame.left, frame.right))
        assert (left[..., 0] == right[..., 0]).all()
        assert (left[0, 0, 1], right[0, 0, 1]) == (0, 1)
        # by this host's clock, however far the other is off
        assert 0 <= at_ns - frame.stamp.capture_right_ns < 5 * SECOND_NS
    assert stamps[0].capture_left_ns < stamps[1].capture_left_ns < stamps[2].capture_left_ns


def test_topics_that_nobody_publishes_are_named(monkeypatch):
    monkeypatch.setattr("agents.camera.ros.FIRST_S", 0.3)
    endpoint = free_local_endpoint()
    with (
        open_router(endpoint),
        pytest.raises(SourceError, match=r"nothing came of a/image_raw, b/image_raw, a/camera_info"),
    ):
        RosSource(SessionSettings(endpoint=endpoint), Ros2dds(), "a/image_raw", "b/image_raw")
