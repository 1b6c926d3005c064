"""Many pairs in parallel processes; what lies there already is left as it is, so that a batch can be taken up again."""

from collections.abc import Generator
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shared.clock import processor_s
from shared.rendering.path_traced.eyes import Rig
from shared.rendering.path_traced.pair import TracedPair, is_written, traced_pair, write_traced
from shared.rendering.path_traced.recipe import Recipe, UnarrangedError
from shared.rendering.render import SceneError
from shared.worker_pool import worker_pool


@dataclass(frozen=True)
class Job:
    """A pair to be made: where, under which name, of which recipe, seen by which camera, with how many samples."""

    folder: Path
    name: str
    recipe: Recipe
    rig: Rig
    samples: int


MOST_TURNS = 3
"""In which a pair is tried by itself."""
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


def make(job: Job, turn: int = 0) -> Done:
    """Make one pair, or say why it cannot be arranged.

    Args:
        turn: of tracing it (`traced_pair`).

    Raises:
        SceneError: where it cannot be traced or written.
    """
    begun = processor_s()
    try:
        pair = traced_pair(job.recipe, job.rig, job.samples, turn)
    except UnarrangedError as error:
        return Done(job.name, float("nan"), processor_s() - begun, str(error))
    write_traced(job.folder, job.name, pair)
    return Done(job.name, mean_offset(pair), processor_s() - begun)


def make_all(jobs: list[Job], workers: int) -> Generator[Done]:
    """Make pairs in so many processes, and tell of each as it is done.

    Where a process ends before its pair is made, the pair is made by itself, with other rays if need be: in one scene
    of some hundreds Mitsuba crashes at a ray along the thread.

    Raises:
        SceneError: as `make`, at the first that fails, or where a pair ends one process after another; what was made
            stays.
    """
    left = dict(enumerate(jobs))
    while left:
        with worker_pool(min(workers, len(left))) as pool, suppress(BrokenProcessPool):
            begun = {pool.submit(make, job): number for number, job in left.items()}
            for future in as_completed(begun):
                done = future.result()
                del left[begun[future]]
                yield done
        yield from _one_by_one(left)


def _one_by_one(left: dict[int, Job]) -> Generator[Done]:
    """Make pairs by themselves, up to the one that ended a process; what is made is taken out."""
    for number, job in list(left.items()):
        done, turn = _alone(job)
        del left[number]
        yield done
        if turn > 0:
            return


def _alone(job: Job) -> tuple[Done, int]:
    """Make a pair in a process of its own, and in how many turns beside the first."""
    for turn in range(MOST_TURNS):
        with worker_pool(1) as pool, suppress(BrokenProcessPool):
            return pool.submit(make, job, turn).result(), turn
    raise SceneError(
        f"{job.name} ended {MOST_TURNS} processes one after another before it was made, as for want of memory; "
        "free some, or leave its seed out, and the same command goes on where this one was"
    )


def mean_offset(pair: TracedPair) -> float:
    """Mean distance between masks and projected truth in both images, in px."""
    every = np.abs(np.concatenate(pair.offsets_px))
    return float(every.mean()) if len(every) else float("nan")
