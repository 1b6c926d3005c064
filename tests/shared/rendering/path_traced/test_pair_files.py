"""What of a traced pair goes onto disk, and the check of its truth by its masks."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.rendering.path_traced.eyes import calibrated_rig
from shared.rendering.path_traced.pair import (
    COLUMNS,
    CentrelineTruth,
    EyeImages,
    TracedPair,
    offset_from_truth,
    write_traced,
)
from shared.rendering.path_traced.recipe import Recipe, arranged
from shared.rendering.path_traced.splines import sampled
from tests.shared.rendering.path_traced.test_eyes import calibration

RIG, RECIPE = endoscope(320, 180), Recipe("several", "chicken", 12, ("tools",), "blue")


@pytest.fixture(scope="module")
def pair():
    """Two threads and a tool, of which the right eye sees the tool alone, without any light."""
    scenery = arranged(RECIPE, RIG)
    none, some = np.zeros((180, 320), np.float32), np.zeros((180, 320), np.float32)
    some[40:60, 10:50] = 0.5
    black = np.zeros((180, 320, 3), np.uint8)
    truths = []
    for strand in scenery.field.strands:
        points, arc = sampled(strand.curve)
        truths.append(CentrelineTruth(points, arc, (arc < 5.0, arc < 9.0)))
    images = EyeImages(black, some, none, none), EyeImages(black, none, some, none)
    return TracedPair(RECIPE, RIG, scenery, images, truths, None, (np.array([0.02, -0.04]), np.zeros(0)), 4)


def written(folder, pair):
    write_traced(folder, "one", pair)
    return json.loads((folder / "one.json").read_text())


@pytest.mark.slow
def test_every_thread_and_needle_has_its_points_and_what_either_eye_sees_of_them(pair, tmp_path):
    first, second = pair.strands
    about = written(tmp_path, replace(pair, needle=second))
    assert (about["threads"], len(about["other_threads"]), about["color"]) == (2, 1, "blue")
    assert about["npy_columns"] == list(COLUMNS)
    tables = {"one.npy": first, "one_thread2.npy": second, "one_needle.npy": second}
    for name, truth in tables.items():
        table = np.load(tmp_path / name)
        np.testing.assert_allclose(table[:, :3], truth.points, atol=1e-4)
        np.testing.assert_array_equal(table[:, 4:], np.column_stack(truth.seen))
    for told, truth in ((about, first), (about["other_threads"][0], second)):
        assert told["length_mm"] == pytest.approx(truth.arc_mm[-1])
        for side, seen in zip(("left", "right"), truth.seen, strict=True):
            assert told[f"visible_{side}"] == pytest.approx(seen.mean())
    assert about["mask_offset_px"] == [pytest.approx(0.03), 0.0]
    assert about["mask_bias_px"] == [pytest.approx(-0.01), 0.0]


def test_there_is_a_mask_of_thread_in_any_case_and_of_instruments_where_an_eye_sees_any(pair, tmp_path):
    written(tmp_path, pair)
    names = {"one_left.png", "one_right.png", "one_mask_left.png", "one_mask_right.png", "one_tool_right.png"}
    assert {path.name for path in tmp_path.glob("*.png")} == names
    mask = cv2.imread(str(tmp_path / "one_mask_left.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    assert np.unique(mask).tolist() == [0, 128]


def test_the_camera_is_told_as_it_is(pair, tmp_path):
    plain = written(tmp_path / "plain", pair)
    assert (plain["right_camera"], plain["baseline_mm"]) == ("P_right = P_left - [baseline,0,0]", pytest.approx(5.5))
    camera = calibration()
    bent = written(tmp_path / "bent", replace(pair, rig=calibrated_rig(camera)))
    assert bent["right_camera"] == "P_right = R_right_left P_left + t_right_left_mm"
    for name, value in {
        "K": camera.K_left,
        "K_right": camera.K_right,
        "distortion_left": camera.distortion_left,
        "distortion_right": camera.distortion_right,
        "R_right_left": camera.T_right_left[:3, :3],
        "t_right_left_mm": camera.T_right_left[:3, 3],
    }.items():
        np.testing.assert_allclose(bent[name], value)


EYE = RIG.eyes[0]
RADIUS_MM, DEPTH_MM = 0.4, 80.0
HALF_PX = EYE.focal_px * RADIUS_MM / DEPTH_MM
SLANT = np.radians(25.0)


def line(offset_px=0.0, cross=False):
    """A strand across the image at a slant, and the share of each pixel that one so far aside of it covers."""
    along, across = np.array([np.cos(SLANT), np.sin(SLANT)]), np.array([-np.sin(SLANT), np.cos(SLANT)])
    middle = EYE.K[:2, 2]
    v, u = np.indices((180, 320))
    away = (np.dstack((u, v)) - middle) @ across
    cover = np.clip(HALF_PX + 0.5 - np.abs(away - offset_px), 0.0, 1.0)
    if cross:
        cover = np.maximum(cover, np.abs(u - middle[0]) < HALF_PX)
    pixels = middle + np.arange(-120.0, 120.0, 0.5)[:, None] * along
    points = np.column_stack(((pixels - middle) / EYE.focal_px * DEPTH_MM, np.full(len(pixels), DEPTH_MM)))
    return cover.astype(np.float32), points


def test_a_mask_beside_its_truth_is_seen_to_be_so_to_a_hundredth_of_a_pixel_on_average():
    for offset_px in (0.05, -0.3):
        cover, points = line(offset_px)
        found = offset_from_truth(cover, EYE, points, np.ones(len(points), bool), RADIUS_MM + 0.5)
        assert len(found) > 150
        assert found.mean() == pytest.approx(offset_px, abs=0.01)
        assert np.abs(found - offset_px).max() < 0.06


def test_nothing_is_said_beside_another_strand_of_a_few_pixels_or_where_the_thread_is_not_seen():
    cover, points = line(cross=True)
    seen = np.ones(len(points), bool)
    found = offset_from_truth(cover, EYE, points, seen, RADIUS_MM)
    clear = offset_from_truth(line()[0], EYE, points, seen, RADIUS_MM)
    assert 0.5 * len(clear) < len(found) < 0.95 * len(clear)
    assert np.abs(found).max() < 0.06
    seen[: len(seen) // 2] = False
    half = offset_from_truth(line()[0], EYE, points, seen, RADIUS_MM)
    assert 0.3 * len(clear) < len(half) < 0.6 * len(clear)
    short = points[:20]
    assert len(offset_from_truth(cover, EYE, short, np.ones(len(short), bool), RADIUS_MM)) == 0
