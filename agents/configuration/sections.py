"""The sections of a rig's configuration: what each agent, and what lies between them, can be told."""

import contextlib
import datetime
import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from agents.configuration.base_pose import BasePose
from agents.configuration.hosts import HostName, Name
from agents.reconstruction.method_names import DEFAULT_METHOD
from agents.robot_bridge.correction import CORRECTION_LIMIT_DEG, CORRECTION_LIMIT_MM
from agents.robot_bridge.limits import MAXIMUM_PLAN_AGE_S
from shared.runtime.config import Settings, spelled
from shared.runtime.session import LOCAL_ENDPOINT, on_loopback

Label = Annotated[str, spelled(r"[A-Za-z0-9_.-]{1,64}", "up to 64 letters, digits, _ . and -, without spaces")]
"""An identifier of a lab's own; names of people have spaces, and their addresses an @."""
Sha256 = Annotated[str, spelled(r"[0-9a-fA-F]{64}", "64 digits 0 to 9 and a to f, as sha256sum prints them")]
CALIBRATION_DAYS, REGISTRATION_DAYS, JAW_DAYS = 90.0, 30.0, 30.0
"""How old a camera's calibration, an arm's registration, and that of its jaw may be. Optics that nobody touches stay as
they are for months; an arm's set-up joints are moved, and its instruments changed, more often."""
DEVICE = re.compile(r"\d+|/dev/(?!shm/)(?!.*\.\.).+")
"""A video device; below /dev/shm lie files."""
ENDPOINT = re.compile(r"(?:tcp|tls|quic|ws|udp)/.+:(?P<port>\d{1,5})")


def _reachable(endpoint: str) -> str:
    found = ENDPOINT.fullmatch(endpoint)
    if found is None or not 0 < int(found["port"]) < 1 << 16:
        raise ValueError(f"{endpoint!r} is no endpoint; write protocol, host and port, such as {LOCAL_ENDPOINT}")
    return endpoint


Endpoint = Annotated[str, AfterValidator(_reachable)]


def _day(told: object) -> datetime.date:
    if isinstance(told, str):
        with contextlib.suppress(ValueError):
            return datetime.date.fromisoformat(told)
    if isinstance(told, datetime.date) and not isinstance(told, datetime.datetime):
        return told
    raise ValueError(f"{told!s:.40} is no day; write year, month and day, such as 2026-11-24")


Day = Annotated[datetime.date, BeforeValidator(_day)]


class RouterSection(Settings):
    """Where the router is: an endpoint, or one of the hosts; `start` runs ours, a process of its own.

    The rest is about routers of other sites: whom it connects to, and which rigs are read across.
    """

    endpoint: Endpoint = LOCAL_ENDPOINT
    host: HostName | None = None
    port: int = Field(default=7447, gt=0, lt=1 << 16)
    start: bool = True
    connect: tuple[Endpoint, ...] = ()
    reads: tuple[Name, ...] = ()
    read_by_others: bool = False


