"""This project's own calibration file: JSON that the reader of named matrices reads back to the last digit."""

import json
from pathlib import Path

from schemas.messages import StereoCalibration
from shared.calibration.made import MADE, made_text
from shared.calibration.stated import CalibrationError
from shared.units import METRES_PER_UNIT, unit_name


def write_calibration(path: Path, calibration: StereoCalibration, made_ns: int | None = None) -> None:
    """Write a calibration as JSON, with the time at which it was made, since 1970, where that is known.

    Raises:
        CalibrationError: where its unit has no name, or the file cannot be written.
    """
    text = calibration_text(calibration, str(path), made_ns)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{path}: it cannot be written ({error.strerror})") from None


def calibration_text(calibration: StereoCalibration, name: str, made_ns: int | None = None) -> str:
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
    if calibration.covariance is not None:
        content["covariance_of_errors"] = calibration.covariance.tolist()
    content |= {} if made_ns is None else {MADE: made_text(made_ns)}
    lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in content.items())
    return f"{{\n{lines}\n}}\n"
