import json
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from schemas.messages import StereoCalibration
from shared.calibration import CalibrationError, read_calibration
from shared.calibration.reader import ReadCalibration

SIZE = (960, 540)


class Camera(NamedTuple):
    """What a camera_info holds, in millimetres here."""

    K: np.ndarray
    D: np.ndarray
    R: np.ndarray
    P: np.ndarray


@pytest.fixture(scope="module")
def cameras(endoscope: StereoCalibration) -> tuple[Camera, Camera]:
    """Left and right as cv2.stereoRectify makes them, which is what camera_calibration calls."""
    c = endoscope
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        c.K_left, c.distortion_left, c.K_right, c.distortion_right, SIZE, c.T_right_left[:3, :3], c.T_right_left[:3, 3:]
    )
    return Camera(c.K_left, c.distortion_left, R1, P1), Camera(c.K_right, c.distortion_right, R2, P2)


def as_file(camera: Camera, name: str = "narrow_stereo", model: str = "plumb_bob") -> str:
    """The file format of camera_calibration."""

    def block(values: np.ndarray) -> str:
        rows, cols = np.atleast_2d(values).shape
        return f"\n  rows: {rows}\n  cols: {cols}\n  data: {values.ravel().tolist()}\n"

    return (
        f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: {name}\ncamera_matrix:{block(camera.K)}"
        f"distortion_model: {model}\ndistortion_coefficients:{block(camera.D)}"
        f"rectification_matrix:{block(camera.R)}projection_matrix:{block(camera.P)}"
    )


def as_message(camera: Camera, frame: str, second: int = 1, upper: bool = False) -> str:
    """What `ros2 topic echo` prints, or `rostopic echo` with upper-case names."""
    d, k, r, p = "DKRP" if upper else "dkrp"
    arrays = {d: camera.D, k: camera.K, r: camera.R, p: camera.P}
    lines = [
        f"header:\n  stamp:\n    sec: {second}\n    nanosec: 5\n  frame_id: {frame}",
        f"height: {SIZE[1]}\nwidth: {SIZE[0]}\ndistortion_model: plumb_bob",
        *(f"{name}:\n" + "\n".join(f"- {number}" for number in values.ravel()) for name, values in arrays.items()),
        "binning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  do_rectify: false\n---\n",
    ]
    return "\n".join(lines)


def assert_is(endoscope: StereoCalibration, given: Path | tuple[Path, ...]) -> None:
    read = read_calibration(given, unit="mm", image_size=SIZE).calibration
    np.testing.assert_allclose(read.T_right_left, endoscope.T_right_left, atol=1e-9)
    for name in ("K_left", "K_right", "distortion_left", "distortion_right"):
        np.testing.assert_array_equal(getattr(read, name), getattr(endoscope, name))
    assert read.metres_per_unit == 1e-3


def write_pair(folder: Path, texts: tuple[str, str], names: tuple[str, str]) -> tuple[Path, Path]:
    paths = (folder / names[0], folder / names[1])
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text)
    return paths


@pytest.mark.parametrize(
    "names",
    [("left.yaml", "right.yaml"), ("myLeftCamera.yaml", "myRightCamera.yaml"), ("left_0042.yml", "right_0043.yml")],
)
def test_a_pair_of_files_gives_the_transform_that_it_was_rectified_from(tmp_path, endoscope, cameras, names):
    left, right = write_pair(tmp_path, (as_file(cameras[0]), as_file(cameras[1])), names)
    (tmp_path / "ost.txt").write_text("# oST version 5.0 parameters\n")
    assert_is(endoscope, (left, right))
    assert_is(endoscope, tmp_path)
    if names[0] != "left_0042.yml":
        assert_is(endoscope, left)
        assert_is(endoscope, right)


def test_one_camera_alone_is_no_pair(tmp_path, cameras):
    (tmp_path / "left.yaml").write_text(as_file(cameras[0]))
    with pytest.raises(CalibrationError, match="holds one camera only; give the files of both"):
        read_calibration(tmp_path / "left.yaml", unit=None, image_size=SIZE)


@pytest.mark.parametrize("upper", [False, True])
def test_printed_messages_are_read_of_a_topic_that_was_recorded_for_a_while_too(tmp_path, endoscope, cameras, upper):
    left, right = ("".join(as_message(camera, "cam", second, upper) for second in range(3)) for camera in cameras)
    assert_is(endoscope, write_pair(tmp_path, (left, right), ("left.yaml", "right.yaml")))
    assert_is(endoscope, tmp_path / "left.yaml")