class CameraSection(Settings):
    """Where frames come from; which of the other keys a source needs is checked when it is opened."""

    source: Literal["scene", "images", "video", "pipe", "bag", "ros", "plugin"] = "scene"
    plugin: Label | None = None
    options: dict[str, bool | int | float | str | tuple[bool | int | float | str, ...]] | None = None
    left: str | None = None
    right: str | None = None
    left_topic: str | None = None
    right_topic: str | None = None
    endpoint: Endpoint | None = None
    codec: Literal["ros2dds", "rmw_zenoh"] = "ros2dds"
    domain: int = Field(default=0, ge=0, le=232)
    type_hashes: bool = True
    loop: bool = True
    width: int | None = Field(default=None, gt=0)
    height: int | None = Field(default=None, gt=0)
    calibration: Path | None = None
    calibration_days: float = Field(default=CALIBRATION_DAYS, gt=0, le=365)
    unit: Literal["m", "cm", "mm", "um"] | None = None
    rate_hz: float = Field(default=30.0, gt=0, le=240)
    encoding: Literal["raw", "png", "jpeg"] = "jpeg"
    jpeg_quality: int = Field(default=95, ge=1, le=100)
    latency_ms: float = Field(default=0.0, ge=0)

    @model_validator(mode="after")
    def _has_what_its_source_needs(self) -> "CameraSection":
        if self.source == "scene":
            return self
        if self.source == "plugin":
            if self.plugin is None or self.calibration is None:
                raise ValueError("source 'plugin' needs plugin, the name of what is installed, and calibration")
            return self
        if self.source == "ros":
            if self.endpoint is None or self.left_topic is None or self.right_topic is None:
                raise ValueError("source 'ros' needs endpoint, left_topic and right_topic")
            return self
        if self.left is None:
            raise ValueError(f"source {self.source!r} needs left, where its images are: docs/camera.md")
        if self.calibration is None and self.source != "bag":
            raise ValueError(f"source {self.source!r} needs calibration, the file of both eyes: docs/camera.md")
        if self.source == "pipe" and (self.width is None or self.height is None):
            raise ValueError("source 'pipe' needs width and height of the side-by-side frame")
        return self

    @property
    def unlike_now(self) -> str:
        """Why its images may not be of now, with what to film by instead; empty where nothing in the file tells so."""
        if self.source in ("scene", "images", "bag"):
            return f"camera.source {self.source!r} shows no field that is there: film it by a device, a pipe or ros"
        if self.source == "ros" and self.endpoint is not None and not on_loopback(self.endpoint):
            far = f"images from camera.endpoint {self.endpoint!r} may wait on their way unnoticed"
            return f"{far}: run the camera agent on the host of the camera, with the Zenoh there as endpoint"
        if self.source == "video":
            for name in filter(None, (self.left, self.right)):
                if "://" in name:
                    return f"camera films {name!r}, and what comes from an address may be seconds old: film by a device"
                if not DEVICE.fullmatch(name):
                    return f"camera films {name!r}, a file and so a recording: film by a device"
        return ""


class PerceptionSection(Settings):
    """How thread is found; `auto` takes what suits each image. `matching` unset is as the method needs it.

    Segmenter `promptable` runs a network from two files of the user's own, whose hashes are compared where given.
    """

    segmenter: Literal["auto", "threshold", "network", "promptable"] = "auto"
    matching: bool | None = None
    promptable_encoder: Path | None = None
    promptable_decoder: Path | None = None
    promptable_encoder_sha256: Sha256 | None = None
    promptable_decoder_sha256: Sha256 | None = None

    @model_validator(mode="after")
    def _promptable_has_its_files(self) -> "PerceptionSection":
        given = [name for name in ("promptable_encoder", "promptable_decoder") if getattr(self, name) is not None]
        if len(given) == 1 or (self.segmenter == "promptable" and not given):
            raise ValueError("segmenter 'promptable' needs promptable_encoder and promptable_decoder, two ONNX files")
        return self


class ReconstructionSection(Settings):
    """How the curve is found, and whether it is followed from frame to frame."""

    method: Literal["refined", "paper"] = DEFAULT_METHOD
    tracking: bool = True


class PlannerSection(Settings):
    """How good a plan must be, by what its success is judged, and how often a goal is tried."""

    least_probability: float = Field(default=0.5, ge=0, le=1)
    policy_model: Literal["geometric", "paper"] = "geometric"
    tool_error_mm: float = Field(default=0.7, ge=0, le=5)
    hand_eye_error_mm: float = Field(default=1.5, ge=0, le=10)
    attempts: int = Field(default=3, ge=1, le=10)
    press_mm: float = Field(default=4.0, ge=0, le=10)
    tissue_required: bool = False


