"""What the desk says: lines for every page, refusals for one, and what is written down for good."""

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from agents.operator.screen import Screen

LINES_KEPT = 12
_log = logging.getLogger("suturegrasp.operator")


class Voice:
    """Says things, and notes that something has changed.

    Fields:
        lines: the newest, for every page.
        changed: set where pages are to be told anew.
    """

    def __init__(self, screens: dict[str, Screen], audit: Callable[..., None]) -> None:
        self._screens, self._audit = screens, audit
        self.lines: list[str] = []
        self.changed = asyncio.Event()

    def say(self, line: str) -> None:
        """To every page."""
        self.lines = [*self.lines, line][-LINES_KEPT:]
        self.changed.set()

    def refuse(self, screen: str, text: str) -> None:
        """To one page."""
        if screen in self._screens:
            self._screens[screen].say({"kind": "refused", "text": text})

    def written(self, screen: str, what: str, **told: Any) -> bool:
        """Whether it could be written down; where not, nothing but stopping follows from it."""
        try:
            self._audit(what, screen=screen, **told)
        except RuntimeError as error:
            _log.error("%s", error)
            self.refuse(screen, str(error))
            return False
        return True

    def failed(self, error: BaseException) -> None:
        """Something that should not happen."""
        _log.error("a command of the page failed", exc_info=error)
        self.say(f"Something failed: {error}")
