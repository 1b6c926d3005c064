"""Agents from the configuration of a rig; each kind loads what it is made of alone, for all together take a second."""

from agents.cli.rig.config import (
    ArmSection,
    CameraSection,
    PerceptionSection,
    PlannerSection,
    RigConfig,
    SimulatorSection,
)
from agents.cli.rig.other_arms import other_arms
from schemas.topics import MAIN
from shared.runtime.agent import Agent
from shared.runtime.config import ConfigError
from shared.runtime.session import SessionSettings


def build(rig: RigConfig, kind: str, instance: str) -> Agent:
    """The agent of a kind and instance, as the rig's configuration says.

    Raises:
        ConfigError: where the configuration has no section for it.
        SourceError, ImageFileError, CalibrationError: where a camera has nothing to show.
    """
    if kind == "robot_bridge" and instance not in rig.robot:
        raise ConfigError(f"the configuration has no arm {instance!r}; its arms: {', '.join(rig.robot) or 'none'}")
    section = rig.robot[instance] if kind == "robot_bridge" else getattr(rig, kind)
    match section:
        case CameraSection():
            from agents.cli.rig.camera_builder import built_camera

            return built_camera(section, SessionSettings(rig.rig, section.endpoint or "", rig.identity_of("camera")))
        case PerceptionSection() if instance != MAIN:
            from agents.cli.rig.perception_builder import built_tool_tracker

            return built_tool_tracker(section, instance)
        case PerceptionSection():
            from agents.cli.rig.perception_builder import built_perception

            return built_perception(section, rig.needs_matching)
        case PlannerSection():
            from agents.planner.agent import Planner
            from agents.planner.config import PlannerConfig

            return Planner(
                PlannerConfig(
                    least_probability=section.least_probability,
                    policy_model=section.policy_model,
                    tool_error_m=1e-3 * section.tool_error_mm,
                    hand_eye_error_m=1e-3 * section.hand_eye_error_mm,
                    attempts=section.attempts,
                    press_m=1e-3 * section.press_mm,
                    tissue_required=section.tissue_required,
                ),
                others=other_arms(rig),
            )
        case ArmSection():
            from agents.cli.rig.robot_bridge_builder import built_robot_bridge

            return built_robot_bridge(rig, instance, section)
        case SimulatorSection():
            from agents.simulator.agent import Simulator, SimulatorConfig

            return Simulator(SimulatorConfig(**section.model_dump()))
        case None:
            raise ConfigError(f"the configuration has no section [{kind}]; add one, or run that agent elsewhere")
        case _:
            from agents.reconstruction.agent import Reconstruction

            return Reconstruction(section.method, section.tracking)
