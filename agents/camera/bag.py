"""Recordings of ROS 1 and ROS 2 with two image topics; frames of both eyes are paired by their headers' stamps.

Two frames fit where they are at most half a frame period apart, by the faster of both topics. Stamps of a topic
increase, so of two that do not fit the older one fits nothing that comes later, and is dropped.
"""

import dataclasses
import logging
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.image import ImageError, message_to_cvimage
from rosbags.image.image import to_cvtype
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from agents.camera.sources import Pair, SourceError
from shared.calibration import CalibrationError, ReadCalibration, calibration_of_camera_infos
from shared.clock import monotonic_s

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
SIDES = ("left", "right")
RECTIFIED = "rect"
"""What the name of a topic says whose images are rectified already (image_proc's image_rect, image_rect_color)."""
SECOND_NS = 1_000_000_000


class _Frame(NamedTuple):
    taken_ns: int
    message: Any


class BagSource:
    """Pairs of a bag in their order, each no sooner than its stamp says, one for every time it is asked.

    Args:
        left, right: the image topics; None takes the one image topic whose name says so.

    Fields:
        taken_ns: when both images of the last pair were taken, from the moment it was asked for: the later one just
            then.

    Raises:
        SourceError: where the bag cannot be read, or its topics are not as named, or not told apart.
    """

    def __init__(
        self,
        path: Path,
        left: str | None = None,
        right: str | None = None,
        loop: bool = True,
        clock_s: Callable[[], float] = monotonic_s,
    ) -> None:
        self._path, self._loop, self._clock_s = path, loop, clock_s
        self._reader = _opened(path)
        try:
            self._topics = tuple(self._connection(side, name) for side, name in zip(SIDES, (left, right), strict=True))
        except SourceError:
            self._reader.close()
            raise
        self._pairs, self._waiting, self._first = self._all_pairs(), None, (0.0, 0)
        self._begun = self._ended = False
        self.dropped, self.taken_ns = 0, (0, 0)
        self._log = logging.getLogger("suturegrasp.camera.main")

    def size(self) -> tuple[int, int]:
        """Width and height of one eye's image, from the first pair.

        Raises:
            SourceError: where there is none.
        """
        first = next(self._all_pairs(), None)
        if first is None:
            names = " and ".join(connection.topic for connection in self._topics)
            raise SourceError(f"{self._path}: no frames of {names} lie within half a frame period of each other")
        height, width = self._image(0, first[0]).shape[:2]
        return width, height

    def calibration(self, unit: str | None, image_size: tuple[int, int]) -> ReadCalibration:
        """What the camera_info topics beside the images state.

        Raises:
            CalibrationError: where there are none, or no usable ones.
        """
        left, right = (self._camera_info(connection.topic) for connection in self._topics)
        return calibration_of_camera_infos(left, right, unit=unit, image_size=image_size, name=str(self._path))

    def read(self) -> Pair | None:
        """The next pair once it is due; None before, and at the end.

        Raises:
            SourceError: where a frame cannot be decoded, or both differ in size.
        """
        waiting = self._waiting or self._next()
        if waiting is None:
            return None
        taken = max(frame.taken_ns for frame in waiting)
        now_s = self._clock_s()
        if not self._begun:
            self._begun, self._first = True, (now_s, taken)
        begun_s, first_ns = self._first
        if (taken - first_ns) / SECOND_NS > now_s - begun_s:
            self._waiting = waiting
            return None
        self._waiting = None
        self.taken_ns = waiting[0].taken_ns - taken, waiting[1].taken_ns - taken
        left, right = (self._image(side, frame) for side, frame in enumerate(waiting))
        if left.shape != right.shape:
            raise SourceError(f"{self._path}: the images of both eyes differ in size; record both alike")
        return left, right

    def close(self) -> None:
        """Close the bag."""
        self._reader.close()

    def _next(self) -> tuple[_Frame, _Frame] | None:
        if self._ended:
            return None
        found = next(self._pairs, None)
        if found is None and self._loop and self._begun:
            self._pairs, self._begun = self._all_pairs(), False
            found = next(self._pairs, None)
        if found is None:
            self._ended = True
            self._log.info("%s has ended; %d frames had no partner in time", self._path, self.dropped)
        return found

    def _all_pairs(self) -> Iterator[tuple[_Frame, _Frame]]:
        queues: dict[str, deque[_Frame]] = {connection.topic: deque() for connection in self._topics}
        left, right = queues.values()
        apart_ns = self._half_period_ns()
        for frame, topic in self._frames():
            queues[topic].append(frame)
            while left and right:
                if abs(left[0].taken_ns - right[0].taken_ns) <= apart_ns:
                    yield left.popleft(), right.popleft()
                else:
                    min(left, right, key=lambda queue: queue[0].taken_ns).popleft()
                    self.dropped += 1

    def _frames(self) -> Iterator[tuple[_Frame, str]]:
        # another error for every part of a file that may be damaged
        try:
            for connection, recorded_ns, data in self._reader.messages(self._topics):
                message: Any = self._reader.deserialize(data, connection.msgtype)
                stamp = message.header.stamp
                stated_ns = stamp.sec * SECOND_NS + stamp.nanosec
                yield _Frame(stated_ns or recorded_ns, message), connection.topic
        except Exception as error:
            raise SourceError(f"{self._path} is damaged: {error}; what lay before was played") from error

    def _half_period_ns(self) -> float:
        most = max(connection.msgcount for connection in self._topics)
        return 0.5 * self._reader.duration / max(1, most - 1)

    def _image(self, side: int, frame: _Frame) -> np.ndarray:
        return decoded_image(frame.message, f"{self._path}: an image of {self._topics[side].topic}")

    def _connection(self, side: str, name: str | None) -> Connection:
        images = [c for c in self._reader.connections if c.msgtype in IMAGES]
        found = [c for c in images if (c.topic == name if name else side in c.topic.lower())]
        if len({c.topic for c in found}) == 1:
            return found[0]
        known = ", ".join(sorted({c.topic for c in images})) or "none"
        what = f"has no image topic {name}" if name else f"has {len(found)} image topics that are named {side}"
        raise SourceError(f"{self._path} {what}; give {side}_topic, one of: {known}")

    def _camera_info(self, image_topic: str) -> dict[str, Any]:
        wanted = camera_info_topic(image_topic)
        beside = [c for c in self._reader.connections if c.msgtype == CAMERA_INFO]
        found = [c for c in beside if c.topic == wanted]
        if not found:
            known = ", ".join(sorted({c.topic for c in beside})) or "none"
            raise CalibrationError(
                f"{self._path} has no {wanted} beside {image_topic} (its camera_info topics: {known}); "
                "give a calibration"
            )
        _, _, data = next(self._reader.messages(found[:1]))
        return stated_camera_info(self._reader.deserialize(data, CAMERA_INFO), image_topic)


