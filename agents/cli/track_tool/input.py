"""Frames and an arm's states, of a recording or a running rig, rectified and in metres: to look for the arm's tool."""

import contextlib
import threading
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from agents.cli.recordings.arm_states import arm_states
from agents.tool_tracker.tubes import BRACKET_NS, Placed, in_metres, placed_at
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import RectifiedStereo, RobotState, StereoCalibration, StereoFrame
from schemas.topics import CALIBRATION, FRAMES, ROBOT_STATE, Topic, topic_of
from shared.calibration.identity import calibration_id
from shared.clock import monotonic_s
from shared.images import ImageDataError, decode_image
from shared.recording.entry import RecordingError
from shared.recording.mcap_file import read_recording
from shared.rectification import Rectification, RectificationError, rectification, rectify_image
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

KEPT_STATES = 300
SILENT_S = 3.0
NEXT_STATE_S = 1e-9 * BRACKET_NS
"""Longer than an arm that rests is silent."""


class Seen(NamedTuple):
    """One frame with the place of the arm's tool at that time."""

    at_s: float
    left: UInt8[np.ndarray, "h w 3"]
    right: UInt8[np.ndarray, "h w 3"]
    placed: Placed
    camera: RectifiedStereo
    calibration_id: str


class _Calibrated(NamedTuple):
    ready: Rectification
    id: str


def seen_in(path: Path, arm: str, delay_ms: float) -> Iterator[Seen]:
    """Frames of a recording, in order, that have a state of the arm; `delay_ms` is how late the camera's stamps are.

    Raises:
        RecordingError: where it is no recording, or lacks what is needed; the text says what.
    """
    states = arm_states(path, arm)
    ready: _Calibrated | None = None
    for entry in read_recording(path):
        topic = topic_of(entry.key)
        if topic is CALIBRATION:
            ready = _rectification(str(path), decode(StereoCalibration, entry.payload))
        if topic is FRAMES and ready is not None and (seen := _seen(entry.payload, states, ready, delay_ms)):
            yield seen
    if ready is None:
        raise RecordingError(f"{path}: it holds no calibration of a camera")


def seen_live(connection: Connection, arm: str, delay_ms: float, stopped: threading.Event) -> Iterator[Seen]:
    """The newest frame whenever the one before was looked at, until stopped; of a running rig.

    Raises:
        RecordingError: where no frame, calibration or state comes.
    """
    states, newest, came = deque[RobotState](maxlen=KEPT_STATES), dict[Topic, bytes](), threading.Event()

    def take(tapped: Tapped) -> None:
        if tapped.topic is ROBOT_STATE:
            with contextlib.suppress(MessageError):
                state = decode(RobotState, tapped.payload)
                if state.arm == arm:
                    states.append(state)
        else:
            newest[tapped.topic] = tapped.payload
        came.set()

    ready, shown, silent_since_s = None, b"", monotonic_s()
    with connection.listening((FRAMES, CALIBRATION, ROBOT_STATE), take):
        while not stopped.is_set():
            frame = newest.pop(FRAMES, None)
            silent_s = monotonic_s() - silent_since_s
            if frame is None and silent_s > SILENT_S:
                raise RecordingError("no frame comes: start the rig with suturegrasp up")
            if frame is None or not states or CALIBRATION not in newest:
                if frame is not None and silent_s > SILENT_S:
                    raise RecordingError(f"no {'calibration' if states else f'state of {arm}'} comes: is it running?")
                came.wait(SILENT_S)
                came.clear()
                continue
            silent_since_s = monotonic_s()
            if newest[CALIBRATION] != shown:
                shown = newest[CALIBRATION]
                ready = _rectification("the camera's calibration", decode(StereoCalibration, shown))
            _await_state_after(states, came)
            if ready is not None and (seen := _seen(frame, list(states), ready, delay_ms)):
                yield seen


def _await_state_after(states: deque[RobotState], came: threading.Event) -> None:
    """Wait for a state that is newer than the last one here, for a frame lies between two."""
    before, until_s = states[-1].measured_ns, monotonic_s() + NEXT_STATE_S
    while states[-1].measured_ns == before and (left_s := until_s - monotonic_s()) > 0:
        came.wait(left_s)
        came.clear()


def _seen(payload: bytes, states: list[RobotState], calibrated: _Calibrated, delay_ms: float) -> Seen | None:
    """A frame with the tool's place then; None where none was measured near it, or it cannot be read."""
    try:
        frame = decode(StereoFrame, payload)
        left, right = (decode_image(image) for image in (frame.left, frame.right))
    except (MessageError, ImageDataError):
        return None
    at_ns = frame.stamp.capture_left_ns - round(1e6 * delay_ms)
    placed = placed_at(states, at_ns)
    if placed is None or left.ndim != 3:
        return None
    ready = calibrated.ready
    images = rectify_image(left, ready.map_left), rectify_image(right, ready.map_right)
    return Seen(at_ns * 1e-9, *images, placed, in_metres(ready.camera), calibrated.id)


def _rectification(name: str, calibration: StereoCalibration) -> _Calibrated:
    if calibration.metres_per_unit is None:
        raise RecordingError(f"{name}: its calibration does not say its unit of length")
    try:
        return _Calibrated(rectification(calibration), calibration_id(calibration))
    except RectificationError as error:
        raise RecordingError(f"{name}: {error}") from None
