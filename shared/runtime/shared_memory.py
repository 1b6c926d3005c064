"""Large payloads, written where other processes of this machine can read them.

Zenoh moves what is large through shared memory by itself, and copies it there. What is written there in the first
place is copied once instead of twice. Whoever shares no memory with this process gets the same bytes by network.
"""

import functools
from typing import Any

import zenoh
from zenoh import shm

POOL_BYTES = 1 << 26
"""Of address space; a page is used once something has been written to it. Room for 40 frames of 1.5 MB."""


def joined(parts: list[Any]) -> Any:
    """The parts as one payload: in shared memory, or as bytes where that is full or not to be had."""
    buffer = _allocated(sum(map(len, parts)))
    if buffer is None:
        return b"".join(parts)
    at = 0
    for part in parts:
        buffer[at : at + len(part)] = part if isinstance(part, bytes) else bytes(part)
        at += len(part)
    return buffer


def _allocated(size: int) -> Any:
    pool = _pool()
    try:
        # of what consumers have not let go of, nothing is taken back: then it is full
        return None if pool is None else pool.alloc(size, policy=shm.GarbageCollect())
    except zenoh.ZError:
        return None


@functools.cache
def _pool() -> Any:
    try:
        return shm.ShmProvider.default_backend(POOL_BYTES)
    except zenoh.ZError:
        return None
