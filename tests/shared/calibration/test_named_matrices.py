from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest

from schemas.messages import StereoCalibration
from shared.calibration import CalibrationError, OtherSizeError, read_calibration

SIZE = (960, 540)


def matrices(calibration: StereoCalibration) -> dict[str, np.ndarray]:
    return {
        "K1": calibration.K_left,
        "D1": calibration.distortion_left[None],
        "K2": calibration.K_right,
        "D2": calibration.distortion_right[None],
        "R": calibration.T_right_left[:3, :3].copy(),
        "T": calibration.T_right_left[:3, 3:].copy(),
    }


def write_with_opencv(path: Path, entries: Mapping[str, np.ndarray | int | tuple[int, int]]) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in entries.items():
        if isinstance(value, tuple):
            storage.startWriteStruct(name, cv2.FileNode_SEQ)
            for number in value:
                storage.write("", number)
            storage.endWriteStruct()
        else:
            storage.write(name, value)
    storage.release()
    return path


def assert_same(read: StereoCalibration, expected: StereoCalibration, tolerance: float = 1e-12) -> None:
    for name in ("K_left", "K_right", "distortion_left", "distortion_right", "T_right_left"):
        np.testing.assert_allclose(getattr(read, name), getattr(expected, name), atol=tolerance, err_msg=name)
    assert (read.image_width, read.image_height) == (expected.image_width, expected.image_height)


@pytest.mark.parametrize(
    "written,read_as",
    [("yml", "yml"), ("xml", "xml"), ("json", "json"), ("yml", "xml"), ("xml", "txt"), ("json", "yaml")],
)
def test_what_opencv_writes_is_read_and_its_content_decides_the_format(tmp_path, endoscope, written, read_as):
    path = write_with_opencv(tmp_path / f"stereo.{written}", {"image_size": SIZE, **matrices(endoscope)})
    path = path.rename(tmp_path / f"x.{read_as}")
    assert_same(read_calibration(path, unit="mm", image_size=SIZE).calibration, endoscope)


@pytest.mark.parametrize(
    "names",
    [
        ("M1", "D1", "M2", "D2", "R", "T"),
        ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T"),
        ("camera_matrix_left", "dist_left", "camera_matrix_right", "dist_right", "rotation", "translation"),
        ("left_camera_matrix", "left_distortion", "right_camera_matrix", "right_distortion", "rotation_matrix", "tvec"),
        ("mtxL", "distL", "mtxR", "distR", "Rmat", "translation_vector"),
        ("K_LEFT", "DISTORTION_LEFT", "K_RIGHT", "DISTORTION_RIGHT", "R_right_left", "t_right_left"),
    ],
)
def test_the_names_that_people_give_the_matrices_are_known(tmp_path, endoscope, names):
    entries = dict(zip(names, matrices(endoscope).values(), strict=True))
    path = write_with_opencv(tmp_path / "stereo.yml", entries)
    assert_same(read_calibration(path, unit="mm", image_size=SIZE).calibration, endoscope)


@pytest.mark.parametrize(("name", "rows"), [("T_right_left", 3), ("T", 4), ("l2r", 4), ("left_to_right", 3)])
def test_rotation_and_translation_may_be_one_matrix(tmp_path, endoscope, name, rows):
    entries = matrices(endoscope)
    del entries["R"], entries["T"]
    path = write_with_opencv(tmp_path / "stereo.yml", {**entries, name: endoscope.T_right_left[:rows].copy()})
    assert_same(read_calibration(path, unit="mm", image_size=SIZE).calibration, endoscope)


def test_a_rotation_may_be_a_vector_and_a_value_may_be_given_twice(tmp_path, endoscope):
    vector, _ = cv2.Rodrigues(endoscope.T_right_left[:3, :3])
    twice = {"R": vector, "M1": endoscope.K_left}
    path = write_with_opencv(tmp_path / "stereo.yml", {**matrices(endoscope), **twice})
    assert_same(read_calibration(path, unit="mm", image_size=SIZE).calibration, endoscope)
    path = write_with_opencv(tmp_path / "stereo.yml", {**matrices(endoscope), "M1": 2 * endoscope.K_left})
    with pytest.raises(CalibrationError, match="K1 and M1 both give the left camera matrix, and differ"):
        read_calibration(path, unit=None, image_size=SIZE)


def test_cameras_may_be_nested_under_left_and_right(tmp_path):
    path = tmp_path / "stereo.yaml"
    path.write_text(
        "left:\n  K: [[500, 0, 321], [0, 500, 240], [0, 0, 1]]\n  D: []\n"
        "right:\n  K: [500, 0, 321, 0, 500, 240, 0, 0, 1]\n  D: [0, 0, 0, 0]\n"
        "R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: [-4, 0, 0]\nunit: mm\n"
    )
    calibration = read_calibration(path, unit=None, image_size=(640, 480)).calibration
    assert calibration.K_left[0, 2] == calibration.K_right[0, 2] == 321
    assert calibration.metres_per_unit == 1e-3


