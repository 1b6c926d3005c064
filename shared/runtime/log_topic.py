"""Log records as a topic."""

import contextlib
import logging
from collections.abc import Callable

from schemas.messages import LogLevel, LogRecord

LEVELS = ((logging.ERROR, LogLevel.ERROR), (logging.WARNING, LogLevel.WARNING), (logging.INFO, LogLevel.INFO))


class LogTopic(logging.Handler):
    """Hands each record of a logger over as a message."""

    def __init__(self, agent: str, instance: str, publish: Callable[[LogRecord], object]) -> None:
        super().__init__()
        self._agent, self._instance, self._publish = agent, instance, publish

    def emit(self, record: logging.LogRecord) -> None:
        """Publish one record; one that cannot be published is only seen on the console."""
        level = next((ours for theirs, ours in LEVELS if record.levelno >= theirs), LogLevel.DEBUG)
        # names of files may hold bytes that are no text, and messages hold text alone
        text = self.format(record).encode(errors="replace").decode()
        with contextlib.suppress(Exception):
            # whoever says something goes on, whether or not it travels: an arm may have to be held next
            self._publish(LogRecord(round(record.created * 1e9), self._agent, self._instance, level, text))

    def await_quiet(self) -> None:
        """Return once no record is being published any more; for when the handler has been removed."""
        self.acquire()
        self.release()
