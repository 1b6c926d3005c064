"""A batch is shared among as many processes as asked for, and goes on where it was left; most needs the extra `sim`."""

import dataclasses
import importlib.util
import multiprocessing
import os
import signal

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.scene.path_traced.batch import Job, make, make_all, outstanding
from shared.scene.path_traced.eyes import rectified_rig
from shared.scene.path_traced.recipe import Recipe
from shared.scene.render import SceneError

traces = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="path tracing needs the extra sim: make sim"
)
TINY = endoscope(160, 90)
FAR_APART = rectified_rig(dataclasses.replace(TINY.near_enough, baseline=200.0))


def jobs(folder, count):
    return [Job(folder, f"one_{seed}", Recipe("none", "paper", seed), TINY, 1) for seed in range(1, 1 + count)]


@traces
def test_pairs_are_made_in_as_many_processes_as_asked_for_and_are_those_that_one_makes(tmp_path):
    alone, shared = jobs(tmp_path / "alone", 1), jobs(tmp_path / "shared", 2)
    made = make_all(shared, 2)
    first = next(made)
    assert len(multiprocessing.active_children()) == 2
    assert {first.name, *(one.name for one in made)} == {job.name for job in shared}
    assert multiprocessing.active_children() == []
    make(alone[0])
    for name in ("one_1_left.png", "one_1_right.png", "one_1.npy"):
        assert (tmp_path / "alone" / name).read_bytes() == (tmp_path / "shared" / name).read_bytes()


@traces
def test_a_worker_that_dies_is_said_and_what_was_made_stays(tmp_path):
    batch = jobs(tmp_path, 5)
    made = make_all(batch, 2)
    done = {next(made).name}
    for worker in multiprocessing.active_children():
        os.kill(worker.pid or 0, signal.SIGKILL)
    with pytest.raises(SceneError, match="give fewer --workers, and the same command goes on where this one was"):
        done |= {one.name for one in made}
    left = {job.name for job in outstanding(batch)}
    assert done.isdisjoint(left)
    assert left


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


def test_a_seed_that_finds_no_place_is_told_and_the_rest_goes_on(tmp_path):
    (hopeless,) = jobs(tmp_path, 1)
    hopeless = dataclasses.replace(hopeless, recipe=Recipe("easy", "paper", 1), rig=FAR_APART)
    told = list(make_all([hopeless, hopeless], 1))
    assert len(told) == 2
    assert "no easy scene of seed 1 fits into the images of this camera" in told[0].problem
    assert not list(tmp_path.iterdir())
