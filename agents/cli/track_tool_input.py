"""Frames and an arm's states out of a recording, rectified and in metres, for looking for the arm's tool."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from agents.perception.rectification import Rectification, RectificationError, rectification, rectify_image
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import RectifiedStereo, RobotState, StereoCalibration, StereoFrame
from schemas.topics import CALIBRATION, FRAMES, ROBOT_STATE, topic_of
from shared.images import ImageDataError, decode_image
from shared.recording.entry import RecordingError
from shared.recording.mcap_file import read_recording

APART_NS = 60_000_000
"""A state that was measured so far from a frame's time tells nothing of it; one at rest comes ten times a second."""


class Seen(NamedTuple):
    """One frame with the state of the arm at that time."""

    at_s: float
    left: UInt8[np.ndarray, "h w 3"]
    right: UInt8[np.ndarray, "h w 3"]
    state: RobotState
    camera: RectifiedStereo


def seen_in(path: Path, arm: str, delay_ms: float) -> Iterator[Seen]:
    """Frames of a recording, in order, that have a state of the arm; `delay_ms` is how late the camera's stamps are.

    Raises:
        RecordingError: where it is no recording, or lacks what is needed; the text says what.
    """
    states = [decode(RobotState, entry.payload) for entry in read_recording(path) if _is_state(entry.key, arm)]
    if not states:
        raise RecordingError(f"{path}: it holds no state of an arm {arm!r}")
    times = np.array([state.measured_ns for state in states])
    ready: Rectification | None = None
    for entry in read_recording(path):
        topic = topic_of(entry.key)
        if topic is CALIBRATION:
            ready = _rectification(path, decode(StereoCalibration, entry.payload))
        if topic is not FRAMES or ready is None:
            continue
        try:
            frame = decode(StereoFrame, entry.payload)
            left, right = (decode_image(image) for image in (frame.left, frame.right))
        except (MessageError, ImageDataError):
            continue
        at_ns = frame.stamp.capture_left_ns - round(1e6 * delay_ms)
        nearest = int(np.argmin(np.abs(times - at_ns)))
        if abs(int(times[nearest]) - at_ns) <= APART_NS and left.ndim == 3:
            images = rectify_image(left, ready.map_left), rectify_image(right, ready.map_right)
            yield Seen(at_ns * 1e-9, *images, states[nearest], _in_metres(ready.camera))
    if ready is None:
        raise RecordingError(f"{path}: it holds no calibration of a camera")


def _is_state(name: str, arm: str) -> bool:
    return topic_of(name) is ROBOT_STATE and name.split("/")[3] == arm


def _rectification(path: Path, calibration: StereoCalibration) -> Rectification:
    if calibration.metres_per_unit is None:
        raise RecordingError(f"{path}: its calibration does not say its unit of length")
    try:
        return rectification(calibration)
    except RectificationError as error:
        raise RecordingError(f"{path}: {error}") from None


def _in_metres(camera: RectifiedStereo) -> RectifiedStereo:
    return dataclasses.replace(camera, baseline=camera.baseline * (camera.metres_per_unit or 1.0), metres_per_unit=1.0)
