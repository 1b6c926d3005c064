"""Memory that a process frees is kept for its next message.

glibc gives large blocks back to the system at once, and takes them again page by page: for images at 30 Hz that costs
more than whatever is done with them. Elsewhere than on glibc this does nothing.
"""

import contextlib
import ctypes

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""glibc's names for its parameters (malloc.h)."""
KEPT_BYTES = 1 << 28
"""Free memory at the end of the heap from which on it is given back."""
LARGEST_BLOCK_BYTES = 1 << 25
"""Larger ones still come from the system one by one; glibc takes no greater number."""


def keep_freed_memory() -> bool:
    """Have this process keep what it frees; whether the system's C library can."""
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        return bool(mallopt(TRIM_THRESHOLD, KEPT_BYTES) and mallopt(MMAP_THRESHOLD, LARGEST_BLOCK_BYTES))
    return False