def camera_info_topic(image_topic: str) -> str:
    """Where ROS publishes the calibration that goes with an image topic."""
    return f"{_namespace(image_topic)}/camera_info"


def stated_camera_info(info: Any, image_topic: str) -> dict[str, Any]:
    """What a camera_info message states of the images of that topic, which may be rectified already."""
    fields = vars(info).items()
    stated = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in fields}
    image = image_topic[len(_namespace(image_topic)) :]
    return _of_rectified_images(stated) if RECTIFIED in image else stated


def decoded_image(message: Any, what: str) -> np.ndarray:
    """An image message as blue, green, red; `what` is what an error calls it.

    Raises:
        SourceError: where it cannot be decoded.
    """
    try:
        return np.ascontiguousarray(message_to_cvimage(_without_padding(message), "bgr8"), np.uint8)
    except (ImageError, AssertionError, TypeError, ValueError, cv2.error) as error:
        raise SourceError(f"{what} cannot be decoded: {error or 'damaged'}") from error


def _namespace(image_topic: str) -> str:
    return image_topic.removesuffix("/compressed").rpartition("/")[0]


def _opened(path: Path) -> AnyReader:
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except (AnyReaderError, OSError, AssertionError, ValueError, KeyError) as error:
        raise SourceError(
            f"{path} cannot be read as a bag: {error}; give a .bag file of ROS 1, or the folder of a ROS 2 bag"
        ) from error
    return reader


def _without_padding(message: Any) -> Any:
    """The image with rows that end where their pixels do."""
    if not hasattr(message, "step"):
        return message
    _, _, dtype, channels = to_cvtype(message.encoding)
    row = message.width * channels * np.dtype(dtype).itemsize
    if message.step <= row:
        return message
    rows = np.reshape(message.data[: message.height * message.step], (message.height, message.step))
    return dataclasses.replace(message, step=row, data=rows[:, :row].reshape(-1))


def _of_rectified_images(stated: dict[str, Any]) -> dict[str, Any]:
    """What camera_info says of images that were rectified already: P alone holds of them."""
    by_name = {name.lower(): name for name in stated}
    P = np.reshape(stated[by_name["p"]], (3, 4))
    ideal = {"k": P[:, :3].ravel().tolist(), "d": [], "r": np.eye(3).ravel().tolist(), "distortion_model": ""}
    return stated | {by_name[name]: value for name, value in ideal.items()}
