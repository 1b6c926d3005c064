"""A batch is shared among as many processes as asked for, and goes on where it was left; most needs the extra `sim`."""

import dataclasses
import importlib.util
import multiprocessing
import os
import signal

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.scene.path_traced.batch import MOST_TURNS, Job, make, make_all, outstanding
from shared.scene.path_traced.eyes import rectified_rig
from shared.scene.path_traced.recipe import Recipe
from shared.scene.render import SceneError

pytestmark = pytest.mark.renders
traces = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="path tracing needs the extra sim: make sim"
)
TINY = endoscope(160, 90)
FAR_APART = rectified_rig(dataclasses.replace(TINY.near_enough, baseline=800.0))


def jobs(folder, count):
    return [Job(folder, f"one_{seed}", Recipe("none", "paper", seed), TINY, 1) for seed in range(1, 1 + count)]


@traces
def test_pairs_are_made_in_as_many_processes_as_asked_for_and_are_those_that_one_makes(tmp_path):
    (alone,), (later,), shared = (jobs(tmp_path / name, n) for name, n in (("alone", 1), ("later", 1), ("shared", 2)))
    made = make_all(shared, 2)
    first = next(made)
    assert len(multiprocessing.active_children()) == 2
    assert {first.name, *(one.name for one in made)} == {job.name for job in shared}
    assert multiprocessing.active_children() == []
    make(alone)
    make(later, turn=1)
    for name in ("one_1_left.png", "one_1_right.png", "one_1.npy"):
        one, same, other = ((tmp_path / folder / name).read_bytes() for folder in ("alone", "shared", "later"))
        assert one == same
        # another turn has another grain and the same truth
        assert (one == other) == name.endswith(".npy")


@traces
def test_a_batch_goes_on_where_its_workers_died(tmp_path):
    batch = jobs(tmp_path, 5)
    made = make_all(batch, 2)
    done = [next(made).name]
    for worker in multiprocessing.active_children():
        os.kill(worker.pid or 0, signal.SIGKILL)
    done += [one.name for one in made]
    assert sorted(done) == [job.name for job in batch]
    assert outstanding(batch) == []


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


def test_a_pair_that_ends_its_process_is_made_in_another_turn_and_the_others_too(tmp_path):
    told = list(make_all(deadly(tmp_path, MOST_TURNS), 2))
    assert sorted(one.name for one in told) == ["one_1", "one_2", "one_3"]
    assert not list((tmp_path / "deaths").iterdir())
    assert {one.problem for one in told} == {"eyes 800 mm apart share no field within 1000 mm"}
    assert not list(tmp_path.glob("one_*"))


def test_a_pair_that_ends_each_of_its_processes_is_named_with_what_to_do(tmp_path):
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
