"""Pictures on their way to the pages: the newest frame, with what is drawn over it in the same message."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any

from agents.operator.field_state import FieldState
from agents.operator.load import LoadMonitor
from agents.operator.pictures import DRAWN_FULL_S, LEVELS, as_it_came, due, encoded
from agents.operator.screen import Screen
from agents.operator.wire import Shown, joined
from schemas.messages import StereoFrame
from schemas.topics import CALIBRATION, FRAMES, Topic
from shared.clock import monotonic_s, now_ns
from shared.images import ImageDataError

LOOK_S = 1.0
Aside = Callable[[Callable[[], Any]], Awaitable[Any]]


class Showing:
    """Sends each page the newest picture once it has shown the last; fewer where this host has no time to spare."""

    def __init__(
        self,
        field: FieldState,
        screens: dict[str, Screen],
        aside: Aside,
        controls: Callable[[str], bool],
        load: LoadMonitor,
    ) -> None:
        self._field, self._screens, self._aside, self._controls = field, screens, aside, controls
        self._load, self._frame_came = load, asyncio.Event()
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
            self._load.look(monotonic_s())

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
            if screen.ready and due(self._controls(screen.name), now_s - screen.sent_s, self._load.full)
        ]

    async def _show(self, frame: StereoFrame, waiting: list[Screen]) -> None:
        image, resample = frame.left, self._field.resample
        levels = {screen.pace.level for screen in waiting}

        def prepare() -> dict[int, bytes]:
            return {level: encoded(image, LEVELS[level], resample) for level in levels}

        with contextlib.suppress(ImageDataError):
            as_they_came = all(as_it_came(image, LEVELS[level], resample) for level in levels)
            jpegs = prepare() if as_they_came else await self._aside(prepare)
            self._field.take_thread(DRAWN_FULL_S if self._load.full else 0.0)
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
