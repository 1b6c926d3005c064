"""What is due in a frame beside finding its thread: at most one thing, and then some frames without any.

Each takes as long as following a frame or longer. Where a machine keeps up, each comes as often as it should. Where
frames of the camera are left out, each comes less often: else what is due by the clock would fill the frames that are
left, and still fewer would be looked at.
"""

from enum import Enum, auto
from math import inf

from schemas.messages import FrameStamp, ThreadObservations


class Due(Enum):
    """A thing that is due."""

    JUDGED = auto()
    """The pair, by the whole of both images."""
    GLANCE = auto()
    """A look at a part of one image."""
    OCCLUDERS = auto()
    """What may hide thread."""
    SURFACE = auto()
    """The tissue around the thread."""


FRAMES_BETWEEN = {Due.JUDGED: 60, Due.GLANCE: 10, Due.OCCLUDERS: 15, Due.SURFACE: 15}
"""Of the camera. All eight parts are glanced at in less than three seconds; instruments move by themselves."""
OLDEST_S = {Due.SURFACE: 2.0}
"""Then it goes first and waits for no other, however seldom frames come: the planner takes one of three seconds."""
REST, LONGEST_REST = 2, 15
"""Frames that are looked at without anything beside, between two with it; and of the camera's, after a pause."""
GLANCES_AFTER_LOOK = 30
"""Of the camera's frames: a look at the whole has seen all."""


def due(stamp: FrameStamp, last: ThreadObservations, is_watched: bool) -> Due | None:
    """What is due in a frame: what grows too old, and else what has waited longest by its own measure.

    Args:
        stamp: of the frame.
        last: the observations before it.
        is_watched: whether the pair is judged, and parts of it glanced at, beside a thread that is followed.
    """
    sequence, looked = stamp.sequence, last.looked_sequence
    done = {Due.SURFACE: last.surface_sequence}
    if last.occluders is not None:
        done[Due.OCCLUDERS] = last.occluders.sequence
    if is_watched:
        done[Due.JUDGED] = judged_in(last)
        done[Due.GLANCE] = max(looked + GLANCES_AFTER_LOOK - FRAMES_BETWEEN[Due.GLANCE], last.glanced_sequence or 0)
    step = sequence - last.stamp.sequence
    # where the camera begins again, all was done before that
    since = {one: inf if then is None or step < 0 else sequence - then for one, then in done.items()}
    frame_s = 1e-9 * (stamp.capture_left_ns - last.stamp.capture_left_ns) / step if step > 0 else 0.0
    for one, oldest_s in OLDEST_S.items():
        if since[one] * frame_s >= oldest_s:
            return one
    # as many of the camera's frames are left out as before this one
    beside = [then for then in done.values() if then is not None and looked < then <= last.stamp.sequence]
    if step > 0 and beside and sequence - max(beside) <= min(REST * step, LONGEST_REST):
        return None
    most = max(since, key=lambda one: since[one] / FRAMES_BETWEEN[one])
    return most if since[most] >= FRAMES_BETWEEN[most] else None


def judged_in(last: ThreadObservations) -> int:
    """The frame in which the pair was judged last."""
    return last.looked_sequence if last.judged_sequence is None else last.judged_sequence
