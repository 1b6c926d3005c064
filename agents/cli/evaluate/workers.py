"""Work that several processes share, which tell of each result as it is there."""

import multiprocessing
import queue
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from shared.terminal import UsageError
from shared.worker_pool import worker_pool

LOOK_S = 0.2
Result = TypeVar("Result")


class WorkError(UsageError):
    """A worker that ended before its work was done."""


def shared_out(do: Callable[..., Iterable[Result]], work: Sequence[tuple[Any, ...]], jobs: int) -> Generator[Result]:
    """What a module's function gives for each of the pieces of work, in so many processes, as each result is there.

    Raises:
        WorkError: where a worker dies; and what the function raises.
    """
    if jobs == 1 or len(work) < 2:
        for piece in work:
            yield from do(*piece)
        return
    told: Any = multiprocessing.get_context("spawn").Queue()
    # what they are at when it ends is tried again
    with worker_pool(min(jobs, len(work)), _ready, (told,)) as pool:
        try:
            futures = [pool.submit(_work, do, piece) for piece in work]
            yield from _gathered(futures, told)
        except BrokenProcessPool as error:
            raise WorkError(
                "a worker ended before its trials were done, as one does for want of memory; "
                "give fewer --jobs, and the same command goes on where this one was"
            ) from error


def _gathered(futures: list[Future[None]], told: Any) -> Generator[Any]:
    """What the workers tell, until all have ended."""
    while True:
        ended = all(future.done() for future in futures)
        try:
            while True:
                yield told.get(timeout=LOOK_S)
        except queue.Empty:
            pass
        for future in futures:
            if future.done():
                future.result()
        if ended:
            return


_told: Any = None


def _ready(told: Any) -> None:
    global _told  # noqa: PLW0603 - a worker has no other place for what its pool hands it
    _told = told


def _work(do: Callable[..., Iterable[Any]], piece: tuple[Any, ...]) -> None:
    for result in do(*piece):
        _told.put(result)
