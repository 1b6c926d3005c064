"""What is learned from: scenes and folders of them that are read again, and middles of one eye and of both."""

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from agents.perception.both_eyes.network_inputs import LEFT, RIGHT, together
from agents.perception.centrelines.learned import learned_middles
from benchmarks.training.lab_ground import SEALED
from benchmarks.training.lab_instruments import load_meshes
from benchmarks.training.lab_scenes import NAMES, lab_scene, main
from benchmarks.training.light_scenes import write_scenes
from benchmarks.training.middle_crops import LENGTH, STRETCHES, VIEWS, batches, profiles_of
from benchmarks.training.middle_drawn import drawn_view
from benchmarks.training.middle_pairs import INNER, pair_profiles
from benchmarks.training.scenes import SceneFolderError, views_in
from schemas.messages import RectifiedStereo

MESHES = Path("../shared/data/instruments")
SMALL = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)


@pytest.fixture(scope="module")
def meshes():
    """The needle driver's."""
    if not MESHES.exists():
        pytest.skip(f"{MESHES} is absent")
    return load_meshes(MESHES)


@pytest.mark.slow
def test_light_scenes_are_written_once_and_read_again_with_thread_darker_or_brighter_where_their_masks_say(tmp_path):
    with pytest.raises(SceneFolderError, match="render scenes into it"):
        views_in([tmp_path])
    write_scenes(tmp_path, 5, 1, SMALL)
    views = views_in([tmp_path])
    assert [view.name for view in views] == [f"light_00005_{k}_{eye}" for k in range(3) for eye in ("left", "right")]
    assert any(view.coverage.any() for view in views)
    for image, coverage in ((view.image, view.coverage) for view in views if view.coverage.any()):
        beside = cv2.dilate(coverage, np.ones((15, 15), np.uint8)) > 0
        away = image[coverage > 200].mean(axis=0) - image[beside & (coverage == 0)].mean(axis=0)
        assert np.abs(away).max() > 5
    written = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    write_scenes(tmp_path, 5, 1, SMALL)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == written


def test_masks_of_needles_and_instruments_are_read_where_they_are_asked_for(tmp_path):
    def write(name, value):
        cv2.imwrite(str(tmp_path / f"{name}_left.png"), np.full((40, 60), value, np.uint8))

    for name in ("lab_1", "traced_1", "light_1"):
        cv2.imwrite(str(tmp_path / f"{name}_left.png"), np.zeros((40, 60, 3), np.uint8))
        write(f"{name}_mask", 1)
    for number, name in enumerate(("lab_1_needle", "lab_1_instrument", "traced_1_tool")):
        write(name, 2 + number)

    def most(*coverages):
        return [None if coverage is None else coverage.max() for coverage in coverages]

    lab, light, traced = views_in([tmp_path], classes=True)
    assert most(lab.coverage, lab.needle, lab.instrument) == [1, 2, 3]
    assert most(light.needle, light.instrument) == [None, None]
    assert most(traced.needle, traced.instrument) == [None, 4]
    assert all(view.needle is None and view.instrument is None for view in views_in([tmp_path]))


@pytest.mark.renders
def test_one_seed_makes_one_lab_scene_whose_classes_share_pixels_and_all_occur(meshes):
    scenes = [lab_scene(seed, meshes) for seed in range(1, 13)]
    for scene in scenes:
        assert scene.covers.shape[1:] == scene.image.shape[:2]
        assert scene.covers.astype(int).sum(axis=0).max() <= 255 + 2
    shown = [(scene.covers > 127).sum(axis=(1, 2)) >= 30 for scene in scenes]
    assert (np.sum(shown, axis=0) >= 3).all()
    again, sealed = lab_scene(1, meshes), lab_scene(1, meshes, SEALED)
    np.testing.assert_array_equal(scenes[0].image, again.image)
    np.testing.assert_array_equal(scenes[0].covers, again.covers)
    assert sealed.image.shape != again.image.shape or (sealed.image != again.image).any()


@pytest.mark.renders
@pytest.mark.usefixtures("meshes")
def test_lab_scenes_are_written_once_and_absent_meshes_told_in_one_sentence(tmp_path, capsys):
    command = ["--seed", "7", "--output", str(tmp_path), "--meshes", str(MESHES)]
    assert main([*command, "--count", "1"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {f"lab_000007_{name}.png" for name in NAMES}
    kept = tmp_path / "lab_000007_left.png"
    kept.write_bytes(b"kept")
    assert main([*command, "--count", "2"]) == 0
    assert kept.read_bytes() == b"kept"
    assert len(list(tmp_path.iterdir())) == 2 * len(NAMES)
    capsys.readouterr()
    assert main(["--count", "1", "--output", str(tmp_path / "out"), "--meshes", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert "roll_4162.dae (No such file" in told
    assert told.count("\n") == 1


RENDERS = Path(__file__).parents[3] / "../shared/data/renders"
NAME = "cfg_easy_paper"


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(81)
    return [drawn_view(rng) for _ in range(8)]


@pytest.mark.slow
def test_the_middle_is_learned_in_light_from_any_side_and_as_well_as_is_said(drawn):
    error, deviation = [], []
    for view in drawn:
        shown, some, pieces = profiles_of(view)
        found = learned_middles(shown, view.normal[some], pieces)
        error.append(np.abs(found.offset_px - view.offset_px[some]))
        deviation.append(found.deviation_px)
    error, deviation = np.concatenate(error), np.concatenate(deviation)
    assert np.median(error) < 0.13
    assert 0.5 < np.mean(error < deviation) < 0.9


def test_batches_follow_from_their_seed(drawn):
    one, other = (next(batches(drawn, seed=5)) for _ in range(2))
    for part, same in zip(one, other, strict=True):
        np.testing.assert_array_equal(part, same)
    assert one[0].shape[:3] == (VIEWS, STRETCHES, LENGTH // 2)


@pytest.mark.skipif(not RENDERS.is_dir() and "CI" not in os.environ, reason="needs shared/data beside the checkout")
def test_a_rendered_pair_is_the_same_where_its_truth_says_so_and_its_middles_err_apart(tmp_path):
    whole, left_alone = tmp_path / "whole", tmp_path / "left"
    whole.mkdir()
    left_alone.mkdir()
    for file in RENDERS.glob(f"{NAME}*"):
        (whole / file.name).symlink_to(file.resolve())
        if "right" not in file.name:
            (left_alone / file.name).symlink_to(file.resolve())
    (pair,) = pair_profiles([whole])
    assert pair.name == NAME
    assert pair.known.mean() > 0.95
    # both eyes err by about a tenth of a pixel
    assert 0.05 < np.sqrt(np.mean(pair.apart_px[pair.known] ** 2)) < 0.25
    # and see nearly the same
    seen = together(*(replace(eye, colour=eye.colour[INNER]) for eye in pair.eyes)).seen
    assert np.median(np.abs(seen[LEFT] - seen[RIGHT])) < 0.2
    assert pair_profiles([left_alone]) == []
