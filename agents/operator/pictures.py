"""Pictures for pages: the newest alone, each encoded once for all that take it at one level, as fast as each can.

A page says when a picture is on its screen, and only then is sent the next one. How long that takes tells its link and
its processor alike, and chooses the level: the camera's own bytes where they can be shown as they are, or smaller and
coarser ones.

One connected page: what waits to be sent to it, and what it has been shown.

Pictures on their way to the pages: the newest frame, with what is drawn over it in the same message.
"""

import asyncio
import contextlib
import struct
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from agents.operator.heard import FieldSeen
from agents.operator.spare import Spare
from agents.operator.wire import Look, Shown, compact, joined
from schemas.messages import Image, ImageEncoding, StereoFrame
from schemas.topics import CALIBRATION, FRAMES, Topic
from shared.clock import monotonic_s, now_ns
from shared.images import ImageDataError, decode_image

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


MOST_WAITING = 400
"""Messages; a page that lets so many wait has not read for long, and will be found to be gone."""
LENGTH = struct.Struct("<I")


@dataclass
class Screen:
    """What is sent goes out in order, challenges first and one picture at a time behind all that is small.

    Fields:
        ready: the last picture is on its screen.
        thread_frame, surface_frame, observed_frame: of what it was sent last.
        behind_ms: capture to screen of the last picture, by this host's clock.
    """

    name: str
    send_text: Callable[[str], Awaitable[None]]
    send_bytes: Callable[[bytes], Awaitable[None]]
    pace: Pace = field(default_factory=Pace)
    look: Look = field(default_factory=lambda: Look(observations=False, space=False))
    ready: bool = True
    frame: int = -1
    sent_s: float = 0.0
    capture_ms: float = 0.0
    behind_ms: float | None = None
    thread_frame: int = -1
    surface_frame: int = -1
    observed_frame: int = -1
    plans: dict[str, str] = field(default_factory=dict[str, str])
    _challenge: tuple[str, str] | None = None
    _state: str = ""
    _waiting: deque[str] = field(default_factory=lambda: deque[str](maxlen=MOST_WAITING))
    _picture: bytes | None = None
    _woken: asyncio.Event = field(default_factory=asyncio.Event)

    def say(self, document: dict[str, Any]) -> None:
        """Have a message sent."""
        self._waiting.append(compact(document))
        self._woken.set()

    def ask(self, challenge: str, document: dict[str, Any]) -> str:
        """Have a challenge sent before all else, in place of one that still waits; that one, or nothing."""
        replaced, self._challenge = self._challenge, (challenge, compact(document))
        self._woken.set()
        return "" if replaced is None else replaced[0]

    def tell_state(self, state: str) -> None:
        """Have the state sent, in place of one that still waits."""
        self._state = state
        self._woken.set()

    def show(self, header: str, jpeg: bytes) -> None:
        """Have a picture sent, once what is small has gone; its header is JSON."""
        head = header.encode()
        self._picture, self.ready = LENGTH.pack(len(head)) + head + jpeg, False
        self._woken.set()

    async def send_all(self) -> None:
        """Send until cancelled."""
        while True:
            await self._woken.wait()
            self._woken.clear()
            while self._challenge or self._waiting or self._state or self._picture is not None:
                if self._challenge is not None:
                    (_, text), self._challenge = self._challenge, None
                    await self.send_text(text)
                elif self._waiting:
                    await self.send_text(self._waiting.popleft())
                elif self._state:
                    state, self._state = self._state, ""
                    await self.send_text(state)
                elif self._picture is not None:
                    picture, self._picture = self._picture, None
                    await self.send_bytes(picture)


LOOK_S = 1.0
Aside = Callable[[Callable[[], Any]], Awaitable[Any]]


