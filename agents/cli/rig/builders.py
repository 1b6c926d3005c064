"""Agents from the configuration of a rig."""

import dataclasses
import sys
from pathlib import Path

import numpy as np

from agents.camera.agent import Camera, CameraConfig, SceneCamera
from agents.camera.scene_source import SceneSource, calibration_of
from agents.camera.sources import ImageSource, Pair, PipeSource, Source, SourceError
from agents.camera.video import VideoSource
from agents.cli.rig.base_file import base_of
from agents.cli.rig.config import (
    ArmSection,
    CameraSection,
    PerceptionSection,
    PlannerSection,
    RigConfig,
    SimulatorSection,
)
from agents.cli.rig.hosts import run_name
from agents.cli.rig.other_arms import other_arm, other_arms
from agents.perception.agent import Perception, PerceptionConfig
from agents.perception.segmentation.promptable_model import PromptableFileError, PromptableFiles
from agents.perception.tool.agent import ToolTracker, ToolTrackerConfig
from agents.planner.agent import Planner
from agents.planner.config import PlannerConfig
from agents.reconstruction.agent import Reconstruction
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.correction import CorrectionLimits
from agents.robot_bridge.limits import MotionLimits
from agents.robot_bridge.simulated import SimulatedPsm, waiting
from agents.simulator.agent import Simulator, SimulatorConfig
from schemas.messages import ImageEncoding, Severity, SimulatorState, StereoCalibration
from schemas.topics import MAIN, ROBOT_STATE
from shared.calibration import CalibrationError, ReadCalibration, read_calibration
from shared.calibration.hand_eye.file import Reference
from shared.runtime.agent import Agent
from shared.runtime.config import ConfigError
from shared.runtime.session import SessionSettings

RESTING_HZ = ROBOT_STATE.resting_hz or 5.0
LOOKED_AT_HZ = 10.0
"""Turns of an arm at rest whose instrument is looked for: a look waits for a state that is as new as its frame."""
KINDS = ("camera", "perception", "reconstruction", "planner", "robot_bridge", "simulator")


def configured(rig: RigConfig) -> list[tuple[str, str]]:
    """Kind and instance of every agent that is to run on this machine, in the order of the dataflow."""
    sections = [(kind, MAIN) for kind in KINDS if kind != "robot_bridge" and getattr(rig, kind) is not None]
    tracked = rig.perception.track_tool if rig.perception is not None else ()
    agents = [*sections, *(("perception", arm) for arm in tracked), *(("robot_bridge", arm) for arm in rig.robot)]
    return [(kind, instance) for kind, instance in agents if rig.runs_here(run_name(kind, instance))]


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
            return _camera(section, SessionSettings(rig.rig, section.endpoint or "", rig.identity_of("camera")))
        case PerceptionSection() if instance != MAIN:
            return _tool_tracker(section, instance)
        case PerceptionSection():
            return _perception(section, rig.needs_matching)
        case PlannerSection():
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
            return _robot_bridge(rig, instance, section)
        case SimulatorSection():
            return Simulator(SimulatorConfig(**section.model_dump()))
        case None:
            raise ConfigError(f"the configuration has no section [{kind}]; add one, or run that agent elsewhere")
        case _:
            return Reconstruction(section.method, section.tracking)


def _robot_bridge(rig: RigConfig, arm: str, section: ArmSection) -> RobotBridge:
    base = base_of(arm, section)
    # an arm whose base is told from the ECM is not ready before that is heard
    T_camera_base = base.before_camera(np.eye(4) if base.reference is Reference.ECM_BASE else None)
    tracked = rig.perception.track_tool if rig.perception is not None else ()
    config = RobotBridgeConfig(
        arm,
        T_camera_base,
        resting_hz=LOOKED_AT_HZ if arm in tracked else RESTING_HZ,
        maximum_plan_age_s=section.maximum_plan_age_s,
        limits=MotionLimits().slowed(section.speed_share),
        correction=correction_limits(section),
        calibration_id=base.calibration_id,
    )
    if section.kinematics is not None:
        kinematics, start = other_arm(section.kinematics)
        return RobotBridge(config, SimulatedPsm(start, kinematics=kinematics))
    if section.dvrk is None:
        return RobotBridge(config, SimulatedPsm(waiting(T_camera_base)))
    # reading ROS messages takes as long to load as all else
    from agents.cli.running.audit import audit_of
    from agents.cli.running.audited_bridge import AuditedBridge
    from agents.cli.running.guard import naming_of
    from agents.robot_bridge.dvrk.psm import DvrkPsm

    told = section.dvrk
    reached = SessionSettings(rig.rig, told.endpoint, rig.identity_of(run_name("robot_bridge", arm)))
    backend = DvrkPsm(told.arm, reached, naming_of(told), told.tool, told.dry_run, told.through_guard, base=base)
    audit = audit_of(rig, run_name("robot_bridge", arm))
    return AuditedBridge(dataclasses.replace(config, tick_hz=told.set_point_hz), backend, audit)


