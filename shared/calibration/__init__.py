"""Stereo calibrations as laboratories have them on disk, read into one form and judged."""

from shared.calibration.own_file import write_calibration
from shared.calibration.reader import ReadCalibration, calibration_of_camera_infos, read_calibration
from shared.calibration.stated import CalibrationError, OtherSizeError

__all__ = [
    "CalibrationError",
    "OtherSizeError",
    "ReadCalibration",
    "calibration_of_camera_infos",
    "read_calibration",
    "write_calibration",
]
