"""What of a pair goes onto disk: its images, masks of what there is, all threads, and the camera as it is."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.scene.path_traced.eyes import calibrated_rig
from shared.scene.path_traced.pair import CentrelineTruth, EyeImages, TracedPair
from shared.scene.path_traced.pair_files import COLUMNS, write_traced
from shared.scene.path_traced.recipe import Recipe, arranged
from shared.scene.path_traced.splines import sampled
from tests.shared.scene.path_traced.test_eyes import calibration

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
def test_every_thread_has_its_points_and_what_either_eye_sees_of_them(pair, tmp_path):
    about = written(tmp_path, pair)
    assert (about["threads"], len(about["other_threads"]), about["color"]) == (2, 1, "blue")
    assert about["npy_columns"] == list(COLUMNS)
    for name, truth, told in zip(
        ("one.npy", "one_thread2.npy"), pair.strands, (about, about["other_threads"][0]), strict=True
    ):
        table = np.load(tmp_path / name)
        np.testing.assert_allclose(table[:, :3], truth.points, atol=1e-4)
        np.testing.assert_array_equal(table[:, 4:], np.column_stack(truth.seen))
        assert told["length_mm"] == pytest.approx(truth.arc_mm[-1])
        assert told["visible_left"] == pytest.approx(table[:, 4].mean())
        assert told["visible_right"] == pytest.approx(table[:, 5].mean())
    assert about["mask_offset_px"] == [pytest.approx(0.03), 0.0]
    assert about["mask_bias_px"] == [pytest.approx(-0.01), 0.0]


def test_a_needle_has_its_points_too(pair, tmp_path):
    needle = pair.strands[0]
    written(tmp_path, replace(pair, needle=needle))
    table = np.load(tmp_path / "one_needle.npy")
    np.testing.assert_allclose(table[:, :3], needle.points, atol=1e-4)
    np.testing.assert_array_equal(table[:, 4:], np.column_stack(needle.seen))


def test_there_is_a_mask_of_thread_in_any_case_and_of_instruments_where_an_eye_sees_any(pair, tmp_path):
    written(tmp_path, pair)
    names = {"one_left.png", "one_right.png", "one_mask_left.png", "one_mask_right.png", "one_tool_right.png"}
    assert {path.name for path in tmp_path.glob("*.png")} == names
    mask = cv2.imread(str(tmp_path / "one_mask_left.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    assert np.unique(mask).tolist() == [0, 128]


def test_the_camera_is_told_as_it_is(pair, tmp_path):
    plain = written(tmp_path / "plain", pair)
    assert plain["right_camera"] == "P_right = P_left - [baseline,0,0]"
    assert plain["baseline_mm"] == pytest.approx(5.5)
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
