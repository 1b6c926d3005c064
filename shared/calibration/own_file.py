"""This project's own calibration file: JSON that the reader of named matrices reads back to the last digit.

The forms that others read are written too: OpenCV's FileStorage and two camera_info of ROS.
"""

import json
from pathlib import Path

import numpy as np

from schemas.messages import StereoCalibration
from shared.calibration.estimation.projection import rectifying
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


def opencv_text(calibration: StereoCalibration, made_ns: int | None = None) -> str:
    """YAML as FileStorage writes it, with the names of OpenCV's stereo sample, and the unit and when it was made beside
    them.
    """
    unit = unit_name(calibration.metres_per_unit)
    matrices = {
        "K1": calibration.K_left,
        "D1": calibration.distortion_left[None],
        "K2": calibration.K_right,
        "D2": calibration.distortion_right[None],
        "R": calibration.T_right_left[:3, :3],
        "T": calibration.T_right_left[:3, 3:],
    }
    lines = ["%YAML:1.0", "---", f"image_width: {calibration.image_width}", f"image_height: {calibration.image_height}"]
    lines += [f"unit: {unit}"] if unit else []
    lines += [] if made_ns is None else [f'{MADE}: "{made_text(made_ns)}"']
    for name, value in matrices.items():
        lines += [f"{name}: !!opencv-matrix", f"   rows: {value.shape[0]}", f"   cols: {value.shape[1]}", "   dt: d"]
        lines.append(f"   data: {_numbers(value)}")
    return "\n".join(lines) + "\n"


def camera_info_texts(calibration: StereoCalibration) -> tuple[str, str]:
    """The left and the right camera_info, as camera_calibration of ROS saves them; lengths in metres.

    Raises:
        CalibrationError: where the calibration has no unit, since ROS knows metres alone.
    """
    if calibration.metres_per_unit is None:
        raise CalibrationError("ROS counts in metres, and the calibration's unit is unknown; name it with --unit")
    R_l, R_r, P_l, P_r = rectifying(calibration)
    P_r = P_r.copy()
    P_r[0, 3] *= calibration.metres_per_unit
    left = _camera_info(calibration, "left", calibration.K_left, calibration.distortion_left, R_l, P_l)
    return left, _camera_info(calibration, "right", calibration.K_right, calibration.distortion_right, R_r, P_r)


def _camera_info(
    calibration: StereoCalibration, side: str, K: np.ndarray, distortion: np.ndarray, R: np.ndarray, P: np.ndarray
) -> str:
    lines = [f"image_width: {calibration.image_width}", f"image_height: {calibration.image_height}"]
    lens = distortion if len(distortion) else np.zeros(5)
    lines += [f"camera_name: {side}", f"distortion_model: {'plumb_bob' if len(lens) <= 5 else 'rational_polynomial'}"]
    for name, value in (
        ("camera_matrix", K),
        ("distortion_coefficients", lens[None]),
        ("rectification_matrix", R),
        ("projection_matrix", P),
    ):
        lines += [f"{name}:", f"  rows: {value.shape[0]}", f"  cols: {value.shape[1]}", f"  data: {_numbers(value)}"]
    return "\n".join(lines) + "\n"


def _numbers(value: np.ndarray) -> str:
    """Every digit of each number, always with a point, which YAML 1.1 wants to see in a number with an exponent."""
    return f"[{', '.join(_number(float(number)) for number in value.ravel())}]"


def _number(number: float) -> str:
    text = repr(number)
    mantissa, _, exponent = text.partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}{f'e{exponent}' if exponent else ''}"
