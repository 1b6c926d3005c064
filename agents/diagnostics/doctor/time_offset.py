"""By how much a running rig's camera is later than an arm's joints, watched while the arm moves."""

import contextlib
import queue
import threading
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import UInt8

from agents.diagnostics.doctor.finding import UNKNOWN, Finding
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import RobotState, StereoFrame
from schemas.topics import FRAMES, ROBOT_STATE
from shared.calibration.time_offset import TOO_LITTLE, Window, motion_of, time_offset, windows_of
from shared.images import ImageDataError, decode_image
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

WAITING = 64
"""Frames; on a machine that does not keep up the rest are left out."""
WHAT = "camera and joints"
LOOK_S = 0.1


@dataclass
class Watch:
    """What came while it was listened."""

    arm: str
    states: dict[int, RobotState] = field(default_factory=dict[int, RobotState])
    windows: list[Window] = field(default_factory=list[Window])
    _frames: "queue.Queue[Tapped]" = field(default_factory=lambda: queue.Queue(WAITING))
    _ended: threading.Event = field(default_factory=threading.Event)

    def take(self, tapped: Tapped) -> None:
        """A frame or a state, from another thread."""
        if tapped.topic is FRAMES:
            with contextlib.suppress(queue.Full):
                self._frames.put_nowait(tapped)
            return
        with contextlib.suppress(MessageError):
            state = decode(RobotState, tapped.payload)
            if state.arm == self.arm:
                self.states[state.measured_ns] = state

    def look(self) -> None:
        """Look for what moves in the frames, until `end`."""
        self.windows.extend(windows_of(self._images()))

    def end(self) -> None:
        """No more frames."""
        self._ended.set()

    def _images(self) -> Iterator[tuple[float, UInt8[np.ndarray, "h w *c"]]]:
        while not self._ended.is_set():
            with contextlib.suppress(queue.Empty, MessageError, ImageDataError):
                frame = decode(StereoFrame, self._frames.get(timeout=LOOK_S).payload)
                yield frame.stamp.capture_left_ns * 1e-9, decode_image(frame.left)


@contextlib.contextmanager
def watching(connection: Connection, arm: str) -> Generator[Watch]:
    """Watch camera and arm meanwhile; afterwards `finding` tells."""
    watch = Watch(arm)
    looking = threading.Thread(target=watch.look, name="time offset")
    looking.start()
    try:
        with connection.listening((FRAMES, ROBOT_STATE), watch.take):
            yield watch
    finally:
        watch.end()
        looking.join()


def finding(watch: Watch, latency_ms: float) -> Finding:
    """What came of it, where the camera has that `latency_ms` now."""
    if len(watch.states) < 2:
        return Finding(WHAT, f"{UNKNOWN}: the rig tells no state of {watch.arm}")
    found = time_offset(watch.windows, motion_of(watch.states))
    if found is None:
        return Finding(WHAT, f"{UNKNOWN}: {TOO_LITTLE}; move the arm in view meanwhile, for half a minute")
    low, high = (1e3 * value for value in found.interval_s)
    told = f"the camera's stamps are {1e3 * found.delay_s:+.0f} ms later, 95 % within {low:+.0f} and {high:+.0f}"
    if low <= 0 <= high:
        return Finding(WHAT, told)
    clocks = "where the clocks of the camera's and the bridge's host agree (suturegrasp doctor tells)"
    should_ms = max(0.0, latency_ms + 1e3 * found.delay_s)
    if found.delay_s > 0 or latency_ms > 0:
        return Finding(WHAT, told, f"set latency_ms of [camera] to {should_ms:.0f}, {clocks}")
    return Finding(WHAT, told, "set the clocks of the camera's and the bridge's host, or see why joints come late")
