"""Many pairs in parallel processes; what lies there already is left as it is, so that a batch can be taken up again."""

from collections.abc import Generator
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shared.clock import processor_s
from shared.scene.path_traced.engine import engine
from shared.scene.path_traced.eyes import Rig
from shared.scene.path_traced.pair import TracedPair, traced_pair
from shared.scene.path_traced.pair_files import is_written, write_traced
from shared.scene.path_traced.recipe import Recipe, UnarrangedError
from shared.scene.render import SceneError
from shared.worker_pool import worker_pool


@dataclass(frozen=True)
class Job:
    """A pair to be made: where, under which name, of which recipe, seen by which camera, with how many samples."""

    folder: Path
    name: str
    recipe: Recipe
    rig: Rig
    samples: int


LARGEST_OFFSET_PX = 0.05
"""Between masks and truth, on average over a pair: more is no truth to measure others by."""


@dataclass(frozen=True)
class Done:
    """A pair that was made: how far its masks lie from its truth (NaN without thread), and processor seconds.

    Fields:
        problem: why there is none, empty where there is.
    """

    name: str
    mask_offset_px: float
    processor_s: float
    problem: str = ""


def outstanding(jobs: list[Job]) -> list[Job]:
    """Those that do not lie there yet.

    Raises:
        SceneError: where another pair lies there under the name of one.
    """
    return [job for job in jobs if not is_written(job.folder, job.name, job.recipe, job.rig, job.samples)]


def make(job: Job) -> Done:
    """Make one pair, or say why it cannot be arranged.

    Raises:
        SceneError: where it cannot be traced or written.
    """
    begun = processor_s()
    try:
        pair = traced_pair(job.recipe, job.rig, job.samples)
    except UnarrangedError as error:
        return Done(job.name, float("nan"), processor_s() - begun, str(error))
    write_traced(job.folder, job.name, pair)
    return Done(job.name, mean_offset(pair), processor_s() - begun)


def make_all(jobs: list[Job], workers: int) -> Generator[Done]:
    """Make pairs in so many processes, and tell of each as it is done.

    Raises:
        SceneError: as `make`, at the first that fails, or where a worker dies; what was made stays.
    """
    if workers == 1 or not jobs:
        yield from map(make, jobs)
        return
    with worker_pool(min(workers, len(jobs)), engine) as pool:
        try:
            for future in as_completed([pool.submit(make, job) for job in jobs]):
                yield future.result()
        except BrokenProcessPool as error:
            raise SceneError(
                "a worker ended before its pair was made, as one does for want of memory; "
                "give fewer --workers, and the same command goes on where this one was"
            ) from error


def mean_offset(pair: TracedPair) -> float:
    """Mean distance between masks and projected truth in both images, in px."""
    every = np.abs(np.concatenate(pair.offsets_px))
    return float(every.mean()) if len(every) else float("nan")
