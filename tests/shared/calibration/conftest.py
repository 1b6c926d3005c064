import json

import cv2
import numpy as np
import pytest

from shared.calibration import read_calibration
from tests.rigs import boards

SIZE = (960, 540)


@pytest.fixture(scope="session")
def endoscope():
    return boards.endoscope()


@pytest.fixture
def named(endoscope):
    """Its matrices by OpenCV's names."""
    T = endoscope.T_right_left
    matrices = {"K1": endoscope.K_left, "D1": endoscope.distortion_left, "K2": endoscope.K_right}
    matrices |= {"D2": endoscope.distortion_right, "R": T[:3, :3], "T": T[:3, 3]}
    return {name: value.tolist() for name, value in matrices.items()}


@pytest.fixture
def cameras(endoscope):
    """Both cameras as ROS writes them, by way of cv2.stereoRectify; in millimetres here."""

    def block(values):
        rows, cols = np.atleast_2d(values).shape
        return {"rows": rows, "cols": cols, "data": np.ravel(values).tolist()}

    c = endoscope
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        c.K_left, c.distortion_left, c.K_right, c.distortion_right, SIZE, c.T_right_left[:3, :3], c.T_right_left[:3, 3:]
    )
    parts = (c.K_left, c.distortion_left, R1, P1), (c.K_right, c.distortion_right, R2, P2)
    return [
        {
            "image_width": SIZE[0],
            "image_height": SIZE[1],
            "camera_name": "narrow_stereo",
            "distortion_model": "plumb_bob",
            "camera_matrix": block(K),
            "distortion_coefficients": block(D),
            "rectification_matrix": block(R),
            "projection_matrix": block(P),
        }
        for K, D, R, P in parts
    ]


@pytest.fixture
def text_matrices(endoscope):
    """Its matrices as a folder of plain text, by the names of the files."""

    def rows(*matrices):
        return "".join(" ".join(map(repr, row)) + "\n" for matrix in matrices for row in np.atleast_2d(matrix).tolist())

    c = endoscope
    return {
        "calib.left.intrinsics.txt": rows(c.K_left, c.distortion_left),
        "calib.right.intrinsics.txt": rows(c.K_right, c.distortion_right),
        "calib.l2r.txt": rows(c.T_right_left),
    }


@pytest.fixture
def write(tmp_path):
    """Write files, of text or of names with values, into a folder, and give their paths."""

    def written(**files):
        for name, held in files.items():
            lines = [held] if isinstance(held, str) else [f"{key}: {json.dumps(held[key])}\n" for key in held]
            (tmp_path / name).write_text("".join(lines))
        return tuple(tmp_path / name for name in files)

    return written


@pytest.fixture
def assert_read(endoscope):
    """What is read from a path, or two, is the endoscope."""

    def check(given):
        read = read_calibration(given, unit="mm", image_size=SIZE)
        for name in ("K_left", "K_right", "distortion_left", "distortion_right", "image_width", "metres_per_unit"):
            np.testing.assert_allclose(getattr(read.calibration, name), getattr(endoscope, name), atol=1e-12)
        np.testing.assert_allclose(read.calibration.T_right_left, endoscope.T_right_left, atol=1e-9)
        assert read.judgements == ()

    return check
