"""What a rig publishes, at its rates: the load of the benchmark of recording.

Images are real ones with noise of a sensor, states and calibration real messages; of the others only the size and the
rate are real.
"""

import os
import threading
from dataclasses import dataclass
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event
from typing import Any

import cv2
import numpy as np

from schemas.codec import encode
from schemas.messages import (
    FrameStamp,
    Image,
    ImageEncoding,
    RobotMode,
    RobotState,
    StereoCalibration,
    StereoFrame,
)
from schemas.topics import (
    CALIBRATION,
    EXECUTION,
    FRAMES,
    HEALTH,
    HEARTBEAT,
    LOG,
    OBSERVATIONS,
    ROBOT_STATE,
    SIMULATOR_STATE,
    SURFACE,
    THREAD,
    Topic,
    key,
)
from shared.clock import monotonic_s, now_ns
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import declare_publisher
from shared.runtime.session import SessionSettings, open_session

RIG = "bench"
WIDTH, HEIGHT, JPEG_QUALITY = 1280, 720, 95
PICTURE = "docs/example/left.png"
DIFFERENT = 4
"""Frames that are sent in turn."""


@dataclass(frozen=True)
class Stream:
    """One key, and how it is published: payloads in turn, so many a second (0: once)."""

    topic: Topic
    payloads: tuple[bytes, ...]
    rate_hz: float
    agent: str = ""
    instance: str = "main"

    @property
    def key(self) -> str:
        """Under which it is published."""
        return key(RIG, self.topic, self.instance, self.agent)


def streams(process: str) -> list[Stream]:
    """What one process publishes."""
    match process:
        case "camera_jpeg":
            return [_frames(ImageEncoding.JPEG, 60.0), _calibration(), _filler(LOG, 100, 2, "camera")]
        case "camera_raw":
            return [_frames(ImageEncoding.RAW, 30.0), _calibration(), _filler(LOG, 100, 2, "camera")]
        case "robot":
            state = RobotState("psm1", 1, RobotMode.IDLE, np.eye(4), np.zeros(6), 0.0, np.eye(4), "")
            return [
                Stream(ROBOT_STATE, (encode(state),), 100.0, instance="psm1"),
                _filler(EXECUTION, 200, 5, instance="psm1"),
                _filler(HEARTBEAT, 100, 20, instance="psm1"),
                *(_filler(HEALTH, 250, 1, agent) for agent in ("robot_bridge", "planner", "simulator")),
            ]
        case _:
            return [
                _filler(OBSERVATIONS, 110_000, 30),
                _filler(THREAD, 40_000, 30),
                _filler(SURFACE, 9_000, 3),
                _filler(SIMULATOR_STATE, 1_500, 60),
                _filler(LOG, 100, 2, "perception"),
            ]


def publish(endpoint: str, process: str, seconds: float, ready: Event, begin: Event, sent: "Queue[Any]") -> None:
    """Publish what a process does for so long, from when all begin; tells how many messages of each key it sent."""
    with open_session(SessionSettings(RIG, endpoint)) as session:
        published = streams(process)
        publishers = [declare_publisher(session, stream.key, stream.topic) for stream in published]
        probes: list[Any] = [session.declare_publisher(stream.key) for stream in published]
        pause = threading.Event()
        while not all(probe.matching_status.matching for probe in probes):
            pause.wait(0.05)
        ready.set()
        begin.wait()
        counts = _send(published, publishers, seconds)
        sent.put({stream.key: count for stream, count in zip(published, counts, strict=True)})
        # what is on its way arrives; the benchmark ends this process
        pause.wait()


def _send(sent: list[Stream], publishers: list[Any], seconds: float) -> list[int]:
    epoch, begin_s, pause = int.from_bytes(os.urandom(7), "big"), monotonic_s(), threading.Event()
    counts, due_s = [0] * len(sent), [begin_s] * len(sent)
    while (now_s := monotonic_s()) < begin_s + seconds:
        for number, stream in enumerate(sent):
            if now_s >= due_s[number]:
                payload = stream.payloads[counts[number] % len(stream.payloads)]
                beside = pack(Attachment(epoch, counts[number], now_ns(), 0.0))
                publishers[number].put(payload, attachment=beside)
                counts[number] += 1
                due_s[number] = due_s[number] + 1.0 / stream.rate_hz if stream.rate_hz else begin_s + 2.0 * seconds
        pause.wait(max(0.0, min(due_s) - monotonic_s()))
    return counts


def _frames(encoding: ImageEncoding, rate_hz: float) -> Stream:
    picture = cv2.resize(np.asarray(cv2.imread(PICTURE)), (WIDTH, HEIGHT))
    generator = np.random.default_rng(1)
    frames: list[bytes] = []
    for number in range(DIFFERENT):
        eyes = [np.clip(picture + generator.normal(0, 3, picture.shape), 0, 255).astype(np.uint8) for _ in range(2)]
        left, right = (Image(encoding, WIDTH, HEIGHT, 3, _data(encoding, eye)) for eye in eyes)
        frames.append(encode(StereoFrame(FrameStamp(number, now_ns(), now_ns(), "bench"), left, right)))
    return Stream(FRAMES, tuple(frames), rate_hz)


def _data(encoding: ImageEncoding, image: np.ndarray) -> bytes:
    if encoding is ImageEncoding.RAW:
        return image.tobytes()
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def _calibration() -> Stream:
    K, T_right_left = np.array([[900.0, 0, 640], [0, 900, 360], [0, 0, 1]]), np.eye(4)
    T_right_left[0, 3] = -0.005
    camera = StereoCalibration(WIDTH, HEIGHT, K, K, np.zeros(0), np.zeros(0), T_right_left, 1.0)
    return Stream(CALIBRATION, (encode(camera),), 0.0)


def _filler(topic: Topic, size: int, rate_hz: float, agent: str = "", instance: str = "main") -> Stream:
    return Stream(topic, (np.random.default_rng(size).bytes(size),), rate_hz, agent, instance)
