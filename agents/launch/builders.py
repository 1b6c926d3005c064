"""Agents from the configuration of a rig; each kind loads what it is made of alone, for all together take a second."""

import importlib
from collections.abc import Callable
from typing import Any, get_type_hints

from agents.configuration.rig import (
    ArmSection,
    CameraSection,
    PerceptionSection,
    PlannerSection,
    ReconstructionSection,
    RigConfig,
)
from agents.launch.other_arms import other_arms
from agents.registry import (
    CAMERA,
    NEEDLE,
    PERCEPTION,
    PLANNER,
    RECONSTRUCTION,
    ROBOT_BRIDGE,
    Kind,
    kind_of,
)
from shared.runtime.agent import Agent
from shared.runtime.config import ConfigError
from shared.runtime.session import SessionSettings


def build(rig: RigConfig, kind: str, instance: str) -> Agent:
    """The agent of a kind and instance, as the rig's configuration says.

    Raises:
        ConfigError: where the configuration has no section for it.
        SourceError, ImageFileError, CalibrationError: where a camera has nothing to show.
    """
    row = kind_of(kind)
    if row is ROBOT_BRIDGE and instance not in rig.robot:
        raise ConfigError(f"the configuration has no arm {instance!r}; its arms: {', '.join(rig.robot) or 'none'}")
    section = rig.section_of(row, instance) if row in _BUILT or (row is not None and row.agent) else None
    if row is None or section is None:
        name = f"{kind}.{instance}" if row is not None and row.per_arm else kind
        raise ConfigError(f"the configuration has no section [{name}]; add one, or run that agent elsewhere")
    return _plain(row, instance, section) if row.agent else _BUILT[row](rig, instance, section)


def _camera(rig: RigConfig, _: str, section: CameraSection) -> Agent:
    from agents.launch.camera_builder import built_camera

    return built_camera(section, SessionSettings(rig.rig, section.endpoint or "", rig.identity_of("camera")))


def _perception(rig: RigConfig, _: str, section: PerceptionSection) -> Agent:
    from agents.perception.agent import Perception, PerceptionConfig
    from agents.perception.segmentation.promptable_model import PromptableFileError, PromptableFiles

    files = section.promptable_encoder, section.promptable_decoder
    hashes = section.promptable_encoder_sha256, section.promptable_decoder_sha256
    config = PerceptionConfig(
        segmenter=None if section.segmenter == "auto" else section.segmenter,
        # unset it is as the method of reconstruction needs it
        matching=rig.needs_matching if section.matching is None else section.matching,
        needle=rig.section_of(NEEDLE) is not None,
        promptable=None if files[0] is None or files[1] is None else PromptableFiles(files[0], files[1], *hashes),
    )
    try:
        return Perception(config)
    except PromptableFileError as error:
        raise ConfigError(f"[perception] {error}") from None


def _reconstruction(_: RigConfig, __: str, section: ReconstructionSection) -> Agent:
    from agents.reconstruction.agent import Reconstruction

    return Reconstruction(section.method, section.tracking)


def _planner(rig: RigConfig, _: str, section: PlannerSection) -> Agent:
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


def _robot_bridge(rig: RigConfig, instance: str, section: ArmSection) -> Agent:
    from agents.launch.robot_bridge_builder import built_robot_bridge

    return built_robot_bridge(rig, instance, section)


def _plain(row: Kind, instance: str, section: Any) -> Agent:
    """An agent whose section has the fields of its configuration, beside the name of its arm."""
    module, _, name = row.agent.partition(":")
    made = getattr(importlib.import_module(module), name)
    arm = {"arm": instance} if row.per_arm else {}
    return made(get_type_hints(made)["config"](**arm, **section.model_dump()))


_BUILT: dict[Kind, Callable[..., Agent]] = {
    CAMERA: _camera,
    PERCEPTION: _perception,
    RECONSTRUCTION: _reconstruction,
    PLANNER: _planner,
    ROBOT_BRIDGE: _robot_bridge,
}
