"""The configuration of a rig: one TOML file, from which every agent of it is built.

A section that is there means that `suturegrasp up` runs that agent on this machine; every agent reads the same file.
"""

import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from agents.cli.base_pose import BasePose, standing_apart
from agents.reconstruction.method_names import DEFAULT_METHOD, MATCHING_METHODS
from agents.robot_bridge.limits import MAXIMUM_PLAN_AGE_S
from shared.runtime.config import Settings
from shared.runtime.session import LOCAL_ENDPOINT, SessionSettings

Name = Annotated[str, Field(pattern=r"^[a-z0-9_]+$")]
Label = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
"""An identifier of a lab's own; names of people have spaces, and their addresses an @."""
ENDPOINT = re.compile(r"(?:tcp|tls|quic|ws|udp)/.+:(?P<port>\d{1,5})")


def _reachable(endpoint: str) -> str:
    found = ENDPOINT.fullmatch(endpoint)
    if found is None or not 0 < int(found["port"]) < 1 << 16:
        raise ValueError(f"{endpoint!r} is no endpoint; write protocol, host and port, such as {LOCAL_ENDPOINT}")
    return endpoint


Endpoint = Annotated[str, AfterValidator(_reachable)]


class RouterSection(Settings):
    """Where the router is; `start` runs one here, a process of its own."""

    endpoint: Endpoint = LOCAL_ENDPOINT
    start: bool = True


class CameraSection(Settings):
    """Where frames come from; which of the other keys a source needs is checked when it is opened."""

    source: Literal["scene", "images", "video", "pipe", "bag"] = "scene"
    left: str | None = None
    right: str | None = None
    left_topic: str | None = None
    right_topic: str | None = None
    loop: bool = True
    width: int | None = Field(default=None, gt=0)
    height: int | None = Field(default=None, gt=0)
    calibration: Path | None = None
    unit: Literal["m", "cm", "mm", "um"] | None = None
    rate_hz: float = Field(default=30.0, gt=0, le=240)
    encoding: Literal["raw", "png", "jpeg"] = "jpeg"
    jpeg_quality: int = Field(default=95, ge=1, le=100)
    latency_ms: float = Field(default=0.0, ge=0)

    @model_validator(mode="after")
    def _has_what_its_source_needs(self) -> "CameraSection":
        if self.source == "scene":
            return self
        if self.left is None:
            raise ValueError(f"source {self.source!r} needs left")
        if self.calibration is None and self.source != "bag":
            raise ValueError(f"source {self.source!r} needs calibration")
        if self.source == "pipe" and (self.width is None or self.height is None):
            raise ValueError("source 'pipe' needs width and height of the side-by-side frame")
        return self


class PerceptionSection(Settings):
    """How thread is found; `auto` takes what suits each image. `matching` unset is as the method needs it."""

    segmenter: Literal["auto", "threshold", "ridge"] = "auto"
    matching: bool | None = None


class ReconstructionSection(Settings):
    """How the curve is found, and whether it is followed from frame to frame."""

    method: Literal["refined", "paper"] = DEFAULT_METHOD
    tracking: bool = True


class PlannerSection(Settings):
    """How good a plan must be."""

    least_probability: float = Field(default=0.5, ge=0, le=1)


class ArmSection(Settings):
    """What drives an arm, and where it stands; psm1 and psm2 have a place without being told one."""

    backend: Literal["simulated"] = "simulated"
    maximum_plan_age_s: float = Field(default=MAXIMUM_PLAN_AGE_S, gt=0)
    T_camera_base: BasePose | None = None


class SimulatorSection(Settings):
    """The simulated field."""

    seed: int = Field(default=1, ge=0)
    config: Literal["easy", "medium", "hard", "singularity", "crossing"] = "medium"
    background: Literal["tissue", "plain"] = "tissue"
    colour: Literal["violet", "black", "blue", "green", "white", "grey"] = "violet"
    distance_mm: float = Field(default=95.0, gt=50, lt=200)
    tool_error_mm: float = Field(default=0.3, ge=0)


class RecorderSection(Settings):
    """Where recordings go, a new folder in this one for every session, how they are written, and what they are of."""

    folder: Path = Path("sessions")
    split_size_mb: float | None = Field(default=None, gt=0)
    split_minutes: float | None = Field(default=None, gt=0)
    pre_trigger_s: float | None = Field(default=None, gt=0)
    post_trigger_s: float | None = Field(default=None, ge=0)
    pre_trigger_memory_mb: float = Field(default=1000.0, gt=0)
    keep_free_mb: float | None = Field(default=None, ge=0)
    foxglove: bool = True
    protocol: Label | None = None
    specimen: Label | None = None
    operator: Label | None = None
    consent: Label | None = None
    retention_days: int | None = Field(default=None, ge=0, le=36500)


class ViewerSection(Settings):
    """Where the session is shown: `file` writes session.rrd alone; `native` and `web` also open a Rerun viewer."""

    show: Literal["file", "native", "web"] = "file"


class RigConfig(Settings):
    """A whole rig."""

    rig: Name = "lab"
    router: RouterSection = RouterSection()
    camera: CameraSection | None = None
    perception: PerceptionSection | None = None
    reconstruction: ReconstructionSection | None = None
    planner: PlannerSection | None = None
    robot: dict[Name, ArmSection] = Field(default_factory=dict)
    simulator: SimulatorSection | None = None
    recorder: RecorderSection | None = None
    viewer: ViewerSection | None = None

    @field_validator("robot")
    @classmethod
    def _each_arm_has_a_place_of_its_own(cls, robot: dict[str, ArmSection]) -> dict[str, ArmSection]:
        standing_apart({arm: section.T_camera_base for arm, section in robot.items()})
        return robot

    @model_validator(mode="after")
    def _method_has_its_matches(self) -> "RigConfig":
        if self.needs_matching and self.perception is not None and self.perception.matching is False:
            method = self.reconstruction.method if self.reconstruction else ""
            raise ValueError(f"reconstruction.method {method!r} needs perception.matching = true, or leave it out")
        return self

    @property
    def needs_matching(self) -> bool:
        """Whether the method of reconstruction needs matched pixels, as far as this configuration tells."""
        return self.reconstruction is not None and self.reconstruction.method in MATCHING_METHODS

    @property
    def session(self) -> SessionSettings:
        """How the agents of this rig reach the dataflow."""
        return SessionSettings(rig=self.rig, endpoint=self.router.endpoint)


def simulated_rig() -> RigConfig:
    """Everything on one machine, with a simulated field and arm."""
    return RigConfig(
        rig="demo",
        camera=CameraSection(),
        perception=PerceptionSection(),
        reconstruction=ReconstructionSection(),
        planner=PlannerSection(),
        robot={"psm1": ArmSection()},
        simulator=SimulatorSection(),
        recorder=RecorderSection(),
        viewer=ViewerSection(),
    )
