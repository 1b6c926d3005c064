"""Where an arm's base is, out of the file that a rig's configuration names."""

from dataclasses import replace
from datetime import UTC, datetime, time

import numpy as np

from agents.cli.rig.sections import ArmSection
from shared.calibration import CalibrationError
from shared.calibration.hand_eye.file import Axes, HandEye, Reference, read_hand_eye
from shared.calibration.made import NS_PER_S, made_ns
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.runtime.config import ConfigError


def base_of(arm: str, section: ArmSection) -> HandEye:
    """Where the base of an arm is: as told, as in its file, or else the simulated arm's own place.

    Raises:
        ConfigError: where the file is none, or tells the base from an ECM, which only a console has.
    """
    said = section.T_camera_base_calibration or ""
    if section.T_camera_base_file is None:
        if section.T_camera_base is None and arm not in SIMULATED_BASES:
            raise ConfigError(f"robot.{arm} needs T_camera_base: only {' and '.join(SIMULATED_BASES)} have a place")
        T = SIMULATED_BASES[arm] if section.T_camera_base is None else np.array(section.T_camera_base)
        return HandEye(T, calibration_id=said)
    axes = None if section.T_camera_base_axes is None else Axes(section.T_camera_base_axes)
    try:
        found = read_hand_eye(section.T_camera_base_file, axes)
    except CalibrationError as error:
        raise ConfigError(f"robot.{arm}.T_camera_base_file: {error}") from None
    if found.reference is Reference.ECM_BASE and section.dvrk is None:
        raise ConfigError(f"robot.{arm}.T_camera_base_file: it tells the base from an ECM, which needs backend 'dvrk'")
    if said and found.calibration_id and said != found.calibration_id:
        other = f"its file says {found.calibration_id}, and T_camera_base_calibration {said}"
        raise ConfigError(f"robot.{arm}: {other}; keep what the file says, or register anew")
    return replace(found, calibration_id=found.calibration_id or said)


def registered_ns(section: ArmSection) -> int | None:
    """When an arm was registered, as its section or its file says; None where neither does."""
    if section.T_camera_base_made is not None:
        return round(datetime.combine(section.T_camera_base_made, time(), UTC).timestamp()) * NS_PER_S
    return None if section.T_camera_base_file is None else made_ns((section.T_camera_base_file,))
