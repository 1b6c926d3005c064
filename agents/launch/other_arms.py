"""Arms that are no PSM, from the files that describe them."""

import tomllib
from pathlib import Path

import numpy as np

from agents.configuration.hosts import run_name
from agents.configuration.rig import RigConfig
from shared.kinematics.arm import JOINTS
from shared.kinematics.dh import DhArm
from shared.kinematics.dh_file import read_dh
from shared.runtime.config import ConfigError


def other_arms(rig: RigConfig) -> dict[str, DhArm]:
    """The geometry of the arms that are no PSM, where their files are on this machine."""
    files = {arm: section.kinematics for arm, section in rig.robot.items() if section.kinematics is not None}
    return {
        arm: other_arm(path)[0]
        for arm, path in files.items()
        if path.exists() or rig.runs_here(run_name("robot_bridge", arm))
    }


def other_arm(path: Path) -> tuple[DhArm, tuple[float, ...]]:
    """Kinematics and joints to begin with of an arm that a file describes."""
    try:
        told = tomllib.loads(path.read_text())
        arm, start = read_dh(told), tuple(float(value) for value in told["start"])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path} describes no arm: {error}") from None
    if len(start) != JOINTS or arm.problems(np.array(start)):
        raise ConfigError(f"start of {path} must be {JOINTS} joints within their limits")
    return arm, start
