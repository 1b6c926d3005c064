"""Video files and devices, through OpenCV; frames of two of them are paired by when they were taken.

Frames i of the left and j of the right make a pair where their time stamps a_i, b_j are at most half a frame period
apart. Of two that are farther apart, the older one is dropped and the next of its stream taken, until they fit: since
the stamps of a stream increase, nothing that comes later fits the older one any better. The shorter of both periods
counts, so that each frame of the slower stream finds the nearest of the faster one.
"""

import logging
import math
from collections import deque
from collections.abc import Callable
from statistics import median
from typing import Protocol

import cv2
import numpy as np

from agents.camera.sources import BrokenOffError, Pair, SourceError, halves
from shared.clock import monotonic_s

OPENED_ON_HOST = "/dev/"
STREAM = "://"
STAMP_ROUNDING_MS = 1.0
"""Containers such as Matroska round stamps to milliseconds."""
OLDEST_DRIVER_STAMP_MS = 1000.0
"""A driver's stamp that lies this far or less before the host's monotonic clock is a reading of it (V4L2's are)."""
MOST_DROPPED = 30
"""Of devices, for one pair: a second, after which their stamps will not meet."""
LIKE_PER_LINE = 100
"""After the first, only every so many dropped frames get a line in the log."""
REMEMBERED_INTERVALS = 5


class Capture(Protocol):
    """What is used of `cv2.VideoCapture`."""

    def grab(self) -> bool: ...
    def retrieve(self) -> tuple[bool, np.ndarray]: ...
    def get(self, property_id: int, /) -> float: ...
    def release(self) -> None: ...


class _Stream:
    """One file or device, and when its newest frame was taken."""

    def __init__(self, name: str, capture: Capture, clock_s: Callable[[], float]) -> None:
        self.name, self.is_live = name, _is_live(name)
        self._capture, self._clock_s = capture, clock_s
        rate = capture.get(cv2.CAP_PROP_FPS)
        self._nominal_ms = 1000.0 / rate if math.isfinite(rate) and rate > 0 else 0.0
        self._intervals_ms: deque[float] = deque(maxlen=REMEMBERED_INTERVALS)
        self.at_ms, self.grabbed, self.dropped = -math.inf, 0, 0

    @property
    def period_ms(self) -> float:
        """Between two frames; infinite as long as nobody knows. A camera in the dark is slower than it says."""
        measured = median(self._intervals_ms) if self._intervals_ms else 0.0
        return max(self._nominal_ms, measured) or math.inf

    def grab(self) -> bool:
        """Take the next frame; whether there is one."""
        if not self._capture.grab():
            return False
        self.at_ms, self.grabbed = self._stamp_ms(), self.grabbed + 1
        return True

    def drop(self) -> bool:
        """Take the next frame in place of this one, and so learn how far apart the two are."""
        before_ms = self.at_ms
        if not self.grab():
            return False
        self.dropped += 1
        self._intervals_ms.append(self.at_ms - before_ms)
        return True

    def image(self) -> np.ndarray:
        found, image = self._capture.retrieve()
        if not found:
            raise SourceError(f"a frame of {self.name!r} cannot be decoded; record it again if there are many")
        return np.asarray(image, np.uint8)

    def release(self) -> None:
        self._capture.release()

    def _stamp_ms(self) -> float:
        said_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC)
        if self.is_live:
            now_ms = 1e3 * self._clock_s()
            return said_ms if 0.0 <= now_ms - said_ms <= OLDEST_DRIVER_STAMP_MS else now_ms
        if math.isfinite(said_ms) and said_ms > self.at_ms:
            return said_ms
        # a file without stamps: its frames are counted
        return self.at_ms + (self._nominal_ms or 1.0)


