"""Holds on their way: each goes out at once, and none waits for the answer to another."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from typing import Any

from schemas.messages import CommandAnswer, Hold, Outcome
from schemas.topics import HOLD
from shared.runtime.commands import new_header
from shared.runtime.connection import Connection

TRIED = 3
EVERY_S = 0.1
"""What one page says within so long of its last hold goes out as one more, at the end of it."""
MOST_AWAITED = 1000
"""More holds of one arm than all pages can say while the first is still waited for; each waits in a thread."""


class Holds:
    """Has arms hold; where no answer comes a hold is said again, unless a newer one was said meanwhile."""

    def __init__(self, connection: Connection, sender: str) -> None:
        self._connection, self._sender = connection, sender
        self._threads: dict[str, ThreadPoolExecutor] = {}
        self._newest: dict[str, int] = {}
        self._numbers = count()

    def say(self, arm: str) -> "asyncio.Future[CommandAnswer]":
        """Send one now; its answer."""
        if arm not in self._threads:
            self._threads[arm] = ThreadPoolExecutor(MOST_AWAITED, f"holding {arm}")
        number = self._newest[arm] = next(self._numbers)
        return asyncio.get_running_loop().run_in_executor(self._threads[arm], self._said, arm, number)

    def close(self) -> None:
        """Wait for what was said."""
        for threads in self._threads.values():
            threads.shutdown(wait=True)

    def _said(self, arm: str, number: int) -> CommandAnswer:
        for turn in range(TRIED):
            answer = self._connection.command(HOLD, Hold(new_header(self._sender), arm), arm)
            if answer.outcome is not Outcome.UNKNOWN or turn == TRIED - 1 or self._newest[arm] != number:
                return answer
        raise AssertionError


class Coalescing:
    """Does what is asked for at once, and what is asked for again soon after once more at the end of EVERY_S."""

    def __init__(self, later: Callable[[float, Callable[[], None]], Any]) -> None:
        """`later` has something done after so many seconds."""
        self._later = later
        self._again: dict[str, Callable[[], None] | None] = {}

    def do(self, who: str, what: Callable[[], None]) -> None:
        """Do it for one of those who ask, each by itself."""
        if who in self._again:
            self._again[who] = what
            return
        self._again[who] = None
        self._later(EVERY_S, lambda: self._over(who))
        what()

    def _over(self, who: str) -> None:
        if (again := self._again.pop(who)) is not None:
            self.do(who, again)
