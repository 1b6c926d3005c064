"""The published files, and the board that was photographed with one of them."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from shared.calibration import CalibrationError, read_calibration

DATA = Path(__file__).parents[3] / "../shared/data"
BOARD = (13, 8)
STORZ_SIZE = (1920, 1080)

pytestmark = pytest.mark.skipif(
    not DATA.is_dir() and "CI" not in os.environ, reason="the folder shared/data does not stand beside the checkout"
)


@pytest.mark.parametrize(
    ("name", "size", "baseline", "metres", "codes"),
    [
        ("ucsd_thread/real/calibration.yaml", (640, 480), 5.908927288994923, None, ["unit_unknown"]),
        (
            "ucsd_thread/sim/calibration_scenes_1_3.yaml",
            (640, 480),
            0.1,
            None,
            ["pixels_from_corners", "unit_unknown"],
        ),
        ("renders/sample_00.json", (960, 540), 5.5, 1e-3, []),
    ],
)
def test_published_calibrations_are_read_in_their_unit_and_for_their_images(name, size, baseline, metres, codes):
    read = read_calibration(DATA / name, unit=None, image_size=size)
    np.testing.assert_array_equal(read.calibration.T_right_left[:3, 3], [-baseline, 0, 0])
    assert read.calibration.metres_per_unit == metres
    assert [judgement.code for judgement in read.judgements] == codes
    with pytest.raises(CalibrationError, match="these are 1280x480"):
        read_calibration(DATA / name, unit=None, image_size=(1280, 480))


@pytest.mark.renders
def test_corners_of_a_photographed_board_lie_on_one_row_after_rectification():
    read = read_calibration(DATA / "storz_calibration", unit="mm", image_size=STORZ_SIZE)
    assert not read.judgements
    c = read.calibration
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        *(c.K_left, c.distortion_left, c.K_right, c.distortion_right, STORZ_SIZE),
        *(c.T_right_left[:3, :3], c.T_right_left[:3, 3:]),
    )
    found = []
    for side, K, D, R, P in (
        ("left", c.K_left, c.distortion_left, R1, P1),
        ("right", c.K_right, c.distortion_right, R2, P2),
    ):
        pixels = cv2.imread(str(DATA / f"storz_calibration/calib.{side}.images.0.png"), cv2.IMREAD_GRAYSCALE)
        assert pixels is not None
        seen, corners = cv2.findChessboardCornersSB(pixels, BOARD)
        assert seen, f"the chessboard must be found in the {side} image"
        found.append(cv2.undistortPoints(corners, K, D, R=R, P=P)[:, 0])
    left, right = found
    assert np.median(np.abs(left[:, 1] - right[:, 1])) < 0.3
    assert np.abs(left[:, 1] - right[:, 1]).max() < 0.7
    assert (left[:, 0] > right[:, 0]).all()
    homogeneous = cv2.triangulatePoints(P1, P2, left.T, right.T)
    board = (homogeneous[:3] / homogeneous[3]).T.reshape(BOARD[1], BOARD[0], 3)
    sides = np.linalg.norm(np.diff(board, axis=1), axis=2).mean(), np.linalg.norm(np.diff(board, axis=0), axis=2).mean()
    assert sides[0] == pytest.approx(sides[1], rel=0.03)
