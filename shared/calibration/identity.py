"""A name for a calibration, by which a frame says which one it was taken with."""

import dataclasses
import hashlib

from schemas.codec import encode
from schemas.messages import StereoCalibration


def calibration_id(calibration: StereoCalibration) -> str:
    """A short name of a calibration that changes whenever one of the numbers does by which it measures."""
    numbers = dataclasses.replace(calibration, consumed=(), covariance=None)
    return hashlib.sha256(encode(numbers)).hexdigest()[:12]
