"""From files to a thread in 3D, in every form that images, masks and calibrations come in, against the truth."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from agents.cli.reconstruct.pipeline import reconstruct_pair
from schemas.messages import RectifiedStereo, StereoCalibration
from shared.calibration import read_calibration, write_calibration
from shared.scene.__main__ import make_scene
from shared.scene.files import truth_of
from shared.scene.render import render

CURVE_FIELDS = ("knots", "control_points", "confidence", "unseen", "observations")


def read_image(path: Path, flags: int = cv2.IMREAD_COLOR) -> np.ndarray:
    image = cv2.imread(str(path), flags)
    assert image is not None
    return image


def result(path: Path) -> dict[str, Any]:
    document = json.loads(path.read_text())
    return {field: document[field] for field in CURVE_FIELDS}


def test_the_shipped_example_comes_near_its_truth(console_script, pair, example, tmp_path, mean_error, true_points):
    out = tmp_path / "thread.json"
    shown = ("--picture", tmp_path / "thread.png", "--rrd", tmp_path / "thread.rrd")
    ended = console_script(*pair(example), "--output", out, *shown, cwd=tmp_path)
    assert (ended.status, ended.err) == (0, "")
    assert ended.out.count("\n") == 1
    assert mean_error(out, true_points(example)) < 1.5
    assert read_image(tmp_path / "thread.png").shape[1] == 1600
    assert (tmp_path / "thread.rrd").read_bytes()[:3] == b"RRF"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["thread.json", "thread.png", "thread.rrd"]


def test_a_published_pair_side_by_side_comes_near_its_truth(console_script, data, tmp_path, mean_error):
    folder = data / "ucsd_thread/sim"
    ended = console_script(
        *("reconstruct", "--stereo", folder / "scene_1_1.jpg"),
        *("--calibration", folder / "calibration_scenes_1_3.yaml", "--output", tmp_path / "out.json"),
    )
    assert (ended.status, ended.complaints) == (0, [])
    assert "units (of unknown size" in ended.out
    control = np.load(folder / "scene_1_1.npy")
    knots = np.concatenate((np.zeros(3), np.linspace(0, 1, len(control) - 2), np.ones(3)))
    assert mean_error(tmp_path / "out.json", BSpline(knots, control, 3)(np.linspace(0, 1, 1000))) < 0.3


def test_a_real_pair_gives_a_thread_that_projects_onto_itself(suturegrasp, data, tmp_path):
    folder = data / "ucsd_thread/real"
    left = folder / "thread2_59_left.png"
    ended = suturegrasp(
        *("reconstruct", "--left", left, "--right", folder / "thread2_59_right.png", "--unit", "mm"),
        *("--calibration", folder / "calibration.yaml", "--output", tmp_path / "out.json"),
    )
    assert (ended.status, ended.complaints) == (0, [])
    document = json.loads((tmp_path / "out.json").read_text())
    assert document["unit"] == "mm"
    camera, points = document["camera"], np.array(document["control_points"])
    x, y, z = BSpline(document["knots"], points, 3)(np.linspace(0, 1, 500)).T
    u, v = camera["fx_px"] * x / z + camera["cx_px"], camera["fy_px"] * y / z + camera["cy_px"]
    thread_px = np.argwhere(read_image(left).min(axis=2) < 250)[:, ::-1]
    assert np.mean(cKDTree(thread_px).query(np.column_stack((u, v)))[0]) < 1.5


@pytest.mark.parametrize("masks", [False, True], ids=["segmented", "masks given"])
def test_a_path_traced_pair_comes_near_its_truth(suturegrasp, data, tmp_path, mean_error, masks):
    name = str(data / "renders/cfg_easy_paper")
    given = ("--left-mask", f"{name}_mask_left.png", "--right-mask", f"{name}_mask_right.png") if masks else ()
    ended = suturegrasp(
        *("reconstruct", "--left", f"{name}_left.png", "--right", f"{name}_right.png", *given),
        *("--calibration", f"{name}.json", "--output", tmp_path / "out.json"),
    )
    assert (ended.status, ended.complaints) == (0, [])
    assert mean_error(tmp_path / "out.json", np.load(f"{name}.npy")[:, :3]) < 1.5


def test_images_that_are_rectified_already_are_left_untouched(small):
    calibration = read_calibration(small / "calibration.json", unit=None, image_size=(320, 180)).calibration
    images = read_image(small / "left.png"), read_image(small / "right.png")
    found = reconstruct_pair(images, calibration, masks=None, segmenter=None, method="paper")
    assert found.images[0] is images[0]
    assert found.images[1] is images[1]


WIDE = RectifiedStereo(
    image_width=1240,
    image_height=760,
    fx_px=800.0,
    fy_px=800.0,
    cx_px=619.5,
    cy_px=379.5,
    baseline=5.5,
    metres_per_unit=1e-3,
)
"""Sees more than the distorted cameras that its images are warped into."""

RAW_SIZE = (960, 540)
RAW = (
    (
        np.array([[811.5, 0, 478.7], [0, 812.25, 268.1], [0, 0, 1]]),
        np.array([-0.31, 0.12, -0.0017, 0.001, -0.02]),
        Rotation.from_rotvec([0.02, -0.012, 0.03]).as_matrix(),
    ),
    (
        np.array([[810.1, 0, 489.7], [0, 810.6, 273.6], [0, 0, 1]]),
        np.array([-0.29, 0.11, -0.0006, 0.0012, -0.03]),
        Rotation.from_rotvec([0.016, 0.015, 0.018]).as_matrix(),
    ),
)
"""Camera matrix, distortion, and rotation from the rendered camera's axes, of the left and of the right camera."""


