"""`suturegrasp scenes render`: what is refused at once, and batches that are made as a user makes them."""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.cli.lab.scenes import EXIT_SOME, jobs_of, run, summary
from agents.cli.lab.scenes_options import Scenes
from shared.calibration import write_calibration
from shared.rigid_transforms import inverse
from shared.scene.path_traced.batch import Done
from shared.scene.render import SceneError
from tests.shared.scene.path_traced.test_eyes import calibration

TRACES = importlib.util.find_spec("mitsuba") is not None


def test_what_makes_no_batch_is_said_in_one_sentence(suturegrasp, tmp_path):
    (tmp_path / "file").write_text("")
    for arguments, said in (
        (("--count", "0"), "--count 0: give 1 or more"),
        (("--workers", "-1"), "--workers -1: give 1 or more"),
        (("--size", "20", "960"), "--size 20 960: give 64 to 3840 for either"),
        (("--config", "knot"), "config"),
        (("--output", tmp_path / "file"), "is a file; name a folder"),
    ):
        ended = suturegrasp("scenes", "render", "--output", tmp_path, *arguments)
        assert (ended.status, len(ended.err.splitlines())) == (2, 1)
        assert said in ended.err


def asked(**options):
    return Scenes("render", Path("DIR"), **options)


def test_every_seed_of_every_configuration_on_every_background_is_a_job_as_it_was_asked_for():
    options = {"extras": ("tools", "smoke"), "colour": "undyed", "samples": 7, "size": (320, 180)}
    jobs = jobs_of(asked(config=("several", "none"), background=("paper", "chicken"), seed=4, count=2, **options))
    assert sorted(job.name for job in jobs) == [
        f"{config}_{background}_{seed:04d}"
        for config in ("none", "several")
        for background in ("chicken", "paper")
        for seed in (4, 5)
    ]
    for job in jobs:
        recipe, eye = job.recipe, job.rig.eyes[0]
        assert f"{recipe.config}_{recipe.background}_{recipe.seed:04d}" == job.name
        assert (recipe.extras, recipe.dye, job.samples) == (("tools", "smoke"), "undyed", 7)
        assert (eye.width, eye.height, job.rig.is_rectified) == (320, 180, True)


def test_a_calibrated_camera_is_seen_through_as_it_is_and_one_that_does_not_fit_is_said(tmp_path):
    camera, file = calibration(), tmp_path / "camera.json"

    def job_of(written, size=(320, 180), **options):
        write_calibration(file, written)
        return jobs_of(asked(calibration=(file,), size=size, **options))[0]

    left, right = job_of(camera).rig.eyes
    np.testing.assert_array_equal(left.distortion, camera.distortion_left)
    np.testing.assert_array_equal(right.K, camera.K_right)
    np.testing.assert_allclose(right.R_eye_left, camera.T_right_left[:3, :3])
    assert not job_of(camera).rig.is_rectified
    assert job_of(calibration(None), unit="mm").rig.baseline_mm == pytest.approx(
        float(np.linalg.norm(camera.T_right_left[:3, 3]))
    )
    exchanged = replace(camera, T_right_left=inverse(camera.T_right_left))
    for written, options, said in (
        (camera, {"size": (960, 540)}, "for 320x180 images, and these are 960x540"),
        (exchanged, {}, "the calibration cannot be used: The right camera stands to the left"),
        (calibration(None), {}, "give --unit, as in --unit mm"),
        (camera, {"unit": "cm"}, "which contradicts --unit cm"),
    ):
        with pytest.raises(SceneError, match=said):
            job_of(written, **options)


DONE = [Done("one", 0.02, 3.0), Done("two", 0.04, 5.0), Done("none", float("nan"), 1.0)]


def test_what_was_made_is_summed_up():
    assert summary(asked(), 7, []) == "7 pairs in DIR: all were there already"
    assert summary(asked(), 7, DONE) == (
        "7 pairs in DIR, 3 of them new: 3.0 s of processor time each; masks lie 0.030 px from the truth, 0.040 at worst"
    )
    left_out = Done("three", float("nan"), 9.0, "no place")
    assert summary(asked(), 7, [*DONE, left_out]).startswith("6 pairs in DIR, 3 of them new: 3.0 s")
    assert summary(asked(), 7, [left_out]) == "6 pairs in DIR, none of them new"


def test_a_pair_to_measure_nothing_by_and_one_that_was_left_out_are_named(monkeypatch, capfd, tmp_path):
    monkeypatch.setattr("agents.cli.lab.scenes.engine", lambda: None)
    for done, said, status in (
        (Done("one", 0.051, 1.0), "the masks of one lie 0.051 px from its truth, more than 0.05 px", 0),
        (Done("one", float("nan"), 1.0, "no hard scene fits"), "one was left out: no hard scene fits", EXIT_SOME),
        (Done("one", 0.049, 1.0), "", 0),
    ):
        monkeypatch.setattr("agents.cli.lab.scenes.make_all", lambda _jobs, _workers, done=done: iter([done]))
        assert run(Scenes("render", tmp_path)) == status
        err = capfd.readouterr().err
        assert said in err
        assert bool(err) == bool(said)


@pytest.mark.skipif(TRACES, reason="the extra sim is installed")
def test_without_the_path_tracer_its_remedy_is_said(suturegrasp, tmp_path):
    ended = suturegrasp("scenes", "render", "--output", tmp_path)
    assert ended.status == 2
    assert "make sim" in ended.err


@pytest.mark.renders
@pytest.mark.timeout(900)
@pytest.mark.skipif(not TRACES, reason="path tracing needs the extra sim: make sim")
def test_a_batch_is_made_by_two_processes_and_taken_up_again(suturegrasp, console_script, tmp_path):
    options = ("--output", tmp_path, "--config", "easy", "--size", 160, 90, "--samples", 1, "--seed", 3, "--count", 2)
    batch = ("scenes", "render", *options)
    first = console_script(*batch, "--workers", 2)
    assert first.status == 0, first.err
    assert re.search(r"2 pairs in .*, 2 of them new: [\d.]+ s of processor time each", first.out)
    made = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert {"easy_chicken_0003.json", "easy_chicken_0004_mask_right.png"} <= set(made)
    assert "all were there already" in suturegrasp(*batch).out
    other = suturegrasp(*batch, "--with", "smoke")
    assert other.status == 2
    assert "was made otherwise (with: [], not ['smoke']); name another folder with --output" in other.err
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == made
