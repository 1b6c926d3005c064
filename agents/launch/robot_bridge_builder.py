"""The bridge to an arm, simulated or real, as a rig's configuration says."""

import dataclasses
import hashlib

import numpy as np

from agents.configuration.base_file import base_of, registered_ns
from agents.configuration.hosts import run_name
from agents.configuration.jaw_file import jaw_zero_of
from agents.configuration.rig import ArmSection, RigConfig
from agents.launch.other_arms import other_arm
from agents.registry import TOOL_TRACKER
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.correction import CorrectionLimits
from agents.robot_bridge.limits import PSM_JOINT_SPEEDS, MotionLimits
from agents.robot_bridge.simulated import SimulatedPsm, waiting
from schemas.topics import ROBOT_STATE
from shared.calibration.hand_eye.file import Reference
from shared.runtime.session import SessionSettings

RESTING_HZ = ROBOT_STATE.resting_hz or 5.0
REGISTERED = "registered"
"""The folder of what has moved since an arm was registered, a file for each registration."""
LOOKED_AT_HZ = 10.0
"""Turns of an arm at rest whose instrument is looked for: a look waits for a state that is as new as its frame."""


def built_robot_bridge(rig: RigConfig, arm: str, section: ArmSection) -> RobotBridge:
    """The bridge to one arm.

    Raises:
        ConfigError, CalibrationError: where a file that the section names cannot be used.
    """
    base = base_of(arm, section)
    # an arm whose base is told from the ECM is not ready before that is heard
    T_camera_base = base.before_camera(np.eye(4) if base.reference is Reference.ECM_BASE else None)
    config = RobotBridgeConfig(
        arm,
        T_camera_base,
        resting_hz=LOOKED_AT_HZ if arm in rig.arms_of(TOOL_TRACKER) else RESTING_HZ,
        maximum_plan_age_s=section.maximum_plan_age_s,
        limits=MotionLimits(joint_speeds=None if section.kinematics else PSM_JOINT_SPEEDS).slowed(section.speed_share),
        correction=correction_limits(section),
        calibration_id=base.calibration_id,
        maximum_frame_age_s=section.maximum_frame_age_s,
        maximum_motion_s=section.maximum_motion_s,
        registered_ns=registered_ns(section) or 0,
        registration_days=section.T_camera_base_days,
        jaw_zero=jaw_zero_of(arm, section),
        jaw_days=section.jaw_days,
        tissue_needed=section.dvrk is not None and "tissue" not in section.dvrk.has_no,
    )
    if section.kinematics is not None:
        kinematics, start = other_arm(section.kinematics)
        return RobotBridge(config, SimulatedPsm(start, kinematics=kinematics))
    if section.dvrk is None:
        return RobotBridge(config, SimulatedPsm(waiting(T_camera_base)))
    # reading ROS messages takes as long to load as all else
    from agents.launch.audit import audit_of, state_folder
    from agents.launch.audited_bridge import AuditedBridge
    from agents.launch.guard_process import naming_of
    from agents.robot_bridge.dvrk.frames_moved import SinceRegistration
    from agents.robot_bridge.dvrk.psm import DvrkPsm

    told = section.dvrk
    of = rig.rig, base.reference.name, config.registered_ns, base.calibration_id, np.ravel(base.T).tolist()
    folder = state_folder(rig, section.T_camera_base_file).resolve() / REGISTERED
    since = SinceRegistration(folder / f"{arm}-{hashlib.sha256(repr(of).encode()).hexdigest()[:12]}.json")
    reached = SessionSettings(rig.rig, told.endpoint, rig.identity_of(run_name("robot_bridge", arm)))
    backend = DvrkPsm(
        told.arm, reached, naming_of(told), told.tool, told.dry_run, base=base, has_no=told.has_no, since=since
    )
    audit = audit_of(rig, run_name("robot_bridge", arm))
    return AuditedBridge(dataclasses.replace(config, tick_hz=told.set_point_hz), backend, audit)


def correction_limits(section: ArmSection) -> CorrectionLimits | None:
    """How far the images may correct where an arm's base is; None where they do not."""
    if section.correction == "none":
        return None
    return CorrectionLimits(1e-3 * section.correction_limit_mm, float(np.radians(section.correction_limit_deg)))
