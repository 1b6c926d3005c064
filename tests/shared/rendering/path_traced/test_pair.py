"""The truth of a traced pair is what its images show; needs the extra `sim`."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.rendering.path_traced.batch import Job, make, mean_offset, outstanding
from shared.rendering.path_traced.eyes import calibrated_rig
from shared.rendering.path_traced.field import Field
from shared.rendering.path_traced.lab_light import Disk, LabLight
from shared.rendering.path_traced.pad import phantom_ground
from shared.rendering.path_traced.pair import traced_pair
from shared.rendering.path_traced.recipe import BACKGROUNDS, Recipe
from shared.rendering.path_traced.splines import Curve, sampled
from shared.rendering.render import SceneError
from shared.rendering.surface import meet_rays, ray_tangents
from tests.shared.rendering.path_traced.test_eyes import calibration

pytest.importorskip("mitsuba", reason="path tracing needs the extra sim: make sim")
pytestmark = pytest.mark.renders

SMALL = endoscope(320, 180)


def assert_masks_lie_on_the_truth(pair):
    assert mean_offset(pair) < 0.05
    for part in pair.offsets_px:
        assert len(part) > 60
        assert abs(part.mean()) < 0.02
    for images in pair.images:
        assert images.bgr.shape == (180, 320, 3)


def test_of_distorted_unrectified_eyes_the_masks_lie_on_the_true_centreline():
    assert_masks_lie_on_the_truth(traced_pair(Recipe("easy", "chicken", 2), calibrated_rig(calibration()), 2))


def test_of_a_crossing_thread_images_masks_and_truth_agree_and_one_strand_hides_the_other():
    crossing = traced_pair(Recipe("crossing", "chicken", 3), SMALL, 1)
    assert_masks_lie_on_the_truth(crossing)
    for images in crossing.images:
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


@pytest.mark.parametrize("seed", [3, 2**32 + 3], ids=["a small seed", "more than Mitsuba takes"])
def test_depth_of_the_ground_carries_the_left_image_into_the_right_one(seed):
    pair = traced_pair(Recipe("none", "paper", seed), SMALL, 2)
    camera = SMALL.near_enough
    depth = meet_rays(pair.arranged.field.ground.surface, *ray_tangents(camera), 0.0)
    left, right = (images.bgr for images in pair.images)
    v, u = np.indices((180, 320), dtype=np.float32)
    disparity = camera.fx_px * SMALL.baseline_mm / depth
    carried = cv2.remap(right, (u - disparity).astype(np.float32), v, cv2.INTER_LINEAR)
    inner = (slice(10, -10), slice(40, -10))
    grey = [image[inner].mean(axis=2).ravel() for image in (left, carried, right)]
    correlation = np.corrcoef(grey)[0]
    assert correlation[1] > 0.95
    assert correlation[2] < 0.9


def test_colour_lies_where_the_relief_is():
    from shared.rendering.path_traced.tracing import traced_lab_light
    from shared.rendering.path_traced.world import build

    rig = endoscope(160, 90)
    ground = phantom_ground(rig.widest, 90.0, np.random.default_rng(1))
    rows, columns = ground.film.shape
    albedo = np.full((rows, columns, 3), 0.6, np.float32)
    albedo[: rows // 2] = 0.01
    flat = replace(ground.surface, depth_mm=np.full((rows, columns), 90.0, np.float32))
    lamp = Disk((0.0, 0.0, -100.0), (0.0, 0.0, 90.0), 30.0, (30.0, 30.0, 30.0))
    light = LabLight((lamp,), (), np.full((8, 16, 3), 0.01, np.float32))
    field = Field(rig.near_enough, replace(ground, surface=flat, albedo=albedo), [], lab_light=light)
    image = traced_lab_light(build(field), rig.eyes[0], 4, 1)
    assert image[:40].mean() < 0.3 * image[50:].mean()
