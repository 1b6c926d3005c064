"""Whether this host has time to spare for pages: where it has none, showing takes it from the pipeline."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

STAT = Path("/proc/stat")
FULL, ROOM = 0.15, 0.3
"""Share of all processors' time that nobody takes: below the first there is none to spare, above the second there is.
They lie apart since stepping back makes room by itself."""
CALM_S = 20.0
"""There must be room for so long before more is shown again: a rate that comes and goes is worse than a low one."""
COUNTED = 8
"""Of the columns of /proc/stat; what follows is counted in the first ones already."""
IDLE = slice(3, 5)


@dataclass(frozen=True)
class Processors:
    """Time of all processors since the host was started, in any unit: what nobody took, and all of it."""

    idle: int
    total: int


def processors() -> Processors | None:
    """Of this host; None where the system does not tell."""
    try:
        name, *columns = STAT.read_text(encoding="ascii").splitlines()[0].split()
        ticks = [int(column) for column in columns[:COUNTED]]
    except (OSError, ValueError, IndexError):
        return None
    return Processors(sum(ticks[IDLE]), sum(ticks)) if name == "cpu" else None


class LoadMonitor:
    """Looks from time to time.

    Fields:
        full: there is no time to spare; not so where nobody knows.
    """

    def __init__(self, read: Callable[[], Processors | None] = processors) -> None:
        self._read, self._before = read, read()
        self._calm_s = float("-inf")
        self.full = False

    def look(self, now_s: float) -> None:
        """Compare with the last look, which was about a second ago."""
        before, self._before = self._before, self._read()
        if before is None or self._before is None or self._before.total <= before.total:
            return
        idle = (self._before.idle - before.idle) / (self._before.total - before.total)
        if idle < ROOM:
            # from here on it has to be calm
            self._calm_s = now_s
        if idle < FULL:
            self.full = True
        elif now_s - self._calm_s >= CALM_S:
            self.full = False