def raw_calibration() -> StereoCalibration:
    (K_left, d_left, R_left), (K_right, d_right, R_right) = RAW
    T = np.eye(4)
    T[:3, :3] = R_right @ R_left.T
    T[:3, 3] = -WIDE.baseline * R_right[:, 0]
    return StereoCalibration(*RAW_SIZE, K_left, K_right, d_left, d_right, T, 1e-3)


def seen_by(camera: tuple[np.ndarray, np.ndarray, np.ndarray], image: np.ndarray) -> np.ndarray:
    """A rendered image as a turned and distorting camera at the same place would have taken it."""
    K, distortion, R = camera
    u, v = np.meshgrid(np.arange(RAW_SIZE[0]), np.arange(RAW_SIZE[1]))
    pixels = np.column_stack((u.ravel(), v.ravel())).astype(np.float64)
    rays = cv2.undistortPoints(pixels[:, None], K, distortion)[:, 0]
    x, y, z = R.T @ np.vstack((rays.T, np.ones(len(rays))))
    maps = (WIDE.fx_px * x / z + WIDE.cx_px, WIDE.fy_px * y / z + WIDE.cy_px)
    map_u, map_v = (m.reshape(RAW_SIZE[::-1]).astype(np.float32) for m in maps)
    assert map_u.min() > 0
    assert map_v.min() > 0
    assert map_u.max() < WIDE.image_width - 1
    assert map_v.max() < WIDE.image_height - 1
    return cv2.remap(image, map_u, map_v, cv2.INTER_CUBIC)


def test_distorted_and_turned_cameras_give_the_thread_in_the_rectified_frame(
    suturegrasp, pair, tmp_path, mean_error, true_points
):
    scene = make_scene("easy", "plain", 5, camera=WIDE)
    images = render(scene)
    written = {
        "left.png": seen_by(RAW[0], images.left_bgr),
        "right.png": seen_by(RAW[1], images.right_bgr),
        "mask_left.png": seen_by(RAW[0], images.coverage_left),
        "mask_right.png": seen_by(RAW[1], images.coverage_right),
    }
    for name, image in written.items():
        cv2.imwrite(str(tmp_path / name), image)
    calibration = raw_calibration()
    write_calibration(tmp_path / "calibration.json", calibration)
    (tmp_path / "truth.json").write_text(json.dumps(truth_of(scene)))
    # the rendered camera's axes → the raw left camera's → those that OpenCV turns it to
    rotation_left = cv2.stereoRectify(
        *(RAW[0][0], RAW[0][1], RAW[1][0], RAW[1][1], RAW_SIZE),
        *(calibration.T_right_left[:3, :3].copy(), calibration.T_right_left[:3, 3:].copy()),
    )[0]
    truth = true_points(tmp_path) @ (rotation_left @ RAW[0][2]).T
    masks = ("--left-mask", tmp_path / "mask_left.png", "--right-mask", tmp_path / "mask_right.png")
    for given in ((), masks):
        ended = suturegrasp(*pair(tmp_path), *given, "--output", tmp_path / "out.json")
        assert (ended.status, ended.complaints) == (0, [])
        assert mean_error(tmp_path / "out.json", truth) < 0.6
        assert mean_error(tmp_path / "out.json", true_points(tmp_path)) > 1.0, "the frame would not matter"


def own_result(suturegrasp, pair, small: Path) -> dict[str, Any]:
    assert suturegrasp(*pair(small), "--output", small / "own.json").status == 0
    return result(small / "own.json")


