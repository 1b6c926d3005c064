"""A batch is shared among as many processes as asked for, and goes on where it was left; most needs the extra `sim`."""

import dataclasses
import importlib.util
import multiprocessing
import os
import signal

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.rendering.path_traced.batch import MOST_TURNS, Job, make, make_all, outstanding
from shared.rendering.path_traced.eyes import rectified_rig
from shared.rendering.path_traced.recipe import Recipe
from shared.rendering.render import SceneError

pytestmark = pytest.mark.renders
traces = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="path tracing needs the extra sim: make sim"
)
TINY = endoscope(160, 90)
FAR_APART = rectified_rig(dataclasses.replace(TINY.near_enough, baseline=800.0))


def jobs(folder, count):
    return [Job(folder, f"one_{seed}", Recipe("none", "paper", seed), TINY, 1) for seed in range(1, 1 + count)]


@traces
def test_a_batch_is_made_in_as_many_processes_as_asked_for_and_goes_on_where_they_died(tmp_path):
    alone, later, shared = ({job.name: job for job in jobs(tmp_path / at, 4)} for at in ("alone", "later", "shared"))
    made = make_all(list(shared.values()), 2)
    first = next(made).name
    workers = multiprocessing.active_children()
    assert len(workers) == 2
    for worker in workers:
        os.kill(worker.pid or 0, signal.SIGKILL)
    assert sorted([first, *(one.name for one in made)]) == sorted(shared)
    assert outstanding(list(shared.values())) == []
    assert multiprocessing.active_children() == []
    make(alone[first])
    make(later[first], turn=1)
    for name in (f"{first}_left.png", f"{first}_right.png", f"{first}.npy"):
        one, same, other = ((tmp_path / folder / name).read_bytes() for folder in ("alone", "shared", "later"))
        assert one == same
        # another turn has another grain and the same truth
        assert (one == other) == name.endswith(".npy")


class Deadly:
    """A camera that ends so many processes that it comes to, and is an ordinary one from then on."""

    def __init__(self, deaths, rig):
        self.deaths, self.rig = deaths, rig

    def __reduce__(self):
        return _survived, (self.deaths, self.rig)


def _survived(deaths, rig):
    """The camera; each process that dies of it takes one of the files that say how often it is deadly."""
    if left := sorted(deaths.iterdir()):
        left[0].unlink()
        os._exit(1)
    return rig


def deadly(folder, times):
    """Three jobs whose eyes share no field, which is told at once; the camera of the second is deadly."""
    deaths = folder / "deaths"
    deaths.mkdir()
    for number in range(times):
        (deaths / str(number)).touch()
    hopeless = [
        dataclasses.replace(job, recipe=Recipe("easy", "pad", seed), rig=FAR_APART)
        for seed, job in enumerate(jobs(folder, 3), start=1)
    ]
    return [hopeless[0], dataclasses.replace(hopeless[1], rig=Deadly(deaths, FAR_APART)), hopeless[2]]


def test_a_pair_that_ends_its_process_is_made_in_another_turn_and_the_others_too_but_not_for_ever(tmp_path):
    told = list(make_all(deadly(tmp_path, MOST_TURNS), 2))
    assert sorted(one.name for one in told) == ["one_1", "one_2", "one_3"]
    assert not list((tmp_path / "deaths").iterdir())
    assert {one.problem for one in told} == {"eyes 800 mm apart share no field within 1000 mm"}
    assert not list(tmp_path.glob("one_*"))
    (tmp_path / "deaths").rmdir()
    with pytest.raises(SceneError, match=r"one_2 ended 3 processes .*leave its seed out"):
        list(make_all(deadly(tmp_path, 9), 1))


@traces
def test_a_pair_whose_writing_was_cut_short_is_made_again(tmp_path, monkeypatch):
    (job,) = jobs(tmp_path, 1)

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(np, "save", full)
        with pytest.raises(SceneError, match=r"cannot write into .*No space left on device"):
            make(job)
    assert (tmp_path / "one_1_left.png").exists()
    assert outstanding([job]) == [job]
    make(job)
    assert outstanding([job]) == []
