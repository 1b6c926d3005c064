"""`suturegrasp scenes render`: what is refused at once, and batches that are made as a user makes them."""

import importlib.util
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.cli.lab.scenes import EXIT_SOME, jobs_of, run, shown, summary
from agents.cli.lab.scenes_options import Scenes
from shared.calibration import write_calibration
from shared.rigid_transforms import inverse
from shared.scene.path_traced.batch import Done
from shared.scene.render import SceneError
from tests.shared.scene.path_traced.test_eyes import calibration

TRACES = importlib.util.find_spec("mitsuba") is not None


def scenes(*arguments):
    command = [sys.executable, "-m", "agents.cli", "scenes", "render", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--count", "0"), "--count 0: give 1 or more"),
        (("--workers", "-1"), "--workers -1: give 1 or more"),
        (("--size", "20", "960"), "--size 20 960: give 64 to 3840 for either"),
        (("--config", "knot"), "config"),
    ],
)
def test_what_makes_no_batch_is_said_in_one_sentence(suturegrasp, tmp_path, arguments, said):
    ended = suturegrasp("scenes", "render", "--output", tmp_path, *arguments)
    assert ended.status == 2
    assert said in ended.err
    assert len(ended.err.splitlines()) == 1


def test_a_file_in_place_of_the_folder_is_said(suturegrasp, tmp_path):
    (tmp_path / "file").write_text("")
    ended = suturegrasp("scenes", "render", "--output", tmp_path / "file")
    assert ended.status == 2
    assert "is a file; name a folder" in ended.err


def asked(**options):
    return Scenes("render", Path("DIR"), **options)


def test_every_seed_of_every_configuration_on_every_background_is_a_job_as_it_was_asked_for():
    options = {
        "extras": ("tools", "smoke"),
        "colour": "undyed",
        "samples": 7,
        "size": (320, 180),
        "seed": 4,
        "count": 2,
    }
    jobs = jobs_of(asked(config=("several", "none"), background=("paper", "chicken"), **options))
    assert {job.name for job in jobs} == {
        f"{config}_{background}_{seed:04d}"
        for config in ("several", "none")
        for background in ("paper", "chicken")
        for seed in (4, 5)
    }
    assert len(jobs) == 8
    for job in jobs:
        recipe, eye = job.recipe, job.rig.eyes[0]
        assert f"{recipe.config}_{recipe.background}_{recipe.seed:04d}" == job.name
        assert (recipe.extras, recipe.dye, job.samples) == (("tools", "smoke"), "undyed", 7)
        assert (eye.width, eye.height, job.rig.is_rectified) == (320, 180, True)


def test_a_calibrated_camera_is_seen_through_as_it_is(tmp_path):
    write_calibration(tmp_path / "camera.json", calibration())
    (job,) = jobs_of(asked(calibration=(tmp_path / "camera.json",), size=(320, 180)))
    left, right = job.rig.eyes
    np.testing.assert_array_equal(left.distortion, calibration().distortion_left)
    np.testing.assert_array_equal(right.K, calibration().K_right)
    np.testing.assert_allclose(right.R_eye_left, calibration().T_right_left[:3, :3])
    assert not job.rig.is_rectified


@pytest.mark.parametrize(
    ("metres_per_unit", "exchanged", "options", "said"),
    [
        (1e-3, False, {"size": (960, 540)}, "for 320x180 images, and these are 960x540"),
        (1e-3, True, {"size": (320, 180)}, "the calibration cannot be used: The right camera stands to the left"),
        (None, False, {"size": (320, 180)}, "give --unit, as in --unit mm"),
        (1e-3, False, {"size": (320, 180), "unit": "cm"}, "which contradicts --unit cm"),
    ],
)
def test_a_calibration_that_does_not_fit_is_said(tmp_path, metres_per_unit, exchanged, options, said):
    camera = calibration(metres_per_unit)
    T = inverse(camera.T_right_left) if exchanged else camera.T_right_left
    write_calibration(tmp_path / "camera.json", replace(camera, T_right_left=T))
    with pytest.raises(SceneError, match=said):
        jobs_of(asked(calibration=(tmp_path / "camera.json",), **options))