def test_a_folder_of_ros_camera_info_gives_the_same_thread(suturegrasp, pair, small):
    expected = own_result(suturegrasp, pair, small)
    (small / "calibration.json").unlink()
    for side, shift in (("left", 0.0), ("right", -330.0 * 0.0055)):
        (small / f"{side}.yaml").write_text(
            "image_width: 320\nimage_height: 180\ncamera_name: narrow\ndistortion_model: plumb_bob\n"
            "camera_matrix: {rows: 3, cols: 3, data: [330, 0, 159.5, 0, 330, 89.5, 0, 0, 1]}\n"
            "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
            "rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n"
            f"projection_matrix: {{rows: 3, cols: 4, data: [330, 0, 159.5, {shift}, 0, 330, 89.5, 0, 0, 0, 1, 0]}}\n"
        )
    images = ("reconstruct", "--left", small / "left.png", "--right", small / "right.png")
    for calibration in ((small / "left.yaml", small / "right.yaml"), (small,)):
        ended = suturegrasp(*images, "--calibration", *calibration, "--output", small / "ros.json")
        assert (ended.status, ended.complaints) == (0, [])
        metres = result(small / "ros.json")["control_points"]
        np.testing.assert_allclose(1000 * np.array(metres), expected["control_points"], rtol=1e-3, atol=1e-2)
        assert json.loads((small / "ros.json").read_text())["unit"] == "m"


def test_a_folder_of_text_matrices_gives_the_same_thread(suturegrasp, pair, small):
    expected = own_result(suturegrasp, pair, small)
    folder = small / "matrices"
    folder.mkdir()
    for side in ("left", "right"):
        (folder / f"calib.{side}.intrinsics.txt").write_text("330 0 159.5\n0 330 89.5\n0 0 1\n0 0 0 0 0\n")
    (folder / "calib.l2r.txt").write_text("1 0 0 -5.5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    images = ("reconstruct", "--left", small / "left.png", "--right", small / "right.png", "--unit", "mm")
    ended = suturegrasp(*images, "--calibration", folder, "--output", small / "text.json")
    assert (ended.status, ended.complaints) == (0, [])
    assert result(small / "text.json") == expected


MASK_FORMS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "0 and 1": lambda mask: (mask >= 128).astype(np.uint8),
    "0 and 255": lambda mask: (mask >= 128).astype(np.uint8) * np.uint8(255),
    "three channels": lambda mask: np.dstack([(mask >= 128).astype(np.uint8) * np.uint8(255)] * 3),
    "red on black": lambda mask: np.dstack((0 * mask, 0 * mask, (mask >= 128).astype(np.uint8) * np.uint8(255))),
    "16 bits": lambda mask: (mask >= 128).astype(np.uint16) * np.uint16(65535),
    "16 bits of which 8 are used": lambda mask: (mask >= 128).astype(np.uint16) * np.uint16(255),
    "16 bits, 0 and 1": lambda mask: (mask >= 128).astype(np.uint16),
}


@pytest.mark.parametrize("form", MASK_FORMS)
def test_a_mask_means_the_same_in_every_form(suturegrasp, pair, small, form):
    masks = ("--left-mask", small / "mask_left.png", "--right-mask", small / "mask_right.png")
    whole = {side: read_image(small / f"mask_{side}.png", cv2.IMREAD_GRAYSCALE) for side in ("left", "right")}
    results: list[dict[str, Any]] = []
    for made in (MASK_FORMS["0 and 255"], MASK_FORMS[form]):
        for side, mask in whole.items():
            cv2.imwrite(str(small / f"mask_{side}.png"), made(mask))
        assert suturegrasp(*pair(small), *masks, "--output", small / "out.json").status == 0
        results.append(result(small / "out.json"))
    assert results[0] == results[1]


IMAGE_FORMS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "alpha": lambda grey: cv2.cvtColor(grey, cv2.COLOR_GRAY2BGRA),
    "grey": lambda grey: grey,
    "16 bits": lambda grey: grey.astype(np.uint16) * np.uint16(257),
    "16 bits, colour": lambda grey: cv2.cvtColor(grey.astype(np.uint16) * np.uint16(257), cv2.COLOR_GRAY2BGR),
    "16 bits of which 8 are used": lambda grey: grey.astype(np.uint16),
}


@pytest.mark.parametrize("form", IMAGE_FORMS)
def test_an_image_means_the_same_in_every_form(suturegrasp, pair, small, form):
    grey = {side: read_image(small / f"{side}.png", cv2.IMREAD_GRAYSCALE) for side in ("left", "right")}
    results: list[dict[str, Any]] = []
    for made in (lambda image: cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), IMAGE_FORMS[form]):
        for side, image in grey.items():
            cv2.imwrite(str(small / f"{side}.png"), made(image))
        assert suturegrasp(*pair(small), "--output", small / "out.json").status == 0
        results.append(result(small / "out.json"))
    assert results[0] == results[1]


