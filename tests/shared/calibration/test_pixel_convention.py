from dataclasses import replace

import numpy as np
import pytest

from schemas.messages import StereoCalibration
from shared.calibration import read_calibration
from shared.calibration.own_file import write_calibration
from shared.calibration.pixel_convention import counted_from_centres

K = np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])
T = np.eye(4)
T[0, 3] = -5.0
IDEAL = StereoCalibration(640, 480, K, K, np.zeros(5), np.zeros(5), T, None)


def test_the_middle_of_the_image_is_between_its_middle_pixels():
    moved, judgements = counted_from_centres(IDEAL)
    for camera_matrix in (moved.K_left, moved.K_right):
        np.testing.assert_array_equal(camera_matrix[:2, 2], [319.5, 239.5])
        np.testing.assert_array_equal(camera_matrix[:2, :2], K[:2, :2])
    assert [judgement.code for judgement in judgements] == ["pixels_from_corners"]


@pytest.mark.parametrize(
    "estimated",
    [
        replace(IDEAL, K_right=K + np.array([[0, 0, 0.25], [0, 0, 0], [0, 0, 0]])),
        replace(IDEAL, distortion_left=np.array([0.1, 0.0, 0.0, 0.0, 0.0])),
        replace(IDEAL, K_left=np.array([[800.0, 0.0, 319.5], [0.0, 800.0, 239.5], [0.0, 0.0, 1.0]])),
    ],
)
def test_what_was_estimated_stays(estimated):
    assert counted_from_centres(estimated) == (estimated, ())


def test_our_own_file_comes_back_as_it_was(tmp_path):
    write_calibration(tmp_path / "ideal.json", IDEAL)
    read = read_calibration(tmp_path / "ideal.json", unit=None, image_size=(640, 480))
    np.testing.assert_array_equal(read.calibration.K_left, K)