def correction_limits(section: ArmSection) -> CorrectionLimits | None:
    """How far the images may correct where an arm's base is; None where they do not."""
    if section.correction == "none":
        return None
    return CorrectionLimits(1e-3 * section.correction_limit_mm, float(np.radians(section.correction_limit_deg)))


def perception_config(section: PerceptionSection, needs_matching: bool) -> PerceptionConfig:
    """What perception is told; whether it matches pixels is as the method of reconstruction needs it, if unset."""
    return PerceptionConfig(
        segmenter=None if section.segmenter == "auto" else section.segmenter,
        matching=needs_matching if section.matching is None else section.matching,
        promptable=promptable_files(section),
    )


def promptable_files(section: PerceptionSection) -> PromptableFiles | None:
    """Where the network lies that segmenter `promptable` runs; None where none is configured."""
    if section.promptable_encoder is None or section.promptable_decoder is None:
        return None
    return PromptableFiles(
        section.promptable_encoder,
        section.promptable_decoder,
        section.promptable_encoder_sha256,
        section.promptable_decoder_sha256,
    )


def _perception(section: PerceptionSection, needs_matching: bool) -> Agent:
    try:
        return Perception(perception_config(section, needs_matching))
    except PromptableFileError as error:
        raise ConfigError(f"[perception] {error}") from None


def _tool_tracker(section: PerceptionSection, arm: str) -> Agent:
    if arm not in section.track_tool:
        named = ", ".join(section.track_tool) or "nothing"
        raise ConfigError(f"perception.track_tool names {named}, and not {arm!r}; add it")
    return ToolTracker(ToolTrackerConfig(arm))


def _camera(section: CameraSection, reached: SessionSettings) -> Agent:
    config = CameraConfig(
        rate_hz=section.rate_hz,
        encoding=ImageEncoding[section.encoding.upper()],
        jpeg_quality=section.jpeg_quality,
        latency_ms=section.latency_ms,
    )
    if section.source == "scene":
        scene = SceneSource()

        def render(state: SimulatorState, frame: int) -> Pair:
            pair = scene.render(state, frame)
            return pair.left_bgr, pair.right_bgr

        return SceneCamera(render, lambda state: calibration_of(state.camera), config)
    if section.source == "bag":
        # reading bags takes as long to load as all else
        from agents.camera.bag import BagSource

        bag = BagSource(Path(section.left or ""), section.left_topic, section.right_topic, section.loop)
        size = bag.size()
        read = _read_calibration(section, size) if section.calibration else bag.calibration(section.unit, size)
        return Camera(bag, _usable(read), config)
    if section.source == "ros":
        from agents.camera.ros import RosSource
        from agents.cli.running.guard import naming_of

        ros = RosSource(reached, naming_of(section), _topic(section.left_topic), _topic(section.right_topic))
        size = ros.size()
        read = _read_calibration(section, size) if section.calibration else ros.calibration(section.unit, size)
        return Camera(ros, _usable(read), config)
    source, size = _source(section)
    return Camera(source, _usable(_read_calibration(section, size)), config)


def _topic(name: str | None) -> str:
    """As keys have it, where ROS writes a slash before it."""
    return (name or "").strip("/")


def _source(section: CameraSection) -> tuple[Source, tuple[int, int]]:
    """The source, and the width and height of one eye's image."""
    left, right = section.left or "", section.right
    if section.source == "pipe":
        width, height = section.width or 0, section.height or 0
        stream = sys.stdin.buffer if left == "-" else Path(left).open("rb")  # noqa: SIM115
        return PipeSource(stream, width, height), (width // 2, height)
    if section.source == "video":
        # a device can be opened once only
        video = VideoSource(left, right)
        return video, video.size()
    folders = Path(left), Path(right) if right is not None else None
    return ImageSource(*folders, loop=section.loop), _size_of_first(ImageSource(*folders, loop=False))


def _size_of_first(source: Source) -> tuple[int, int]:
    pair = source.read()
    source.close()
    if pair is None:
        raise SourceError("the source gives no frame")
    return pair[0].shape[1], pair[0].shape[0]


def _read_calibration(section: CameraSection, size: tuple[int, int]) -> ReadCalibration:
    return read_calibration(section.calibration or Path(), unit=section.unit, image_size=size)


def _usable(read: ReadCalibration) -> StereoCalibration:
    for judgement in read.judgements:
        if judgement.severity is Severity.FAULT:
            raise CalibrationError(f"{judgement.finding}; {judgement.remedy}")
    return read.calibration