class DvrkSection(Settings):
    """How an arm of a da Vinci research kit is reached, and whether it is moved at all.

    `has_no` names what this rig has none of, so that its silence says nothing; `pedal` the console's operator-present
    signal, which counts as presence beside the page's button. `emulated_at` is `endpoint` once more where an emulated
    console listens there: a file whose endpoint alone becomes that of a real one is refused.
    """

    endpoint: Endpoint
    arm: Annotated[str, spelled(r"[A-Za-z0-9_]+", "letters, digits and _ alone, as its console does")] = "PSM1"
    codec: Literal["ros2dds", "rmw_zenoh"] = "ros2dds"
    domain: int = Field(default=0, ge=0, le=232)
    type_hashes: bool = True
    tool: str = "LARGE_NEEDLE_DRIVER:400006"
    set_point_hz: float = Field(default=200.0, ge=50, le=500)
    through_guard: Literal[True] = True
    has_no: tuple[Literal["teleoperation", "endoscope_arm", "clutch", "set_up_joints", "tissue"], ...] = ()
    pedal: Literal["footpedals/operator_present", "console/operator_present"] | None = None
    dry_run: bool = True
    emulated_at: Endpoint | None = None

    @property
    def moves(self) -> bool:
        """Whether something real may be moved."""
        return not self.dry_run and self.emulated_at is None

    @model_validator(mode="after")
    def _is_emulated_where_it_is_reached(self) -> "DvrkSection":
        if self.emulated_at is not None and self.emulated_at != self.endpoint:
            told = f"emulated_at {self.emulated_at!r} is not endpoint {self.endpoint!r}"
            raise ValueError(f"{told}: leave emulated_at out where the console is real")
        return self

    @field_validator("through_guard", mode="before")
    @classmethod
    def _goes_through_the_guard(cls, told: object) -> object:
        if told is not True:
            raise ValueError("set points go through the guard always: leave through_guard out (docs/dvrk.md)")
        return told


class ArmSection(Settings):
    """What drives an arm, and where it stands; simulated psm1 and psm2 have a place without being told one.

    `T_camera_base_calibration` and `T_camera_base_made` say of which camera calibration the base is and when it was
    registered, where it has no file that does. `jaw_file` says where the jaw of its instrument closes.
    """

    backend: Literal["simulated", "dvrk"] = "simulated"
    speed_share: float = Field(default=1.0, ge=0.01, le=1)
    maximum_plan_age_s: float = Field(default=MAXIMUM_PLAN_AGE_S, gt=0, le=300)
    maximum_frame_age_s: float = Field(default=0.5, gt=0, le=2)
    maximum_motion_s: float = Field(default=60.0, gt=0, le=600)
    correction: Literal["none", "tool_tracker"] = "none"
    correction_limit_mm: float = Field(default=CORRECTION_LIMIT_MM, gt=0, le=30)
    correction_limit_deg: float = Field(default=CORRECTION_LIMIT_DEG, gt=0, le=15)
    T_camera_base: BasePose | None = None
    T_camera_base_file: Path | None = None
    T_camera_base_axes: Literal["opencv", "da_vinci"] | None = None
    T_camera_base_calibration: Label | None = None
    T_camera_base_made: Day | None = None
    T_camera_base_days: float = Field(default=REGISTRATION_DAYS, gt=0, le=365)
    jaw_file: Path | None = None
    jaw_days: float = Field(default=JAW_DAYS, gt=0, le=365)
    kinematics: Path | None = None
    dvrk: DvrkSection | None = None

    @model_validator(mode="after")
    def _has_what_its_backend_needs(self) -> "ArmSection":
        if (self.backend == "dvrk") != (self.dvrk is not None):
            raise ValueError("backend 'dvrk' and a section dvrk with its endpoint go together: docs/dvrk.md")
        if self.T_camera_base is not None and self.T_camera_base_file is not None:
            raise ValueError("T_camera_base and T_camera_base_file exclude each other; keep one")
        if self.kinematics is not None and (self.backend != "simulated" or self.T_camera_base is None):
            raise ValueError("an arm of another kinematics is a simulated one, and needs T_camera_base")
        if self.backend == "dvrk" and self.T_camera_base is None and self.T_camera_base_file is None:
            raise ValueError(
                "backend 'dvrk' needs T_camera_base or T_camera_base_file, which only the lab can have measured: "
                "docs/camera.md"
            )
        return self


class SimulatorSection(Settings):
    """The simulated field."""

    seed: int = Field(default=1, ge=0)
    config: Literal["easy", "medium", "hard", "singularity", "crossing"] = "medium"
    background: Literal["rendered", "tissue", "plain"] = "rendered"
    colour: Literal["violet", "black", "blue", "green", "white", "grey"] = "violet"
    distance_mm: float = Field(default=95.0, gt=50, lt=200)
    tool_error_mm: float = Field(default=0.3, ge=0)
    hand_eye_error_mm: float = Field(default=0.0, ge=0)
    hand_eye_error_deg: float = Field(default=0.0, ge=0, lt=90)
    error_seed: int | None = Field(default=None, ge=0)
    physics: Literal["geometric", "contact"] = "geometric"
    tissue_force_limit_n: float = Field(default=1.0, gt=0)


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
