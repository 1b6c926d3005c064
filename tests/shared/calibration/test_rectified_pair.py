import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shared.calibration import CalibrationError, read_calibration

K = [[1000.0, 0.0, 479.5], [0.0, 1000.0, 269.5], [0.0, 0.0, 1.0]]


def write(path: Path, **changes: Any) -> Path:
    content: dict[str, Any] = {
        "name": "scene",
        "width": 960,
        "height": 540,
        "K": K,
        "baseline_mm": 5.5,
        "post": {"blur": 0.6},
    }
    content.update(changes)
    path.write_text(json.dumps({name: value for name, value in content.items() if value is not None}))
    return path


@pytest.mark.parametrize(
    "baseline,metres",
    [
        ({"baseline_mm": 5.5}, 1e-3),
        ({"baseline_m": 0.0055}, 1.0),
        ({"baseline": 5.5, "unit": "mm"}, 1e-3),
        ({"baseline": 5.5, "unit": None}, None),
        ({"baseline": 5.5}, None),
    ],
)
def test_the_right_camera_sits_one_baseline_along_x(tmp_path, baseline, metres):
    path = write(tmp_path / "scene.json", **{"baseline_mm": None, **baseline})
    calibration = read_calibration(path, unit=None, image_size=(960, 540)).calibration
    right_camera_in_left = np.linalg.inv(calibration.T_right_left) @ [0, 0, 0, 1]
    length = next(value for name, value in baseline.items() if name != "unit")
    np.testing.assert_array_equal(right_camera_in_left, [length, 0, 0, 1])
    np.testing.assert_array_equal(calibration.K_left, K)
    np.testing.assert_array_equal(calibration.K_right, K)
    assert not calibration.distortion_left.any()
    assert calibration.metres_per_unit == metres


@pytest.mark.parametrize(
    "changes,unit,complaint",
    [
        ({}, "m", "lengths in mm, which contradicts --unit m"),
        ({"unit": "m"}, None, "baseline_mm is in mm, but its unit says m"),
        ({"baseline_mm": -5.5}, None, "baseline_mm must be one positive number"),
        ({"baseline_mm": [1, 2]}, None, "baseline_mm must be one positive number, but is 2 numbers"),
        ({"baseline_mm": "long"}, None, "baseline_mm does not hold numbers only"),
        ({"D": [0.1, 0, 0, 0]}, None, "rectified pair, which has no distortion"),
        ({"width": 0}, None, "width must be one positive whole number"),
        ({"K": None}, None, "it has no left camera matrix"),
        ({"baseline_mm": None}, None, "it has no baseline .usually called baseline_mm, beside the one camera matrix"),
        ({"baseline_mm": None, "basline_mm": 5.5}, None, "no baseline .* where basline_mm may be misspelt"),
    ],
)
def test_what_contradicts_itself_is_refused(tmp_path, changes, unit, complaint):
    with pytest.raises(CalibrationError, match=complaint):
        read_calibration(write(tmp_path / "scene.json", **changes), unit=unit, image_size=(960, 540))