class VideoSource:
    """Pairs from one side-by-side video, or from two videos or devices whose frames are paired by time.

    A device number such as "0", a path in /dev, or an address opens something live, all else is a file.

    Fields:
        taken_ns: when both images of the last pair were taken, from the moment it was asked for; of files, which know
            no clock, the later of the two was taken just then.

    Raises:
        SourceError: where one cannot be opened, or one is a file and the other is not.
    """

    def __init__(
        self,
        left: str,
        right: str | None,
        open_capture: Callable[[str], Capture] | None = None,
        clock_s: Callable[[], float] = monotonic_s,
    ) -> None:
        names = [name for name in (left, right) if name is not None]
        if len({_is_live(name) for name in names}) > 1:
            raise SourceError(f"one of {left!r} and {right!r} is a file and the other a device; give two of a kind")
        self._streams = [_Stream(name, (open_capture or _opened)(name), clock_s) for name in names]
        self._clock_s, self._first, self._ended, self._paired = clock_s, None, False, False
        self.taken_ns = (0, 0)
        self._log = logging.getLogger("suturegrasp.camera.main")

    @property
    def dropped(self) -> tuple[int, ...]:
        """How many frames of each file or device had no partner."""
        return tuple(stream.dropped for stream in self._streams)

    def size(self) -> tuple[int, int]:
        """Width and height of one eye's image, from the first pair; that of a file will be read all the same.

        Raises:
            SourceError: where there is none.
        """
        first = self.read()
        if first is None:
            raise SourceError(f"{self._names()}: the source gives no frame")
        self._first = None if self._streams[0].is_live else first
        return first[0].shape[1], first[0].shape[0]

    def read(self) -> Pair | None:
        """The next pair; None at the end of a file.

        Raises:
            BrokenOffError: where a device gives no more frames, or never gave one.
            SourceError: where a frame cannot be decoded, the two differ in size, or a file never gave a pair.
        """
        if self._first is not None:
            first, self._first = self._first, None
            return first
        asked_ms = 1e3 * self._clock_s()
        if self._ended or not (all(map(self._next, self._streams)) and self._meet()):
            return None
        images = [stream.image() for stream in self._streams]
        self._paired = True
        origin_ms = asked_ms if self._streams[0].is_live else max(stream.at_ms for stream in self._streams)
        taken = [round(1e6 * (stream.at_ms - origin_ms)) for stream in self._streams]
        self.taken_ns = taken[0], taken[-1]
        if len(images) == 1:
            return halves(images[0])
        if images[0].shape != images[1].shape:
            sizes = " and ".join(f"{image.shape[1]}x{image.shape[0]}" for image in images)
            raise SourceError(f"the two videos differ in size: {sizes}; record both eyes alike")
        return images[0], images[1]

    def close(self) -> None:
        """Release the files or devices."""
        for stream in self._streams:
            stream.release()

    def _meet(self) -> bool:
        """Drop the older frame until both fit; whether they do before a file ends."""
        if len(self._streams) == 1:
            return True
        left, right = self._streams
        dropped = 0
        while abs(left.at_ms - right.at_ms) > 0.5 * min(left.period_ms, right.period_ms) + STAMP_ROUNDING_MS:
            if left.is_live and dropped == MOST_DROPPED:
                raise SourceError(
                    f"after {dropped} dropped frames those of {self._names()} still lie "
                    f"{abs(left.at_ms - right.at_ms):.0f} ms apart; check that both deliver at one rate"
                )
            older = min(left, right, key=lambda stream: stream.at_ms)
            if not self._next(older, drop=True):
                return False
            dropped += 1
            if older.dropped % LIKE_PER_LINE == 1:
                self._log.warning("%d frames of %r had no partner in time and were dropped", older.dropped, older.name)
        return True

    def _next(self, stream: _Stream, drop: bool = False) -> bool:
        """The next frame of a stream; False at the end of a file."""
        if stream.drop() if drop else stream.grab():
            return True
        if stream.is_live:
            raise BrokenOffError(
                f"video device {stream.name!r} has broken off after {stream.grabbed} frames; check its cable and "
                "start the camera again"
                if stream.grabbed
                else f"video device {stream.name!r} never gave a frame; check that no other program uses it"
            )
        if not stream.grabbed:
            raise SourceError(f"the video {stream.name!r} holds no frame that can be decoded; record it again")
        self._ended = True
        if not self._paired:
            raise SourceError(f"no frames of {self._names()} lie within half a frame period; give videos of one take")
        return False

    def _names(self) -> str:
        return " and ".join(repr(stream.name) for stream in self._streams)


def _is_live(name: str) -> bool:
    return name.isdigit() or name.startswith(OPENED_ON_HOST) or STREAM in name


def _opened(name: str) -> Capture:
    capture = cv2.VideoCapture(int(name) if name.isdigit() else name)
    if not capture.isOpened():
        raise SourceError(f"OpenCV cannot open {name!r}; for capture cards that it does not know, use source 'pipe'")
    return capture
