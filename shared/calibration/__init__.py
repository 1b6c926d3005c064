"""Stereo calibrations as laboratories have them on disk, read into one form and judged."""

from shared.calibration.own_file import write_calibration
from shared.calibration.reader import ReadCalibration, read_calibration
from shared.calibration.stated import CalibrationError

__all__ = ["CalibrationError", "ReadCalibration", "read_calibration", "write_calibration"]
