"""`suturegrasp scenes render`: the jobs of a batch, its camera, and a batch that is made as a user makes it."""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.cli.lab.options import Scenes
from agents.cli.lab.scenes import EXIT_SOME, jobs_of, run, summary
from shared.calibration import CalibrationError, write_calibration
from shared.rendering.path_traced.batch import Done
from shared.rendering.render import SceneError
from shared.rigid_transforms import inverse
from tests.shared.rendering.path_traced.test_eyes import calibration

TRACES = importlib.util.find_spec("mitsuba") is not None


def asked(**options):
    return Scenes("render", Path("DIR"), **options)


def test_every_seed_of_every_configuration_on_every_background_is_a_job_as_it_was_asked_for():
    options = {"extras": ("tools", "smoke"), "colour": "undyed", "samples": 7, "size": (320, 180)}
    jobs = jobs_of(asked(config=("several", "none"), background=("paper", "chicken"), seed=4, count=2, **options))
    assert len({job.name for job in jobs}) == 8
    for job in jobs:
        recipe, eye = job.recipe, job.rig.eyes[0]
        assert job.name == f"{recipe.config}_{recipe.background}_{recipe.seed:04d}"
        assert recipe.config in ("several", "none") and recipe.seed in (4, 5)
        assert (recipe.extras, recipe.dye, job.samples) == (("tools", "smoke"), "undyed", 7)
        assert (eye.width, eye.height, job.rig.is_rectified) == (320, 180, True)


def test_a_calibrated_camera_is_seen_through_as_it_is_and_one_that_does_not_fit_is_said(tmp_path):
    camera, file = calibration(), tmp_path / "camera.json"
    write_calibration(file, camera)
    rig = jobs_of(asked(calibration=(file,), size=(320, 180)))[0].rig
    np.testing.assert_array_equal(rig.eyes[0].distortion, camera.distortion_left)
    np.testing.assert_array_equal(rig.eyes[1].K, camera.K_right)
    assert not rig.is_rectified
    with pytest.raises(CalibrationError, match="for 320x180 images, and these are 960x540"):
        jobs_of(asked(calibration=(file,), size=(960, 540)))
    write_calibration(file, replace(camera, T_right_left=inverse(camera.T_right_left)))
    with pytest.raises(SceneError, match="the calibration cannot be used: The right camera stands to the left"):
        jobs_of(asked(calibration=(file,), size=(320, 180)))


def test_what_was_made_is_summed_up_and_a_pair_that_was_left_out_or_is_off_is_named(monkeypatch, capfd, tmp_path):
    done = [Done("one", 0.02, 3.0), Done("two", 0.04, 5.0), Done("three", float("nan"), 9.0, "no place")]
    assert summary(asked(), 7, []) == "7 pairs in DIR: all were there already"
    assert summary(asked(), 7, done) == (
        "6 pairs in DIR, 2 of them new: 4.0 s of processor time each; masks lie 0.030 px from the truth, 0.040 at worst"
    )
    monkeypatch.setattr("agents.cli.lab.scenes.engine", lambda: None)
    off = Done("four", 0.051, 1.0)
    for one, status, told in (
        (off, 0, "0.051 px from its truth"),
        (done[2], EXIT_SOME, "three was left out: no place"),
    ):
        monkeypatch.setattr("agents.cli.lab.scenes.make_all", lambda *_, one=one: iter([one]))
        assert run(Scenes("render", tmp_path)) == status
        assert told in capfd.readouterr().err


@pytest.mark.renders
@pytest.mark.timeout(900)
def test_a_batch_is_made_by_two_processes_and_taken_up_again(suturegrasp, console_script, tmp_path):
    options = ("--output", tmp_path, "--config", "easy", "--size", 160, 90, "--samples", 1, "--seed", 3, "--count", 2)
    batch = ("scenes", "render", *options)
    first = console_script(*batch, "--workers", 2)
    if not TRACES:
        assert (first.status, "make sim" in first.err) == (2, True)
        pytest.skip("path tracing needs the extra sim: make sim")
    assert first.status == 0, first.err
    assert re.search(r"2 pairs in .*, 2 of them new: [\d.]+ s of processor time each", first.out)
    made = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert {"easy_chicken_0003.json", "easy_chicken_0004_mask_right.png"} <= set(made)
    assert "all were there already" in suturegrasp(*batch).out
    other = suturegrasp(*batch, "--with", "smoke")
    assert other.status == 2
    assert "was made otherwise (with: [], not ['smoke']); name another folder with --output" in other.err
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == made
