"""What this process uses of its machine."""

import os
from pathlib import Path

from shared.clock import monotonic_s, processor_s

STATM = Path("/proc/self/statm")


def resident_bytes() -> int:
    """The memory of this process that is in the machine's now; 0 where the system does not tell."""
    try:
        return int(STATM.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


class ProcessorShare:
    """How much of one core this process used since it was last asked."""

    def __init__(self) -> None:
        self._at_s, self._used_s = monotonic_s(), processor_s()

    def since_last(self) -> float:
        """The share since the last call, or since the beginning; above 1 where several cores were busy."""
        at_s, used_s = monotonic_s(), processor_s()
        elapsed_s, spent_s = at_s - self._at_s, used_s - self._used_s
        self._at_s, self._used_s = at_s, used_s
        return spent_s / elapsed_s if elapsed_s > 0 else 0.0
