"""Messages as a rig publishes them, put by hand, and recorders that are closed at the end."""

import contextlib

import numpy as np
import pytest

from agents.recorder.recorder import Recorder
from schemas import messages as types
from schemas.codec import encode
from schemas.topics import CALIBRATION, EXECUTION, FRAMES, LOG, ROBOT_STATE, key
from shared.runtime.attachment import Attachment
from shared.runtime.taps import Tapped

WIDTH, HEIGHT = 64, 48
K = np.array([[80.0, 0, 31], [0, 80, 23], [0, 0, 1]])


class Messages:
    """One of each kind, numbered."""

    camera = key("lab", LOG, agent="camera")

    def log(self, number, size=10, epoch=1, agent="camera", numbered=True):
        text = types.LogRecord(number, agent, "main", types.LogLevel.INFO, "x" * size)
        beside = Attachment(epoch, number, 1000 + number, 0.0) if numbered else None
        return Tapped(LOG, key("lab", LOG, agent=agent), encode(text), beside)

    def execution(self, number, kind):
        code = "heartbeat_lost" if kind in (types.ExecutionKind.HELD, types.ExecutionKind.REFUSED) else ""
        event = types.ExecutionEvent("p1", "psm1", number, kind, None, code, code)
        return Tapped(EXECUTION, key("lab", EXECUTION, "psm1"), encode(event), Attachment(1, number, number, 0.0))

    def state(self, number, mode=types.RobotMode.IDLE, T_camera_base=None, T_base_tool=None):
        base, tool = (np.eye(4) if T is None else T for T in (T_camera_base, T_base_tool))
        state = types.RobotState("psm1", number, mode, tool, np.zeros(6), 0.0, base, "")
        return Tapped(ROBOT_STATE, key("lab", ROBOT_STATE, "psm1"), encode(state), Attachment(1, number, number, 0.0))

    def calibration(self, number=0, K_right=K, R=None, distortion=(), metres_per_unit=1e-3):
        T_right_left = np.eye(4)
        T_right_left[:3, :3] = np.eye(3) if R is None else R
        T_right_left[0, 3] = -5.0
        camera = types.StereoCalibration(
            WIDTH, HEIGHT, K, K_right, np.array(distortion), np.array(distortion), T_right_left, metres_per_unit
        )
        return Tapped(CALIBRATION, key("lab", CALIBRATION), encode(camera), Attachment(1, number, number, 0.0))

    def frame(self, number, images=None):
        black = types.Image(types.ImageEncoding.RAW, WIDTH, HEIGHT, 3, bytes(WIDTH * HEIGHT * 3))
        left, right = images or (black, black)
        stamp = types.FrameStamp(number, 1_000_000_000 + number, 2_000_000_000 + number, "bench")
        payload = encode(types.StereoFrame(stamp, left, right))
        return Tapped(FRAMES, key("lab", FRAMES), payload, Attachment(1, number, number, 0.0))


@pytest.fixture(scope="session")
def messages():
    """Makes messages."""
    return Messages()


@pytest.fixture
def record():
    """Starts recorders, and closes them at the end."""
    with contextlib.ExitStack() as stack:
        yield lambda *a, **options: stack.enter_context(Recorder(*a, **options))
