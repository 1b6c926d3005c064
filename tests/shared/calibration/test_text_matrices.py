from pathlib import Path

import numpy as np
import pytest

from schemas.messages import StereoCalibration
from shared.calibration import CalibrationError, read_calibration

SIZE = (960, 540)


def write_folder(folder: Path, c: StereoCalibration, distortion_apart: bool = False, rows: int = 4) -> Path:
    for side, K, D in (("left", c.K_left, c.distortion_left), ("right", c.K_right, c.distortion_right)):
        np.savetxt(folder / f"calib.{side}.intrinsics.txt", K)
        if distortion_apart:
            np.savetxt(folder / f"calib.{side}.distortion.txt", D[None])
        else:
            with (folder / f"calib.{side}.intrinsics.txt").open("a") as file:
                np.savetxt(file, D[None])
    np.savetxt(folder / "calib.l2r.txt", c.T_right_left[:rows])
    return folder


@pytest.mark.parametrize("distortion_apart", [False, True])
@pytest.mark.parametrize("rows", [3, 4])
def test_a_folder_is_read(tmp_path, endoscope, distortion_apart, rows):
    read = read_calibration(write_folder(tmp_path, endoscope, distortion_apart, rows), unit="mm", image_size=SIZE)
    for name in ("K_left", "K_right", "distortion_left", "distortion_right", "T_right_left"):
        np.testing.assert_allclose(getattr(read.calibration, name), getattr(endoscope, name), atol=1e-15)
    assert (read.calibration.image_width, read.calibration.image_height) == SIZE
    assert not read.judgements


def test_the_translation_may_be_a_fourth_row_and_commas_and_comments_are_understood(tmp_path, endoscope):
    write_folder(tmp_path, endoscope)
    R, t = endoscope.T_right_left[:3, :3], endoscope.T_right_left[:3, 3]
    np.savetxt(tmp_path / "calib.l2r.txt", np.vstack((R, t)))
    read = read_calibration(tmp_path, unit="mm", image_size=SIZE).calibration
    np.testing.assert_allclose(read.T_right_left, endoscope.T_right_left, atol=1e-15)
    (tmp_path / "calib.l2r.txt").write_text("# left to right\n1, 0, 0, -5 # x\n0, 1, 0, 0\n\n0, 0, 1, 0\n")
    read = read_calibration(tmp_path, unit="mm", image_size=SIZE).calibration
    np.testing.assert_array_equal(read.T_right_left[:3, 3], [-5, 0, 0])


@pytest.mark.parametrize("name", ["calib.left.intrinsics.txt", "calib.right.distortion.txt", "calib.l2r.txt"])
def test_a_missing_file_is_named(tmp_path, endoscope, name):
    (write_folder(tmp_path, endoscope, distortion_apart=True) / name).unlink()
    words = name.split(".")[1:-1]
    with pytest.raises(CalibrationError, match="the folder has no .*" + ".*".join(words)):
        read_calibration(tmp_path, unit=None, image_size=SIZE)


@pytest.mark.parametrize(
    "name,content,complaint",
    [
        ("calib.left.intrinsics.txt", "1 2\n3 4\n", "must hold three rows of three numbers"),
        ("calib.left.intrinsics.txt", "", "it is empty"),
        ("calib.left.intrinsics.txt", "a b c\n", "does not hold numbers only"),
        ("calib.left.intrinsics.txt", "800 0 nan\n0 800 270\n0 0 1\n0 0 0 0\n", "not a finite number"),
        ("calib.l2r.txt", "1 0 0\n0 1 0\n0 0 1\n", "must hold a 4x4 or 3x4 transform"),
        ("calib.l2r.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n-5 0 0 1\n", "last row of calib.l2r.txt must be 0 0 0 1"),
        ("other.left.intrinsics.txt", "1\n", "several .*left.*intrinsics"),
        ("calib.left.distortion.txt", "0 0 0 0 0\n", "both give the distortion"),
    ],
)
def test_a_file_of_the_wrong_form_is_named(tmp_path, endoscope, name, content, complaint):
    (write_folder(tmp_path, endoscope) / name).write_text(content)
    with pytest.raises(CalibrationError, match=complaint) as caught:
        read_calibration(tmp_path, unit=None, image_size=SIZE)
    assert name in str(caught.value)
