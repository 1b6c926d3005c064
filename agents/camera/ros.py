"""Frames of a robot's endoscope as ROS publishes them: two image topics with camera_info beside, over Zenoh.

Both eyes are captured apart, so frames are paired by their stamps: two fit where they are at most half a frame period
apart, by the faster of both topics. The newest fitting pair is given, each once.
"""

import threading
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from agents.camera.bag import SIDES, camera_info_topic, decoded_image, stated_camera_info
from agents.camera.sources import Pair, SourceError
from shared.calibration import ReadCalibration, calibration_of_camera_infos
from shared.clock import monotonic_s, now_ns
from shared.ros.far_clock import FarClock
from shared.ros.link import Heard, RosLink
from shared.ros.naming import Naming
from shared.ros.types import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, RosMessageError, decode
from shared.runtime.session import SessionSettings

SECOND_NS = 1_000_000_000
KEPT = 4
FIRST_S, LOOK_S = 10.0, 0.05
"""How long the first frames and the calibration may take to come."""


class _Frame(NamedTuple):
    stamp_ns: int
    taken_ns: int
    message: Any


class RosSource:
    """Pairs of two live image topics.

    Args:
        left, right: names of topics without the leading slash; those that end in `compressed` are CompressedImage.

    Fields:
        taken_ns: when both images of the last pair were taken, by their own clock, from the moment it was asked for.

    Raises:
        SourceError: where frames or camera_info of an eye do not come in time.
    """

    def __init__(self, settings: SessionSettings, naming: Naming, left: str, right: str) -> None:
        self._topics, self.taken_ns = (left, right), (0, 0)
        self._lock, self._frames = threading.Lock(), tuple(deque[_Frame](maxlen=KEPT) for _ in SIDES)
        self._infos: list[bytes | None] = [None, None]
        self._clocks, self._given_ns = tuple(FarClock() for _ in SIDES), -1
        heard = [self._heard(side, topic) for side, topic in enumerate(self._topics)]
        heard += [
            Heard(camera_info_topic(topic), CAMERA_INFO, self._keeping_info(side))
            for side, topic in enumerate(self._topics)
        ]
        self._link = RosLink(settings, naming, tuple(heard))
        self._link.open()
        self._await_first(settings.endpoint)

    def size(self) -> tuple[int, int]:
        """Width and height of one eye's image."""
        height, width = self._image(0, self._frames[0][-1]).shape[:2]
        return width, height

    def calibration(self, unit: str | None, image_size: tuple[int, int]) -> ReadCalibration:
        """What the camera_info topics beside the images state.

        Raises:
            CalibrationError: where they are none that can be used.
        """
        left, right = (
            stated_camera_info(decode(CAMERA_INFO, info or b""), topic)
            for info, topic in zip(self._infos, self._topics, strict=True)
        )
        name = " and ".join(self._topics)
        return calibration_of_camera_infos(left, right, unit=unit, image_size=image_size, name=name)

    def read(self) -> Pair | None:
        """The newest pair; None where there is no new one.

        Raises:
            SourceError: where a frame cannot be decoded, or both differ in size.
        """
        with self._lock:
            pair = _newest_pair(*map(tuple, self._frames))
        if pair is None or pair[0].stamp_ns <= self._given_ns:
            return None
        self._given_ns = pair[0].stamp_ns
        asked_ns = now_ns()
        self.taken_ns = pair[0].taken_ns - asked_ns, pair[1].taken_ns - asked_ns
        left, right = (self._image(side, frame) for side, frame in enumerate(pair))
        if left.shape != right.shape:
            raise SourceError(f"images of {self._topics[0]} and {self._topics[1]} differ in size; publish both alike")
        return left, right

    def close(self) -> None:
        """Hear nothing more."""
        self._link.close()

    def _heard(self, side: int, topic: str) -> Heard:
        ros_type = COMPRESSED_IMAGE if topic.endswith("compressed") else IMAGE

        def receive(data: bytes, arrived_ns: int) -> None:
            try:
                message = decode(ros_type, data)
            except RosMessageError:
                return
            stamp = message.header.stamp
            stamp_ns = stamp.sec * SECOND_NS + stamp.nanosec
            with self._lock:
                taken_ns = self._clocks[side].measured_ns(stamp_ns, arrived_ns)
                self._frames[side].append(_Frame(stamp_ns or arrived_ns, taken_ns, message))

        return Heard(topic, ros_type, receive)

    def _keeping_info(self, side: int) -> Any:
        def keep(data: bytes, _arrived_ns: int) -> None:
            self._infos[side] = data

        return keep

    def _await_first(self, endpoint: str) -> None:
        deadline_s, turn = monotonic_s() + FIRST_S, threading.Event()
        while missing := self._missing():
            if monotonic_s() > deadline_s or self._link.failed:
                self.close()
                why = self._link.failed or f"nothing came of {missing} at {endpoint}"
                raise SourceError(f"{why}; see that it is published, and named so in left_topic and right_topic")
            turn.wait(LOOK_S)

    def _missing(self) -> str:
        """The topics of which nothing has come yet."""
        frames = [topic for topic, frames in zip(self._topics, self._frames, strict=True) if not frames]
        infos = [topic for topic, info in zip(self._topics, self._infos, strict=True) if info is None]
        return ", ".join([*frames, *map(camera_info_topic, infos)])

    def _image(self, side: int, frame: _Frame) -> np.ndarray:
        return decoded_image(frame.message, f"an image of {self._topics[side]}")


def _newest_pair(left: tuple[_Frame, ...], right: tuple[_Frame, ...]) -> tuple[_Frame, _Frame] | None:
    """The newest frames of both eyes that fit; those of an eye are in their order."""
    apart_ns = _half_period_ns(left, right)
    fitting = [(a, b) for a in left for b in right if abs(a.stamp_ns - b.stamp_ns) <= apart_ns]
    return max(fitting, key=lambda pair: pair[0].stamp_ns + pair[1].stamp_ns, default=None)


def _half_period_ns(*eyes: tuple[_Frame, ...]) -> float:
    """Half of the least period between frames; unlimited where none is known yet."""
    stamps = [[frame.stamp_ns for frame in eye] for eye in eyes]
    periods = [int(np.median(np.diff(eye))) for eye in stamps if len(eye) > 1]
    return 0.5 * min(periods) if periods else float("inf")
