"""Frames of a rig's camera, heard for a moment by a command."""

import contextlib
import threading
from dataclasses import dataclass

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import StereoCalibration, StereoFrame
from schemas.topics import CALIBRATION, FRAMES
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

FRAMES_WANTED = 60
WITHIN_S = 4.0
FIRST_WITHIN_S = 1.0
"""A camera that gives nothing for so long does not run."""


@dataclass(frozen=True)
class Heard:
    """The frames that came, in their order, and the newest calibration."""

    frames: list[StereoFrame]
    calibration: StereoCalibration | None


def hear_frames(connection: Connection, wanted: int = FRAMES_WANTED, within_s: float = WITHIN_S) -> Heard:
    """As many frames as are wanted, or as come in time."""
    frames, calibrations, came = list[StereoFrame](), list[StereoCalibration](), threading.Condition()

    def take(tapped: Tapped) -> None:
        with contextlib.suppress(MessageError), came:
            if tapped.topic is FRAMES and len(frames) < wanted:
                frames.append(decode(StereoFrame, tapped.payload))
            elif tapped.topic is CALIBRATION:
                calibrations.append(decode(StereoCalibration, tapped.payload))
            came.notify_all()

    with connection.listening((FRAMES, CALIBRATION), take), came:
        came.wait_for(lambda: bool(frames), FIRST_WITHIN_S)
        if frames:
            came.wait_for(lambda: len(frames) >= wanted and bool(calibrations), within_s)
        ordered = sorted(frames, key=lambda frame: frame.stamp.sequence)
        return Heard(ordered, calibrations[-1] if calibrations else None)