@pytest.mark.parametrize("frames", [("cam_left", "cam_right"), ("cam_right", "cam_left"), ("a", "b")])
def test_both_cameras_may_be_documents_of_one_file(tmp_path, endoscope, cameras, frames):
    pair = cameras if frames[0] != "cam_right" else cameras[::-1]
    path = tmp_path / "both.yaml"
    path.write_text("".join(as_message(camera, frame) for camera, frame in zip(pair, frames, strict=True)))
    assert_is(endoscope, path)


def test_both_cameras_may_be_entries_of_one_file(tmp_path, endoscope, cameras):
    path = tmp_path / "both.json"
    nested = {
        side: {
            "width": SIZE[0],
            "height": SIZE[1],
            **{name: values.ravel().tolist() for name, values in camera._asdict().items()},
        }
        for side, camera in zip(("left", "right"), cameras, strict=True)
    }
    path.write_text(json.dumps(nested))
    assert_is(endoscope, path)


def read_pair(folder: Path, texts: tuple[str, str], unit: str | None = None) -> ReadCalibration:
    return read_calibration(write_pair(folder, texts, ("left.yaml", "right.yaml")), unit=unit, image_size=SIZE)


def test_metres_are_the_convention_and_millimetres_taken_for_them_are_noticed(tmp_path, cameras):
    left, right = cameras
    in_metres = right._replace(P=right.P * np.array([1, 1, 1, 1e-3]))
    read = read_pair(tmp_path, (as_file(left), as_file(in_metres)))
    assert read.calibration.metres_per_unit == 1
    assert not read.judgements
    assert read_pair(tmp_path, (as_file(left), as_file(in_metres)), "cm").calibration.metres_per_unit == 1e-2
    (judgement,) = read_pair(tmp_path, (as_file(left), as_file(right))).judgements
    assert judgement.code == "baseline_implausible"
    assert "--unit mm" in judgement.remedy


def test_eight_coefficients_of_the_rational_model_are_kept(tmp_path, cameras):
    D = np.arange(8) / 100
    left, right = (as_file(camera._replace(D=D), model="rational_polynomial") for camera in cameras)
    np.testing.assert_array_equal(read_pair(tmp_path, (left, right), "mm").calibration.distortion_left, D)


def changed(camera: Camera, name: str, row: int, column: int, value: float) -> Camera:
    values = getattr(camera, name).copy()
    values[row, column] = value
    return camera._replace(**{name: values})


@pytest.mark.parametrize(
    "changes,complaint",
    [
        ({"right": ("P", 0, 3, 0.0)}, "neither P holds a baseline.*calibrate them together"),
        ({"right": ("P", 1, 3, -500.0)}, "vertical baseline"),
        ({"left": ("P", 0, 3, -500.0)}, "both P hold a baseline"),
        ({"right": ("P", 0, 0, 0.0)}, "focal length of 0 px"),
        ({"left": ("R", 0, 0, 3.0)}, "R of the left camera is no rotation"),
    ],
)
def test_projections_that_are_no_stereo_pair_are_refused(tmp_path, cameras, changes, complaint):
    sides = dict(zip(("left", "right"), cameras, strict=True))
    texts = [as_file(changed(camera, *changes[side]) if side in changes else camera) for side, camera in sides.items()]
    pair = write_pair(tmp_path, (texts[0], texts[1]), ("left.yaml", "right.yaml"))
    with pytest.raises(CalibrationError, match=complaint):
        read_calibration(pair, unit=None, image_size=SIZE)


def test_files_that_are_no_pair_of_calibrated_cameras_are_told_apart(tmp_path, cameras):
    left, right = (as_file(camera) for camera in cameras)
    blank = as_file(Camera(np.zeros((3, 3)), np.zeros(5), np.zeros((3, 3)), np.zeros((3, 4))))
    fisheye = as_file(cameras[0], model="equidistant")
    for texts, complaint in (
        ((right, left), r"swapped: .* give the two files in the other order"),
        ((fisheye, right), "fisheye model equidistant.*plumb_bob"),
        ((blank, right), "left camera_info is all zeros"),
        ((left, right.replace("rectification_matrix", "other")), "right camera_info has no R; it holds image_width"),
        ((left, right.replace("image_width: 960", "image_width: 640")), "different image sizes"),
        ((left, "R: [1]\n"), "give both cameras in one format"),
    ):
        with pytest.raises(CalibrationError, match=complaint):
            read_pair(tmp_path, texts)
