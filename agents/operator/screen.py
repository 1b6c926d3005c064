"""One connected page: what waits to be sent to it, and what it has been shown."""

import asyncio
import struct
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

from agents.operator.pictures import Pace
from agents.operator.wire import Look, compact

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