def test_a_side_by_side_image_gives_the_same_as_its_halves(suturegrasp, pair, small):
    expected = own_result(suturegrasp, pair, small)
    halves = [read_image(small / f"{side}.png") for side in ("left", "right")]
    cv2.imwrite(str(small / "both.png"), np.hstack(halves))
    options = ("--calibration", small / "calibration.json", "--output", small / "out.json")
    assert suturegrasp("reconstruct", "--stereo", small / "both.png", *options).status == 0
    assert result(small / "out.json") == expected


def test_a_failure_still_leaves_its_picture_and_recording(suturegrasp, pair, small):
    for name in ("left.png", "right.png"):
        cv2.imwrite(str(small / name), np.full((180, 320, 3), 206, np.uint8))
    shown = ("--picture", small / "out.jpg", "--rrd", small / "out.rrd")
    assert suturegrasp(*pair(small), "--output", small / "out.json", *shown).status == 3
    assert read_image(small / "out.jpg").shape[1] == 1600
    assert (small / "out.rrd").read_bytes()[:3] == b"RRF"


def test_paths_with_spaces_and_other_letters_work(suturegrasp, pair, small):
    folder = Path(shutil.copytree(small, small.with_name("naht 縫合 (1)")))
    ended = suturegrasp(*pair(folder), "--output", folder / "é.json", "--picture", folder / "ü.png")
    assert (ended.status, ended.complaints) == (0, [])
    assert (folder / "é.json").is_file()
    assert (folder / "ü.png").is_file()


def test_warnings_name_what_is_doubtful_and_stand_in_the_result(suturegrasp, pair, small):
    calibration = json.loads((small / "calibration.json").read_text())
    calibration["baseline_mm"] = 55.0
    (small / "calibration.json").write_text(json.dumps(calibration))
    ended = suturegrasp(*pair(small), "--output", small / "out.json")
    assert (ended.status, ended.complaints) == (0, [])
    assert "warning: The baseline of 55 mm is not one of an endoscope" in ended.err
    judgements = json.loads((small / "out.json").read_text())["judgements"]
    assert [judgement["code"] for judgement in judgements] == ["baseline_implausible"]


def test_another_thread_is_told_with_where_to_point_and_pointing_there_means_it(suturegrasp, pair, small):
    height, width = read_image(small / "left.png").shape[:2]
    ends = np.array(((0.1 * width, 0.1 * height), (0.6 * width, 0.2 * height)))
    for name, disparity in (("left.png", 0.0), ("right.png", 0.05 * width)):
        image = read_image(small / name)
        start, end = np.rint(ends - (disparity, 0.0)).astype(int).tolist()
        cv2.line(image, start, end, (40, 120, 30), 4, cv2.LINE_AA)
        cv2.imwrite(str(small / name), image)
    ended = suturegrasp(*pair(small), "--output", small / "out.json")
    assert ended.status == 0
    told = re.search(r"1 further thread was seen; choose with --at (\d+,\d+) \(score 0\.\d\d\)", ended.out)
    assert told is not None, ended.out
    (other,) = json.loads((small / "out.json").read_text())["other_threads"]
    distance = cKDTree(np.linspace(ends[0], ends[1], 500)).query(np.array(other["left_px"]))[0]
    assert np.median(distance) < 1
    assert suturegrasp(*pair(small), "--at", told[1], "--output", small / "meant.json").status == 0
    meant = json.loads((small / "meant.json").read_text())
    assert meant["score"] == pytest.approx(other["score"], abs=0.1)
    assert all(
        np.linalg.norm(np.array(left["left_px"]).mean(axis=0) - ends.mean(axis=0)) > 9
        for left in meant["other_threads"]
    )


@pytest.mark.parametrize("at", ["-1,5", "5,-1", "100000,5", "5,100000"])
def test_pointing_outside_the_image_is_refused(suturegrasp, pair, small, at):
    ended = suturegrasp(*pair(small), f"--at={at}", "--output", small / "out.json")
    assert ended.status == 2
    assert f"--at {at} lies outside the left image of " in ended.complaints[0]


def test_pointing_beside_all_thread_says_so(suturegrasp, pair, small):
    ended = suturegrasp(*pair(small), "--at", "1,1", "--output", small / "out.json")
    assert ended.status == 3
    assert re.fullmatch(
        r"suturegrasp: nothing like thread lies within \d+ px of \(1, 1\) in the left image", ended.complaints[0]
    )
