"""Why a frame cannot be used, told before any of its pixels is looked at."""

from schemas.messages import FrameStamp, StereoCalibration, StereoFrame
from schemas.topics import FRAMES

MS = 1_000_000
UNKNOWN_PERIOD_NS = 40 * MS
"""Taken for the frame period where no frame before tells it: that of the slowest usual video, 25 Hz."""
LONGEST_PERIOD_NS = round((FRAMES.maximum_age_ms or 0) * MS)
"""A camera that gives nothing for longer has paused: the way from frame to frame is no period then."""


def apart(stamp: FrameStamp, last: FrameStamp | None) -> str:
    """Why the images of a pair do not go together in time; empty where they do.

    Args:
        last: stamp of the frame that was looked at before, if any was.
    """
    between_ns = abs(stamp.capture_left_ns - stamp.capture_right_ns)
    most_ns = _period_ns(stamp, last)
    if between_ns <= most_ns:
        return ""
    return (
        f"the eyes were captured {between_ns / MS:.0f} ms apart, and at most a frame period of {most_ns / MS:.0f} ms "
        "is accepted; synchronise the eyes of the camera"
    )


def mismatch(frame: StereoFrame, calibration: StereoCalibration, calibration_id: str) -> str:
    """Why a frame does not go with the newest calibration, which has that identity; empty where it does."""
    taken_with = frame.stamp.calibration_id
    if taken_with not in ("", calibration_id):
        return f"the frame was taken with calibration {taken_with}, and the newest known is {calibration_id}"
    size, wanted = (frame.left.width, frame.left.height), (calibration.image_width, calibration.image_height)
    if size != wanted:
        return f"the images are {size[0]}x{size[1]} and the calibration is for {wanted[0]}x{wanted[1]}"
    return ""


def _period_ns(stamp: FrameStamp, last: FrameStamp | None) -> float:
    """How long a frame of the camera lasts, by the left eye; a constant where the frame before does not tell."""
    if last is None or stamp.sequence <= last.sequence:
        return UNKNOWN_PERIOD_NS
    period_ns = (stamp.capture_left_ns - last.capture_left_ns) / (stamp.sequence - last.sequence)
    return period_ns if 0 < period_ns <= LONGEST_PERIOD_NS else UNKNOWN_PERIOD_NS
