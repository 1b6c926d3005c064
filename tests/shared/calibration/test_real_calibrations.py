"""The published files, and the board that was photographed with one of them."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from schemas.messages import StereoCalibration
from shared.calibration import CalibrationError, read_calibration

DATA = Path(__file__).parents[3] / "../shared/data"
BOARD = (13, 8)
STORZ_SIZE = (1920, 1080)

pytestmark = pytest.mark.skipif(
    not DATA.is_dir() and "CI" not in os.environ, reason="the folder shared/data does not stand beside the checkout"
)


@pytest.mark.parametrize(
    "name,baseline",
    [
        ("real/calibration.yaml", 5.908927288994923),
        ("sim/calibration_scenes_1_3.yaml", 0.1),
        ("sim/calibration_scenes_5_7_9.yaml", 0.5),
    ],
)
def test_published_thread_data_is_read_in_its_unknown_unit(name, baseline):
    read = read_calibration(DATA / "ucsd_thread" / name, unit=None, image_size=(640, 480))
    np.testing.assert_array_equal(read.calibration.T_right_left[:3, 3], [-baseline, 0, 0])
    assert read.calibration.metres_per_unit is None
    ideal = ["pixels_from_corners"] if name.startswith("sim") else []
    assert [judgement.code for judgement in read.judgements] == [*ideal, "unit_unknown"]


def test_published_thread_calibration_is_not_for_other_images():
    with pytest.raises(CalibrationError, match="these are 1280x480"):
        read_calibration(DATA / "ucsd_thread/sim/calibration_scenes_1_3.yaml", unit=None, image_size=(1280, 480))


def test_rendered_scenes_are_read_in_millimetres():
    read = read_calibration(DATA / "renders/sample_00.json", unit=None, image_size=(960, 540))
    assert read.calibration.T_right_left[0, 3] == -5.5
    assert read.calibration.metres_per_unit == 1e-3
    assert not read.judgements


@pytest.fixture(scope="module")
def storz() -> StereoCalibration:
    read = read_calibration(DATA / "storz_calibration", unit="mm", image_size=STORZ_SIZE)
    assert not read.judgements
    return read.calibration


def rectified_corners(c: StereoCalibration, image: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Corners of the chessboard in both rectified images (n 2), and the projections of both cameras (3 4)."""
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        *(c.K_left, c.distortion_left, c.K_right, c.distortion_right, STORZ_SIZE),
        *(c.T_right_left[:3, :3], c.T_right_left[:3, 3:]),
    )
    eyes = (("left", c.K_left, c.distortion_left, R1, P1), ("right", c.K_right, c.distortion_right, R2, P2))
    found: list[np.ndarray] = []
    for side, K, distortion, R, P in eyes:
        path = DATA / f"storz_calibration/calib.{side}.images.{image}.png"
        pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert pixels is not None, f"{path.name} must be readable"
        seen, corners = cv2.findChessboardCornersSB(pixels, BOARD)
        assert seen, f"the chessboard must be found in {path.name}"
        found.append(cv2.undistortPoints(corners, K, distortion, R=R, P=P)[:, 0])
    return found[0], found[1], P1, P2


@pytest.mark.renders
def test_corners_of_a_photographed_board_lie_on_one_row_after_rectification(storz):
    left, right, P_left, P_right = rectified_corners(storz, 0)
    assert np.median(np.abs(left[:, 1] - right[:, 1])) < 0.3
    assert np.abs(left[:, 1] - right[:, 1]).max() < 0.7
    assert (left[:, 0] > right[:, 0]).all()
    homogeneous = cv2.triangulatePoints(P_left, P_right, left.T, right.T)
    board = (homogeneous[:3] / homogeneous[3]).T.reshape(BOARD[1], BOARD[0], 3)
    sides = np.linalg.norm(np.diff(board, axis=1), axis=2).mean(), np.linalg.norm(np.diff(board, axis=0), axis=2).mean()
    assert sides[0] == pytest.approx(sides[1], rel=0.03)