class Showing:
    """Sends each page the newest picture once it has shown the last; fewer where this host has no time to spare."""

    def __init__(
        self,
        field: FieldSeen,
        screens: dict[str, Screen],
        aside: Aside,
        controls: Callable[[str], bool],
        spare: Spare,
    ) -> None:
        self._field, self._screens, self._aside, self._controls = field, screens, aside, controls
        self._spare, self._frame_came = spare, asyncio.Event()
        self._calibrated = True

    def woken(self, topic: Topic) -> None:
        """A message of a topic has come."""
        if topic is FRAMES:
            self._frame_came.set()
        elif topic is CALIBRATION:
            self._calibrated = True

    def ready(self) -> None:
        """A page can take a picture."""
        self._frame_came.set()

    def shown(self, screen: Screen, said: Shown) -> None:
        """A picture is on a page's screen."""
        if said.frame != screen.frame or screen.ready:
            return
        screen.pace.took(1e3 * (monotonic_s() - screen.sent_s))
        screen.behind_ms = now_ns() * 1e-6 - screen.capture_ms
        screen.ready = True
        self.ready()

    async def run(self) -> None:
        """Until cancelled."""
        await asyncio.gather(self._show_frames(), self._look_at_host())

    async def _look_at_host(self) -> None:
        while True:
            await asyncio.sleep(LOOK_S)
            self._spare.look(monotonic_s())

    async def _show_frames(self) -> None:
        while True:
            await self._frame_came.wait()
            self._frame_came.clear()
            if not self._waiting():
                continue
            if self._calibrated:
                self._calibrated = False
                await self._aside(self._field.take_calibration)
            frame = self._field.take_frame()
            waiting = self._waiting()
            if frame is not None and any(screen.frame != frame.stamp.sequence for screen in waiting):
                await self._show(frame, [s for s in waiting if s.frame != frame.stamp.sequence])

    def _waiting(self) -> list[Screen]:
        now_s = monotonic_s()
        return [
            screen
            for screen in self._screens.values()
            if screen.ready and due(self._controls(screen.name), now_s - screen.sent_s, self._spare.full)
        ]

    async def _show(self, frame: StereoFrame, waiting: list[Screen]) -> None:
        image, resample = frame.left, self._field.resample
        levels = {screen.pace.level for screen in waiting}

        def prepare() -> dict[int, bytes]:
            return {level: encoded(image, LEVELS[level], resample) for level in levels}

        with contextlib.suppress(ImageDataError):
            as_they_came = all(as_it_came(image, LEVELS[level], resample) for level in levels)
            jpegs = prepare() if as_they_came else await self._aside(prepare)
            self._field.take_thread(DRAWN_FULL_S if self._spare.full else 0.0)
            self._field.take_states()
            if any(screen.look.space for screen in waiting):
                self._field.take_surface()
            if any(screen.look.observations for screen in waiting):
                self._field.take_observations()
            for screen in waiting:
                # a page may have coarsened meanwhile, or be gone
                level = screen.pace.level if screen.pace.level in jpegs else min(jpegs)
                self._send(screen, frame, jpegs[level])

    def _send(self, screen: Screen, frame: StereoFrame, jpeg: bytes) -> None:
        stamp, field = frame.stamp, self._field
        header = {
            "frame": stamp.sequence,
            "capture_ms": stamp.capture_left_ns * 1e-6,
            "sent_ms": now_ns() * 1e-6,
            # numbers of a browser do not hold nanoseconds since 1970
            "echoes": {echo.arm: str(echo.challenge_ns) for echo in stamp.echoes},
            "width": frame.left.width,
            "height": frame.left.height,
        }
        parts = {"tools": field.tools()}
        thread_frame = -1 if field.thread is None else field.thread.frame
        if thread_frame != screen.thread_frame:
            parts["thread"] = "null" if field.thread is None else field.thread.told
            screen.thread_frame = thread_frame
        if screen.look.observations and field.observed and field.observed[0] != screen.observed_frame:
            screen.observed_frame, parts["observed"] = field.observed
        if screen.look.space and field.surface and field.surface[0] != screen.surface_frame:
            screen.surface_frame, parts["surface"] = field.surface
        screen.frame, screen.capture_ms, screen.sent_s = stamp.sequence, stamp.capture_left_ns * 1e-6, monotonic_s()
        screen.show(joined(header, parts), jpeg)
