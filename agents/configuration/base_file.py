"""Where an arm's base is, out of the file that a rig's configuration names."""

from dataclasses import replace
from datetime import UTC, datetime, time
from pathlib import Path

import numpy as np

from agents.configuration.sections import ArmSection
from shared.calibration import CalibrationError
from shared.calibration.hand_eye.file import Axes, HandEye, Reference, implausible, read_hand_eye
from shared.calibration.made import NS_PER_S, made_ns
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.runtime.config import ConfigError


def base_of(arm: str, section: ArmSection) -> HandEye:
    """Where the base of an arm is: as told, as in its file, or else the simulated arm's own place.

    Raises:
        ConfigError: where the file is none, is of another arm or calibration, or tells the base from an ECM, which only
            a console has; and where a real arm's base is told where none can be.
    """
    found = _typed_in(arm, section) if section.T_camera_base_file is None else _in_file(arm, section)
    said = section.T_camera_base_calibration or ""
    if said and found.calibration_id and said != found.calibration_id:
        other = f"its file says {found.calibration_id}, and T_camera_base_calibration {said}"
        raise ConfigError(f"robot.{arm}: {other}; keep what the file says, or register anew")
    return replace(found, calibration_id=found.calibration_id or said)


def registered_ns(section: ArmSection) -> int | None:
    """When an arm was registered (ns since 1970, UTC), as its section or its file says; None where neither does.

    Where both do the earlier one counts: a day that is typed in makes no file younger.
    """
    in_file = None if section.T_camera_base_file is None else made_ns((section.T_camera_base_file,))
    if section.T_camera_base_made is None:
        return in_file
    typed_in = round(datetime.combine(section.T_camera_base_made, time(), UTC).timestamp()) * NS_PER_S
    return typed_in if in_file is None else min(typed_in, in_file)


def _typed_in(arm: str, section: ArmSection) -> HandEye:
    if section.T_camera_base is None:
        if arm not in SIMULATED_BASES:
            raise ConfigError(f"robot.{arm} needs T_camera_base: only {' and '.join(SIMULATED_BASES)} have a place")
        return HandEye(SIMULATED_BASES[arm])
    found = HandEye(np.array(section.T_camera_base))
    if section.dvrk is not None and (wrong := implausible(found.T)):
        raise ConfigError(f"robot.{arm}.T_camera_base: {wrong}; write metres, from the arm's own registration")
    return found


def _in_file(arm: str, section: ArmSection) -> HandEye:
    axes = None if section.T_camera_base_axes is None else Axes(section.T_camera_base_axes)
    try:
        found = read_hand_eye(section.T_camera_base_file or Path(), axes)
    except CalibrationError as error:
        raise ConfigError(f"robot.{arm}.T_camera_base_file: {error}") from None
    if found.reference is Reference.ECM_BASE and section.dvrk is None:
        raise ConfigError(f"robot.{arm}.T_camera_base_file: it tells the base from an ECM, which needs backend 'dvrk'")
    if section.dvrk is not None and found.arm not in ("", section.dvrk.arm):
        other = f"{section.T_camera_base_file} is of {found.arm}, and this arm is {section.dvrk.arm} of its console"
        raise ConfigError(f"robot.{arm}.T_camera_base_file: {other}; name the file of its own")
    return found