def test_a_unit_that_the_file_does_not_know_can_be_given(tmp_path):
    write_calibration(tmp_path / "camera.json", calibration(None))
    (job,) = jobs_of(asked(calibration=(tmp_path / "camera.json",), size=(320, 180), unit="mm"))
    assert job.rig.baseline_mm == pytest.approx(float(np.linalg.norm(calibration().T_right_left[:3, 3])))


DONE = [Done("one", 0.02, 3.0), Done("two", 0.04, 5.0), Done("none", float("nan"), 1.0)]


def test_a_bar_shows_how_many_of_all_there_are_and_only_to_a_person(capfd, monkeypatch):
    assert list(shown(iter(DONE), 7, 4)) == DONE
    assert capfd.readouterr().err == ""
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert list(shown(iter(DONE), 7, 4)) == DONE
    drawn = capfd.readouterr().err
    assert "none" in drawn and "7/7" in drawn
    list(shown(iter(DONE[:1]), 7, 4))
    assert "5/7" in capfd.readouterr().err


def test_what_was_made_is_summed_up():
    assert summary(asked(), 7, []) == "7 pairs in DIR: all were there already"
    assert summary(asked(), 7, DONE) == (
        "7 pairs in DIR, 3 of them new: 3.0 s of processor time each; masks lie 0.030 px from the truth, 0.040 at worst"
    )
    assert summary(asked(), 1, DONE[2:]) == "1 pairs in DIR, 1 of them new: 1.0 s of processor time each"
    left_out = Done("three", float("nan"), 9.0, "no place")
    assert summary(asked(), 7, [*DONE, left_out]).startswith("6 pairs in DIR, 3 of them new: 3.0 s")
    assert summary(asked(), 7, [left_out]) == "6 pairs in DIR, none of them new"


@pytest.mark.parametrize(
    ("done", "said", "status"),
    [
        (Done("one", 0.051, 1.0), "the masks of one lie 0.051 px from its truth, more than 0.05 px", 0),
        (Done("one", float("nan"), 1.0, "no hard scene fits"), "one was left out: no hard scene fits", EXIT_SOME),
        (Done("one", 0.049, 1.0), "", 0),
    ],
)
def test_a_pair_to_measure_nothing_by_and_one_that_was_left_out_are_named(
    monkeypatch, capfd, tmp_path, done, said, status
):
    monkeypatch.setattr("agents.cli.lab.scenes.engine", lambda: None)
    monkeypatch.setattr("agents.cli.lab.scenes.make_all", lambda _jobs, _workers: iter([done]))
    assert run(Scenes("render", tmp_path)) == status
    err = capfd.readouterr().err
    assert said in err
    assert bool(err) == bool(said)


@pytest.mark.skipif(TRACES, reason="the extra sim is installed")
def test_without_the_path_tracer_its_remedy_is_said(tmp_path):
    ended = scenes("--output", tmp_path)
    assert ended.returncode == 2
    assert "make sim" in ended.stderr


@pytest.mark.timeout(900)
@pytest.mark.skipif(not TRACES, reason="path tracing needs the extra sim: make sim")
def test_a_batch_is_made_by_two_processes_and_taken_up_again(tmp_path):
    batch = ("--output", tmp_path, "--config", "easy", "--size", 160, 90, "--samples", 1, "--seed", 3)
    first = scenes(*batch, "--count", 2, "--workers", 2)
    assert first.returncode == 0, first.stderr
    assert re.search(r"2 pairs in .*, 2 of them new: [\d.]+ s of processor time each", first.stdout)
    made = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert {"easy_chicken_0003.json", "easy_chicken_0004_mask_right.png"} <= set(made)
    again = scenes(*batch, "--count", 2)
    assert "all were there already" in again.stdout
    other = scenes(*batch, "--count", 2, "--with", "smoke")
    assert other.returncode == 2
    assert "was made otherwise (with: [], not ['smoke']); name another folder with --output" in other.stderr
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == made
