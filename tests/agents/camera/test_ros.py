"""Live image topics, as another library writes them, over a real router, by either codec."""

import contextlib
import itertools
import threading

import numpy as np
import pytest

from agents.camera.ros import RosSource
from agents.camera.sources import SourceError
from agents.configuration.rig import RigConfig
from agents.dvrk_emulator.messages import header
from agents.dvrk_emulator.wire import HASHES, BridgeWire, RmwWire
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
SECOND_NS, PERIOD_S = 10**9, 0.033
AHEAD_NS = 5 * 10**12
"""The clock of the emulated console's computer is elsewhere."""


def camera_info(side):
    k = [F, 0.0, W / 2, 0.0, F, H / 2, 0.0, 0.0, 1.0]
    p = [F, 0.0, W / 2, -F * BASELINE * side, 0.0, F, H / 2, 0.0, 0.0, 0.0, 1.0, 0.0]
    return CameraInfo(header(0), H, W, "plumb_bob", [0.0] * 5, k, np.eye(3).ravel().tolist(), p)


@contextlib.contextmanager
def endoscope(wire):
    """Publishes both eyes from a thread, the left one ten milliseconds before the right one."""
    puts = [
        [
            wire.publish(f"jhu/{eye}/{name}", kind, latched=False)
            for name, kind in (("image_raw", IMAGE), ("camera_info", INFO))
        ]
        for eye in ("left", "right")
    ]
    stopped = threading.Event()

    def publish():
        for number in itertools.count(1):
            at_ns = now_ns()
            for side, (image, info) in enumerate(puts):
                info.put(camera_info(side).serialize(), at_ns)
                at = header(at_ns + AHEAD_NS - (10_000_000 if side == 0 else 0))
                pixels = bytes([number % 200, side, 7]) * (W * H)
                image.put(Image(at, H, W, "bgr8", 0, 3 * W, pixels).serialize(), at_ns)
            if stopped.wait(PERIOD_S):
                break

    thread = threading.Thread(target=publish)
    thread.start()
    yield
    stopped.set()
    thread.join()


@pytest.mark.parametrize("codec", ["ros2dds", "rmw_zenoh"])
def test_a_camera_shows_pairs_of_live_topics_with_their_calibration(codec, monkeypatch, until):
    monkeypatch.setitem(HASHES, IMAGE, types.type_hash(types.IMAGE))
    monkeypatch.setitem(HASHES, INFO, types.type_hash(types.CAMERA_INFO))
    endpoint, said = free_local_endpoint(), []
    text = f'[camera]\nsource = "ros"\nendpoint = "{endpoint}"\ncodec = "{codec}"\nencoding = "raw"\n'
    text += 'left_topic = "/jhu/left/image_raw"\nright_topic = "/jhu/right/image_raw"\nunit = "m"\n'
    with open_router(endpoint), open_session(SessionSettings(endpoint=endpoint)) as session:
        wire = BridgeWire(session) if codec == "ros2dds" else RmwWire(session, 0)
        with endoscope(wire):
            camera = build(parse_config(text, RigConfig, "rig.toml"), "camera", "main")

            def three_frames():
                outputs = [one for one in camera.step(Tick(now_ns())) if isinstance(one, Output)]
                said.extend((output.message, now_ns()) for output in outputs)
                return sum(isinstance(message, StereoFrame) for message, _ in said) == 3

            with contextlib.closing(camera):  # pyright: ignore[reportArgumentType] this agent has a close
                until(three_frames)
        wire.close()
    calibration = said[0][0]
    assert isinstance(calibration, StereoCalibration)
    assert calibration.metres_per_unit == 1.0
    frames = [(message, at_ns) for message, at_ns in said if isinstance(message, StereoFrame)]
    for frame, at_ns in frames:
        left, right = (np.frombuffer(eye.data, np.uint8).reshape(H, W, 3) for eye in (frame.left, frame.right))
        assert (left[..., 0] == right[..., 0]).all()
        assert (left[0, 0, 1], right[0, 0, 1]) == (0, 1)
        # by this host's clock, however far the other is off
        assert 0 <= at_ns - frame.stamp.capture_right_ns < 5 * SECOND_NS
    stamps = [frame.stamp.capture_left_ns for frame, _ in frames]
    assert stamps == sorted(set(stamps))


def test_topics_that_nobody_publishes_are_named(monkeypatch):
    monkeypatch.setattr("agents.camera.ros.FIRST_S", 0.3)
    endpoint = free_local_endpoint()
    with (
        open_router(endpoint),
        pytest.raises(SourceError, match=r"nothing came of a/image_raw, b/image_raw, a/camera_info"),
    ):
        RosSource(SessionSettings(endpoint=endpoint), Ros2dds(), "a/image_raw", "b/image_raw")
