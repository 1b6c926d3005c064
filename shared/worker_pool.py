"""Processes that share work among them, and do not outlive whoever started them."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any


@contextmanager
def worker_pool(
    count: int, ready: Callable[..., object] | None = None, given: tuple[Any, ...] = ()
) -> Generator[ProcessPoolExecutor]:
    """So many fresh processes for as long as they are needed; what they are at when that ends is left undone.

    Ctrl-C is for whoever started them alone. Where that is killed, they end by themselves.

    Args:
        ready: what each process does first, with what it is given.
    """
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=_begin, initargs=(ready, given))
    try:
        yield pool
    finally:
        for process in list((pool._processes or {}).values()):  # pyright: ignore[reportPrivateUsage]
            process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


def _begin(ready: Callable[..., object] | None, given: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if ready is not None:
        ready(*given)


def _end_with_parent() -> None:
    """A worker holds both ends of the pipe that work comes through, so that it would wait there for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
