"""Pictures for pages: the newest alone, each encoded once for all that take it at one level, as fast as each can.

A page says when a picture is on its screen, and only then is sent the next one. How long that takes tells its link and
its processor alike, and chooses the level: the camera's own bytes where they can be shown as they are, or smaller and
coarser ones.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from schemas.messages import Image, ImageEncoding
from shared.images import decode_image

Resample = Callable[[UInt8[np.ndarray, "h w *c"]], UInt8[np.ndarray, "h w *c"]]


@dataclass(frozen=True)
class Level:
    """How a picture is sent; `scale` of its sides."""

    scale: float
    quality: int


LEVELS = (Level(1.0, 90), Level(1.0, 70), Level(0.75, 60), Level(0.5, 55), Level(0.35, 45), Level(0.25, 35))
SLOW_MS, FAST_MS = 90.0, 40.0
"""From sent to shown: beyond the first a coarser level is taken, below the second a finer one after a while."""
MEMORY = 0.75
JUDGED_AFTER = 8
"""Pictures before a level is judged."""
HELPS = 0.85
"""A coarser level helps where its pictures take less than this share of the time."""
PATIENCE = 30
"""Pictures that must go well in a row before a finer level is tried, and after which a coarser one is tried again where
it did not help; doubled each time."""
MOST_PATIENCE = 960
WIDEST_PX = 1600
"""More is not seen on a screen, and only costs."""
WATCHING_S, WATCHING_FULL_S = 0.055, 0.19
"""Between the pictures of a page that only watches: every second one of a camera at 30 Hz, and five a second where this
host has no time to spare. Each picture costs its browser, and the machine that this runs on, as much as it costs the
page that controls, which has all of them: its pictures are what a hand goes by."""
DRAWN_FULL_S = 0.095
"""Between two drawings of the thread where this host has no time to spare; else each one that comes is drawn."""


def due(controls: bool, since_s: float, full: bool) -> bool:
    """Whether a page that is ready is sent the next picture, so long after the last; `full`: no time to spare here."""
    return controls or since_s >= (WATCHING_FULL_S if full else WATCHING_S)


def as_it_came(image: Image, level: Level, resample: Resample | None) -> bool:
    """Whether a picture goes out at a level with the camera's own bytes."""
    finest = level is LEVELS[0] and image.width <= WIDEST_PX
    return finest and resample is None and image.encoding is ImageEncoding.JPEG


def encoded(image: Image, level: Level, resample: Resample | None) -> bytes:
    """A picture as JPEG at a level; the camera's own bytes at the finest one, where they are a rectified JPEG.

    Raises:
        ImageDataError: where the image is none.
    """
    if as_it_came(image, level, resample):
        return image.data
    scale = level.scale * min(1.0, WIDEST_PX / image.width)
    pixels = decode_image(image)
    if resample is not None:
        pixels = resample(pixels)
    if scale < 1.0:
        size = (max(1, round(image.width * scale)), max(1, round(image.height * scale)))
        # the mean of all pixels is slow but where whole ones go together, and little is lost above the half
        kind = cv2.INTER_LINEAR if scale > 0.5 else cv2.INTER_AREA
        pixels = cv2.resize(pixels, size, interpolation=kind)
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, level.quality])[1].tobytes()


@dataclass
class Pace:
    """One page's level, from how long its pictures took.

    A coarser level is kept where it helps: on a busy machine pictures are slow whatever their size.

    Fields:
        shown_ms: recent mean of the time from sent to shown.
    """

    level: int = 0
    shown_ms: float = 0.0
    _count: int = 0
    _well: int = 0
    _before_ms: float | None = None
    _patience: int = PATIENCE
    _rest: int = 0

    def took(self, ms: float) -> None:
        """Note how long a picture took; it may change the level."""
        self.shown_ms = ms if self._count == 0 else MEMORY * self.shown_ms + (1 - MEMORY) * ms
        self._count, self._rest = self._count + 1, max(0, self._rest - 1)
        self._well = self._well + 1 if self.shown_ms < FAST_MS else 0
        if self._count < JUDGED_AFTER:
            return
        if self._before_ms is not None and self.shown_ms > HELPS * self._before_ms:
            # not its size is what costs
            self._rest, self._patience = self._patience, min(2 * self._patience, MOST_PATIENCE)
            self._move(-1, None)
        elif self.shown_ms > SLOW_MS and self.level < len(LEVELS) - 1 and not self._rest:
            self._move(1, self.shown_ms)
        elif self._well >= self._patience and self.level > 0:
            self._move(-1, None)
        else:
            self._before_ms = None

    def _move(self, by: int, before_ms: float | None) -> None:
        self.level, self._count, self._well, self._before_ms = self.level + by, 0, 0, before_ms
