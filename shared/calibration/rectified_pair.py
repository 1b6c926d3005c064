"""Rectified pairs: one camera matrix for both cameras, and a baseline along x, as simulated scenes come with."""

import numpy as np

from shared.calibration.named_matrices import NamedEntries, stated_size, stated_unit
from shared.calibration.numbers import array, matrix, shape_text
from shared.calibration.stated import CalibrationError, StatedCalibration

_UNIT_IN_NAME = {"baseline_mm": "mm", "baseline_m": "m", "baselinemm": "mm"}


def is_rectified_pair(entries: NamedEntries) -> bool:
    """Whether the entries are a camera matrix with a baseline rather than two cameras."""
    return "baseline" in entries and "camera matrix" in entries and "left camera matrix" not in entries


def rectified_pair(entries: NamedEntries) -> StatedCalibration:
    """What a camera matrix with a baseline states; the right camera sits that far along +x.

    Raises:
        CalibrationError: where the baseline is no positive number, the units contradict, or there is distortion.
    """
    K = matrix(*entries.entry("camera matrix", "K"), 3, 3)
    node, name = entries.entry("baseline", "baseline_mm")
    baseline = array(node, name)
    if baseline.size != 1 or baseline.item() <= 0:
        told = f"{baseline.item():g}" if baseline.size == 1 else shape_text(baseline)
        raise CalibrationError(f"{name} must be one positive number, but is {told}")
    if "distortion" in entries and array(*entries.entry("distortion", "D")).any():
        raise CalibrationError("a camera matrix with a baseline is a rectified pair, which has no distortion")
    return StatedCalibration(
        K_left=K,
        K_right=K.copy(),
        distortion_left=np.zeros(0),
        distortion_right=np.zeros(0),
        R_right_left=np.eye(3),
        t_right_left=np.array([-baseline.item(), 0, 0]),
        size=stated_size(entries),
        unit=_unit(name, stated_unit(entries)),
    )


def _unit(name: str, stated: str | None) -> str | None:
    named = _UNIT_IN_NAME.get(name.lower())
    if named and stated and named != stated:
        raise CalibrationError(f"{name} is in {named}, but its unit says {stated}; keep the right one")
    return named or stated
