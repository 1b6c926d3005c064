"""Processes that share the threads of an evaluation among them, and tell of each trial as it ends."""

import multiprocessing
import queue
from collections.abc import Generator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from agents.cli.evaluate.trials import tried_on
from agents.evaluation.came import Came
from agents.evaluation.protocol import Laid, Protocol, Trial
from shared.worker_pool import worker_pool

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
    told: Any = multiprocessing.get_context("spawn").Queue()
    # what they are at when it ends is tried again
    with worker_pool(min(jobs, len(work)), _ready, (told,)) as pool:
        try:
            futures = [pool.submit(_work, protocol, laid, trials, folder) for laid, trials in work]
            yield from _gathered(futures, told)
        except BrokenProcessPool as error:
            raise WorkError(
                "a worker ended before its trials were done, as one does for want of memory; "
                "give fewer --jobs, and the same command goes on where this one was"
            ) from error


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
    global _told  # noqa: PLW0603 - a worker has no other place for what its pool hands it
    _told = told


def _work(protocol: Protocol, laid: Laid, trials: list[Trial], folder: Path) -> None:
    for came in tried_on(protocol, laid, trials, folder):
        _told.put(came.model_dump_json())