def test_intrinsics_and_extrinsics_in_two_files_are_one_calibration(tmp_path, endoscope):
    entries = matrices(endoscope)
    extrinsics = {name: entries.pop(name) for name in ("R", "T")}
    rectified = {"R1": np.eye(3), "P1": np.eye(3, 4), "Q": np.eye(4)}
    first = write_with_opencv(tmp_path / "intrinsics.yml", entries)
    second = write_with_opencv(tmp_path / "extrinsics.yml", {**extrinsics, **rectified})
    for given in ((first, second), (second, first), tmp_path):
        assert_same(read_calibration(given, unit="mm", image_size=SIZE).calibration, endoscope)


@pytest.mark.parametrize("missing", ["K1", "D1", "K2", "D2", "R", "T"])
def test_a_missing_matrix_is_named(tmp_path, endoscope, missing):
    entries = matrices(endoscope)
    del entries[missing]
    path = write_with_opencv(tmp_path / "stereo.yml", entries)
    with pytest.raises(CalibrationError, match=rf"it has no .*\(usually called {missing}\b.*; it holds "):
        read_calibration(path, unit=None, image_size=SIZE)


def test_an_image_width_and_height_have_one_order_only(tmp_path, endoscope):
    size = {"image_width": SIZE[0], "image_height": SIZE[1]}
    path = write_with_opencv(tmp_path / "stereo.yml", {**matrices(endoscope), **size})
    assert_same(read_calibration(path, unit="mm", image_size=SIZE).calibration, endoscope)
    with pytest.raises(CalibrationError, match="for 960x540 images, and these are 540x960; use the images"):
        read_calibration(path, unit="mm", image_size=(SIZE[1], SIZE[0]))


@pytest.mark.parametrize("size", [SIZE, SIZE[::-1]])
@pytest.mark.parametrize("as_matrix", [False, True])
def test_an_image_size_in_either_order_is_read_and_other_images_refused_by_it(tmp_path, endoscope, size, as_matrix):
    stated = np.array([size], dtype=np.float64) if as_matrix else size
    path = write_with_opencv(tmp_path / "stereo.yml", {**matrices(endoscope), "imageSize": stated})
    assert_same(read_calibration(path, unit="mm", image_size=SIZE).calibration, endoscope)
    with pytest.raises(OtherSizeError, match="for 960x540 images, and these are 640x480; use the images") as raised:
        read_calibration(path, unit="mm", image_size=(640, 480))
    assert raised.value.size == SIZE


def test_two_files_that_are_one_and_two_image_sizes_are_refused(tmp_path, endoscope):
    path = write_with_opencv(tmp_path / "stereo.yml", matrices(endoscope))
    with pytest.raises(CalibrationError, match="both paths are one file; name it once"):
        read_calibration((path, tmp_path / "." / "stereo.yml"), unit="mm", image_size=SIZE)
    sizes = {"image_size_left": SIZE, "image_size_right": (640, 480)}
    path = write_with_opencv(tmp_path / "stereo.yml", {**matrices(endoscope), **sizes})
    with pytest.raises(CalibrationError, match="different image sizes"):
        read_calibration(path, unit="mm", image_size=SIZE)


@pytest.mark.parametrize(
    "name,value,complaint",
    [
        ("K1", np.eye(2), "K1 must be 3x3, but is 2x2"),
        ("D2", np.zeros((2, 3)), "D2 must be one row of numbers, but is 2x3"),
        ("D2", np.zeros((1, 3)), "the right camera has 3 distortion coefficients"),
        ("R", np.eye(4), "R must be 3x3, but is 4x4"),
        ("T", np.zeros((5, 1)), "T must be 3 numbers or a 4x4 matrix, but is 5x1"),
        ("K2", np.full((3, 3), np.nan), "K2"),
        ("K1", np.array([[800.0, 0, 0], [0, 800, 0], [480, 270, 1]]), "left camera matrix is transposed"),
        ("K1", np.diag([-800.0, 800, 1]), "left camera matrix must be fx s cx"),
        ("R", np.diag([1.0, 1, -1]), "mirrors space"),
        ("ImageSize", np.array([[960.0, 540, 3]]), "ImageSize must be two whole numbers"),
        ("ImageSize", np.array([[960.5, 540]]), "ImageSize must be one positive whole number"),
    ],
)
def test_a_wrong_matrix_is_named_with_what_is_wrong(tmp_path, endoscope, name, value, complaint):
    path = write_with_opencv(tmp_path / "stereo.yml", {**matrices(endoscope), name: value})
    with pytest.raises(CalibrationError, match=f"stereo.yml: .*{complaint}"):
        read_calibration(path, unit=None, image_size=SIZE)
