"""This project's own calibration file: JSON that the reader of named matrices reads back to the last digit."""

import json
from pathlib import Path

from schemas.messages import StereoCalibration
from shared.calibration.stated import CalibrationError
from shared.units import METRES_PER_UNIT, unit_name


def write_calibration(path: Path, calibration: StereoCalibration) -> None:
    """Write a calibration as JSON.

    Raises:
        CalibrationError: where its unit has no name, or the file cannot be written.
    """
    text = calibration_text(calibration, str(path))
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{path}: it cannot be written ({error.strerror})") from None


def calibration_text(calibration: StereoCalibration, name: str) -> str:
    """What such a file holds; `name` is what messages call it.

    Raises:
        CalibrationError: where its unit has no name.
    """
    unit = unit_name(calibration.metres_per_unit)
    if unit is None and calibration.metres_per_unit is not None:
        raise CalibrationError(
            f"{name}: a unit of {calibration.metres_per_unit:g} m has no name; known are {', '.join(METRES_PER_UNIT)}"
        )
    content = {
        "image_width": calibration.image_width,
        "image_height": calibration.image_height,
        "K_left": calibration.K_left.tolist(),
        "K_right": calibration.K_right.tolist(),
        "distortion_left": calibration.distortion_left.tolist(),
        "distortion_right": calibration.distortion_right.tolist(),
        "T_right_left": calibration.T_right_left.tolist(),
        "unit": unit,
    }
    lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in content.items())
    return f"{{\n{lines}\n}}\n"
