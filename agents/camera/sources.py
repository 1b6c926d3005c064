"""Where frames come from: folders of images, raw frames on a pipe; video files and devices are in `video`.

A source gives one pair after another and knows no topics. The agent stamps each pair with the tick at which it asked
for it, shifted by what the source knows of when it was taken, less the configured latency of the capture chain.
"""

import os
import select
import threading
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
from jaxtyping import UInt8

from agents.camera.image_files import ImageFileError, read_pair, read_side_by_side

Pair = tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
LOOK_S = 0.1
"""How soon a silent pipe notices that it is closed."""


class SourceError(ValueError):
    """A source that gives no frames; the text names the remedy."""


class BrokenOffError(SourceError):
    """A source that will give no more frames, however often it is asked, unless it is opened again."""


class Source(Protocol):
    """Gives pairs of images."""

    @property
    def taken_ns(self) -> tuple[int, int]:
        """When the left and the right image of the last pair were taken, from the moment it was asked for."""
        ...

    def read(self) -> Pair | None:
        """The next pair; None at the end, or where no new one is there yet."""
        ...

    def close(self) -> None:
        """Let go of files and devices."""
        ...


class ImageSource:
    """Pairs from folders: `left` and `right` in name order, or one folder of side-by-side images.

    Raises:
        SourceError: where there are no images, or not equally many on both sides.
    """

    taken_ns = 0, 0

    def __init__(self, left: Path, right: Path | None, loop: bool) -> None:
        self._left, self._loop = _images(left), loop
        self._right = _images(right) if right is not None else None
        if self._right is not None and len(self._left) != len(self._right):
            raise SourceError(
                f"{left} holds {len(self._left)} images and {right} holds {len(self._right)}; give equally many, "
                "which pair up in name order"
            )
        self._next = 0

    def read(self) -> Pair | None:
        """The next pair in name order, from the first again where it loops."""
        if self._next == len(self._left):
            if not self._loop:
                return None
            self._next = 0
        index, self._next = self._next, self._next + 1
        try:
            if self._right is None:
                return read_side_by_side(self._left[index])
            return read_pair(self._left[index], self._right[index])
        except ImageFileError as error:
            raise SourceError(str(error)) from None

    def close(self) -> None:
        """Nothing is held open."""


def _images(folder: Path) -> list[Path]:
    if folder.is_file():
        return [folder]
    found = sorted(p for p in folder.glob("*") if p.suffix.lower() in IMAGE_SUFFIXES)
    if not found:
        raise SourceError(f"{folder} holds no images ({', '.join(IMAGE_SUFFIXES)})")
    return found


class PipeSource:
    """Raw side-by-side frames (bgr24) from a pipe, as ffmpeg or gst-launch write them.

    A thread of its own keeps the newest frame, so that a slow reader never holds up the capture.

    Args:
        stream: opened for reading bytes and not read from yet: standard input, or a named pipe.
        width, height: of the whole side-by-side frame, in pixels.

    Raises:
        SourceError: where such a frame has no two halves.
    """

    taken_ns = 0, 0

    def __init__(self, stream: BinaryIO, width: int, height: int) -> None:
        _require_halves(width)
        self._stream, self._shape = stream, (height, width, 3)
        self._newest: bytes | None = None
        self._ended = ""
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._fill, daemon=True, name="pipe")
        self._thread.start()

    def read(self) -> Pair | None:
        """The newest whole frame, each only once.

        Raises:
            BrokenOffError: where whoever wrote into the pipe has ended.
        """
        with self._lock:
            data, self._newest = self._newest, None
            ended = self._ended
        if data is None and ended:
            raise BrokenOffError(ended)
        return None if data is None else halves(np.frombuffer(data, np.uint8).reshape(self._shape))

    def close(self) -> None:
        """Close the pipe."""
        self._closed.set()
        self._thread.join()
        self._stream.close()

    def _fill(self) -> None:
        # past Python's buffer, whose reads only end when they are full, and which then could not be closed
        descriptor, size = self._stream.fileno(), int(np.prod(self._shape))
        frame, filled = bytearray(size), 0
        while not self._closed.is_set():
            if not select.select([descriptor], [], [], LOOK_S)[0]:
                continue
            count = os.readv(descriptor, [memoryview(frame)[filled:]])
            if count == 0:
                self._note_end(filled, size)
                return
            filled += count
            if filled == size:
                with self._lock:
                    self._newest = bytes(frame)
                filled = 0

    def _note_end(self, left_over: int, size: int) -> None:
        """No more will come; what is left over tells a wrong frame size from an orderly end."""
        cut = f" in the midst of a frame ({left_over} of {size} bytes; check width and height)" if left_over else ""
        with self._lock:
            self._ended = f"the pipe has ended{cut}; start what writes into it again, then the camera"


def _require_halves(width: int) -> None:
    if width % 2:
        raise SourceError(f"a side-by-side frame of {width} pixels has no two equal halves")


def halves(image: np.ndarray) -> Pair:
    """The left and the right half of a side-by-side frame.

    Raises:
        SourceError: where its width is odd.
    """
    width = image.shape[1]
    _require_halves(width)
    return np.ascontiguousarray(image[:, : width // 2]), np.ascontiguousarray(image[:, width // 2 :])
