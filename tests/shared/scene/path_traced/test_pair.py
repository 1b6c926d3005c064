"""The truth of a traced pair is what its images show; needs the extra `sim`."""

import json
from dataclasses import replace

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.scene.path_traced.batch import Job, make, mean_offset, outstanding
from shared.scene.path_traced.pair import traced_pair
from shared.scene.path_traced.recipe import BACKGROUNDS, Recipe
from shared.scene.path_traced.splines import Curve, sampled
from shared.scene.render import SceneError

pytest.importorskip("mitsuba", reason="path tracing needs the extra sim: make sim")
pytestmark = pytest.mark.renders

SMALL = endoscope(320, 180)


def test_of_a_crossing_thread_images_masks_and_truth_agree_and_one_strand_hides_the_other():
    crossing = traced_pair(Recipe("crossing", "chicken", 3), SMALL, 1)
    assert mean_offset(crossing) < 0.05
    for part in crossing.offsets_px:
        assert len(part) > 60
        assert abs(part.mean()) < 0.02
    for images in crossing.images:
        assert images.bgr.shape == (180, 320, 3)
        assert 0.002 < images.thread.mean() < 0.05
    left, right = (images.thread.sum() for images in crossing.images)
    assert abs(left - right) < 0.1 * left
    (truth,) = crossing.strands
    assert all(0.9 < seen.mean() < 1.0 for seen in truth.seen)


@pytest.mark.parametrize(("config", "seed"), [("needle", 1), ("several", 2)])
def test_threads_and_needle_are_told_apart(config, seed):
    pair = traced_pair(Recipe(config, "chicken", seed), SMALL, 1)
    for eye, images, side in zip(SMALL.eyes, pair.images, (0, 1), strict=True):
        for strand in pair.strands:
            assert strand.seen[side].mean() > 0.6
            assert on(images.thread, eye, strand.points[strand.seen[side]]).mean() > 0.95
        needle = pair.arranged.field.needle
        if needle is None:
            assert not images.needle.any()
            continue
        points, _ = sampled(needle.curve)
        middle = points[len(points) // 4 : len(points) // 2]
        assert on(images.needle, eye, middle).mean() > 0.7
        assert on(images.thread, eye, middle).mean() < 0.3


def on(cover, eye, points):
    """What a mask holds at the pixels of points."""
    u, v = np.rint(eye.project(points)).astype(int).T
    inside = (u >= 0) & (u < eye.width) & (v >= 0) & (v < eye.height)
    return cover[v[inside], u[inside]] > 0


def test_instruments_hide_thirty_percent_of_the_thread_but_not_its_ends_from_both_eyes():
    pair = traced_pair(Recipe("occlusion", "paper", 1), SMALL, 1)
    for seen, images in zip(pair.strands[0].seen, pair.images, strict=True):
        assert 0.4 < seen.mean() <= 0.72
        assert seen[: len(seen) // 10].mean() > 0.95
        assert seen[-len(seen) // 10 :].mean() > 0.95
        assert images.tool.mean() > 0.02


def test_a_pair_on_disk_has_the_form_of_the_published_renders_and_is_not_made_twice(tmp_path):
    job = Job(tmp_path, "one", Recipe("easy", "paper", 5, dye="undyed"), SMALL, 1)
    make(job)
    assert outstanding([job]) == []
    for other in (
        replace(job, recipe=replace(job.recipe, dye="blue")),
        replace(job, recipe=replace(job.recipe, extras=("smoke",))),
        replace(job, samples=2),
        replace(job, rig=endoscope(160, 90)),
    ):
        with pytest.raises(SceneError, match=r"one\.json was made otherwise .* name another folder with --output"):
            outstanding([other])
    document = json.loads((tmp_path / "one.json").read_text())
    table = np.load(tmp_path / "one.npy")
    assert table.shape[1] == len(document["npy_columns"]) == 6
    assert document["color"] == "undyed"
    assert document["K"][0][2] == 159.5
    control_points = np.array(document["control_points"])
    points, arc = sampled(Curve(control_points))
    np.testing.assert_allclose(table[:, :3], points, atol=1e-4)
    np.testing.assert_allclose(table[:, 3], arc, atol=1e-3)
    names = {path.name for path in tmp_path.iterdir()}
    assert names >= {f"one_{kind}{side}.png" for kind in ("", "mask_") for side in ("left", "right")}
    (tmp_path / "one.json").write_text((tmp_path / "one.json").read_text()[:100])
    assert outstanding([job]) == [job]


@pytest.mark.parametrize("background", BACKGROUNDS)
def test_a_field_without_thread_has_empty_masks_and_still_an_image(background):
    pair = traced_pair(Recipe("none", background, 2), SMALL, 1)
    for images in pair.images:
        assert not images.thread.any()
        assert 40 < images.bgr.mean() < 200
    assert pair.strands == []


def test_a_thread_at_rest_comes_out_of_the_tissue_and_is_where_its_mask_says():
    pair = traced_pair(Recipe("rod", "chicken", 3), SMALL, 1)
    assert mean_offset(pair) < 0.05
    for seen in pair.strands[0].seen:
        assert not seen[:10].all()
        assert seen.mean() > 0.6
