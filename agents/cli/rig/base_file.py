"""Where an arm's base is, out of the file that a rig's configuration names."""

import numpy as np

from agents.cli.rig.sections import ArmSection
from shared.calibration import CalibrationError
from shared.calibration.hand_eye.file import Axes, HandEye, Reference, read_hand_eye
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.runtime.config import ConfigError


def base_of(arm: str, section: ArmSection) -> HandEye:
    """Where the base of an arm is: as told, as in its file, or else the simulated arm's own place.

    Raises:
        ConfigError: where the file is none, or tells the base from an ECM, which only a console has.
    """
    if section.T_camera_base_file is None:
        if section.T_camera_base is None and arm not in SIMULATED_BASES:
            raise ConfigError(f"robot.{arm} needs T_camera_base: only {' and '.join(SIMULATED_BASES)} have a place")
        return HandEye(SIMULATED_BASES[arm] if section.T_camera_base is None else np.array(section.T_camera_base))
    axes = None if section.T_camera_base_axes is None else Axes(section.T_camera_base_axes)
    try:
        found = read_hand_eye(section.T_camera_base_file, axes)
    except CalibrationError as error:
        raise ConfigError(f"robot.{arm}.T_camera_base_file: {error}") from None
    if found.reference is Reference.ECM_BASE and section.dvrk is None:
        raise ConfigError(f"robot.{arm}.T_camera_base_file: it tells the base from an ECM, which needs backend 'dvrk'")
    return found
