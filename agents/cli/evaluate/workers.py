"""Processes that share the threads of an evaluation among them, and tell of each trial as it ends."""

import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Generator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from agents.cli.evaluate.trials import tried_on
from agents.evaluation.came import Came
from agents.evaluation.protocol import Laid, Protocol, Trial

LOOK_S = 0.2
Work = list[tuple[Laid, list[Trial]]]


class WorkError(RuntimeError):
    """A worker that ended before its work was done."""


def all_tried(protocol: Protocol, work: Work, jobs: int, folder: Path) -> Generator[Came]:
    """What comes of all trials, in so many processes, as each ends.

    Raises:
        SceneError: where a thread cannot be laid.
        WorkError: where a worker dies.
    """
    if jobs == 1 or len(work) < 2:
        for laid, trials in work:
            yield from tried_on(protocol, laid, trials, folder)
        return
    context = multiprocessing.get_context("spawn")
    told: Any = context.Queue()
    pool = ProcessPoolExecutor(min(jobs, len(work)), context, initializer=_ready, initargs=(told,))
    try:
        futures = [pool.submit(_work, protocol, laid, trials, folder) for laid, trials in work]
        yield from _gathered(futures, told)
    except BrokenProcessPool as error:
        raise WorkError(
            "a worker ended before its trials were done, as one does for want of memory; "
            "give fewer --jobs, and the same command goes on where this one was"
        ) from error
    finally:
        for process in list((pool._processes or {}).values()):  # pyright: ignore[reportPrivateUsage]
            # what they are at is tried again
            process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


def _gathered(futures: list[Future[None]], told: Any) -> Generator[Came]:
    """What the workers tell, until all have ended."""
    while True:
        ended = all(future.done() for future in futures)
        try:
            while True:
                yield Came.model_validate_json(told.get(timeout=LOOK_S))
        except queue.Empty:
            pass
        for future in futures:
            if future.done():
                future.result()
        if ended:
            return


_told: Any = None


def _ready(told: Any) -> None:
    """Prepare a worker: Ctrl-C is the parent's, which ends it."""
    global _told  # noqa: PLW0603 - a worker has no other place for what its pool hands it
    _told = told
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Whoever has killed the evaluation wants its workers to end too, and nobody hears what they still find."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(protocol: Protocol, laid: Laid, trials: list[Trial], folder: Path) -> None:
    for came in tried_on(protocol, laid, trials, folder):
        _told.put(came.model_dump_json())
