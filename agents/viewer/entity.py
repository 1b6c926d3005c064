"""What every mapping gives: paths with what to log there, when it was so, in which unit, and how often.

All in space is in millimetres. Plans and arms are in metres and a thread is in its calibration's unit; a viewer's
camera also cannot come as close as a thread needs when the scene is a tenth of a unit away. Where nobody knows the
calibration's unit, the thread stays in it.

Of a fast topic the first message in each period of its own time is shown. Periods are counted from 1970, so topics that
descend from one frame keep the same frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr

from schemas.messages import RectifiedStereo, ThreadObservations, ThreadReconstruction
from schemas.topics import (
    FRAME_NOTICE,
    FRAMES,
    HEARTBEAT,
    OBSERVATIONS,
    REPLAY_CLOCK,
    ROBOT_STATE,
    SIMULATOR_STATE,
    THREAD,
    Topic,
)

Entity = tuple[str, Sequence[rr.AsComponents]]

SIDES = ("left", "right")
HALF_PX = 0.5
"""Integers are pixel centres with us, and pixel corners with Rerun."""


EARLIEST_NS = np.iinfo(np.int64).min + 1
LAST_FRAME = np.iinfo(np.int64).max
"""That Rerun can number; on the wire there are more."""


@dataclass(frozen=True)
class Moment:
    """When something was so: nanoseconds since 1970, and the frame it descends from, if any."""

    capture_ns: int
    frame: int | None = None

    def __post_init__(self) -> None:
        # the smallest number of all is no time to NumPy, but "not a time"
        object.__setattr__(self, "capture_ns", max(self.capture_ns, EARLIEST_NS))
        if self.frame is not None and self.frame > LAST_FRAME:
            object.__setattr__(self, "frame", int(LAST_FRAME))


MM = 1e-3
MM_PER_METRE = 1000.0


def camera_in_mm(camera: RectifiedStereo) -> RectifiedStereo:
    """The same cameras, their baseline in millimetres."""
    return replace(camera, baseline=camera.baseline * _mm_per_unit(camera), metres_per_unit=_unit(camera))


def observations_in_mm(observations: ThreadObservations) -> ThreadObservations:
    """The same observations, in millimetres."""
    scale = _mm_per_unit(observations.camera)
    if scale == 1.0:
        return observations
    return replace(
        observations, camera=camera_in_mm(observations.camera), points_camera=observations.points_camera * scale
    )


def reconstruction_in_mm(reconstruction: ThreadReconstruction) -> ThreadReconstruction:
    """The same thread, in millimetres."""
    scale = _mm_per_unit(reconstruction.camera)
    if scale == 1.0:
        return reconstruction
    regions = reconstruction.regions
    return replace(
        reconstruction,
        camera=camera_in_mm(reconstruction.camera),
        control_points_camera=reconstruction.control_points_camera * scale,
        regions=replace(regions, centre_camera=regions.centre_camera * scale, bound_depth=regions.bound_depth * scale),
        posterior_covariance=reconstruction.posterior_covariance * scale**2,
    )


def _mm_per_unit(camera: RectifiedStereo) -> float:
    return 1.0 if camera.metres_per_unit in (None, MM) else camera.metres_per_unit / MM


def _unit(camera: RectifiedStereo) -> float | None:
    return None if camera.metres_per_unit is None else MM


MOST_PER_SECOND = {
    FRAMES: 10,
    OBSERVATIONS: 10,
    THREAD: 10,
    ROBOT_STATE: 20,
    SIMULATOR_STATE: 10,
    FRAME_NOTICE: 2,
    HEARTBEAT: 2,
    REPLAY_CLOCK: 2,
}
"""What an eye can follow, and a machine with room can spare."""

IN_A_FULL_MACHINE = 5
"""Of what descends from frames, which is nearly all of a viewer's work."""

BY_FRAME = (FRAMES, OBSERVATIONS, THREAD)
"""Thinned by when their frame was seen; all others by when they were published, before they are decoded."""


class Thinning:
    """Remembers the last period that each key had a message shown in."""

    def __init__(self) -> None:
        self.there_is_room = True
        self._last: dict[str, int] = {}

    def keeps(self, topic: Topic, key: str, at_ns: int) -> bool:
        """Whether a message of that time is shown."""
        if topic not in MOST_PER_SECOND:
            return True
        most = MOST_PER_SECOND[topic]
        if topic in BY_FRAME and not self.there_is_room:
            most = IN_A_FULL_MACHINE
        period = at_ns * most // 1_000_000_000
        if self._last.get(key) == period:
            return False
        self._last[key] = period
        return True
