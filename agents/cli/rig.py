"""The configuration of a rig: one TOML file, from which every agent of it is built.

A section that is there means that `suturegrasp up` runs that agent, on this machine or on the host whose `runs` names
it; every agent reads the same file.
"""

import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from agents.cli.base_pose import BasePose, standing_apart
from agents.cli.rig_hosts import (
    OPERATOR,
    HostName,
    HostSection,
    SecuritySection,
    host_fault,
    kind_and_instance,
)
from agents.reconstruction.method_names import DEFAULT_METHOD, MATCHING_METHODS
from agents.robot_bridge.limits import MAXIMUM_PLAN_AGE_S
from schemas.topics import MAIN, TOPICS
from shared.runtime.access import Sites, common_name
from shared.runtime.config import Settings
from shared.runtime.identity import Identity, identity_in
from shared.runtime.session import LOCAL_ENDPOINT, SessionSettings, on_loopback

Name = Annotated[str, Field(pattern=r"^[a-z0-9_]+$")]
Label = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
"""An identifier of a lab's own; names of people have spaces, and their addresses an @."""
AGENT_SECTIONS = ("camera", "perception", "reconstruction", "planner", "simulator")
ENDPOINT = re.compile(r"(?:tcp|tls|quic|ws|udp)/.+:(?P<port>\d{1,5})")


def _reachable(endpoint: str) -> str:
    found = ENDPOINT.fullmatch(endpoint)
    if found is None or not 0 < int(found["port"]) < 1 << 16:
        raise ValueError(f"{endpoint!r} is no endpoint; write protocol, host and port, such as {LOCAL_ENDPOINT}")
    return endpoint


Endpoint = Annotated[str, AfterValidator(_reachable)]


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


class LinksSection(Settings):
    """Ways past the router: whether agents on this machine hand images over by links of their own."""

    direct: bool = False


class ViewerSection(Settings):
    """Where the session is shown: `file` writes session.rrd alone; `native` and `web` also open a Rerun viewer."""

    show: Literal["file", "native", "web"] = "file"


class TopicSection(Settings):
    """What a rig does otherwise with a topic than the table says."""

    recorded: bool


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
    hosts: dict[HostName, HostSection] = Field(default_factory=dict)
    host: HostName | None = None
    security: SecuritySection | None = None
    links: LinksSection = LinksSection()
    topics: dict[str, TopicSection] = Field(default_factory=dict)

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

    @field_validator("topics")
    @classmethod
    def _each_topic_is_of_the_table(cls, topics: dict[str, TopicSection]) -> dict[str, TopicSection]:
        known = [str(topic) for topic in TOPICS]
        for name in topics:
            if name not in known:
                raise ValueError(f"there is no topic {name!r}; known are {', '.join(known)}")
        return topics

    @model_validator(mode="after")
    def _direct_links_stay_on_one_machine(self) -> "RigConfig":
        if self.links.direct and (self.hosts or self.security is not None):
            raise ValueError("links.direct goes past the router, whose access rules see nothing of it; leave it out")
        return self

    @model_validator(mode="after")
    def _sites_are_told_apart(self) -> "RigConfig":
        if self.rig in self.router.reads:
            raise ValueError(f"router.reads names {self.rig!r}, this rig itself; name rigs of other sites")
        for endpoint in self.router.connect:
            if not on_loopback(endpoint) and not (self.security is not None and endpoint.startswith("tls/")):
                raise ValueError(f"router.connect {endpoint!r} leaves this machine, which needs tls and [security]")
        return self

    @model_validator(mode="after")
    def _links_are_secured(self) -> "RigConfig":
        if not self.hosts:
            if self.router.host is not None or self.host is not None:
                named = "router.host" if self.router.host is not None else "host"
                raise ValueError(f"{named} names a host, and there are no [hosts]; describe them, or leave it out")
            if self.router.endpoint.startswith("tls/") and self.security is None:
                raise ValueError("router.endpoint is tls, which needs [security] with a folder of certificates")
            if not on_loopback(self.router.endpoint) and not self.router.endpoint.startswith("tls/"):
                raise ValueError(
                    f"router.endpoint {self.router.endpoint!r} leaves this machine, which needs mutual TLS: describe "
                    "[hosts] and [security], see docs/deployment.md"
                )
            return self
        if self.router.endpoint != LOCAL_ENDPOINT:
            raise ValueError("router.endpoint and [hosts] exclude each other; name router.host, and router.port")
        if self.router.host is None:
            raise ValueError(f"router.host is missing: which of {', '.join(self.hosts)} runs the router")
        for key, named in (("router.host", self.router.host), ("host", self.host)):
            if named is not None and named not in self.hosts:
                raise ValueError(f"{key} = {named!r} is none of the hosts {', '.join(self.hosts)}")
        if self.security is None:
            raise ValueError("[security] is missing, which hosts need to trust each other; an empty section will do")
        if fault := host_fault(self.hosts, self.processes()):
            raise ValueError(fault)
        return self

    @property
    def needs_matching(self) -> bool:
        """Whether the method of reconstruction needs matched pixels, as far as this configuration tells."""
        return self.reconstruction is not None and self.reconstruction.method in MATCHING_METHODS

    def processes(self) -> list[str]:
        """Everything that has a section, on whichever host, as `runs` writes it; the router is apart."""
        agents = [kind for kind in AGENT_SECTIONS if getattr(self, kind) is not None]
        arms = [f"robot_bridge {arm}" for arm in self.robot]
        return [*agents, *arms, *(kind for kind in ("recorder", "viewer") if getattr(self, kind) is not None)]

    def runs_here(self, name: str) -> bool:
        """Whether a process, as `runs` writes it, or the `router`, is to run on this machine."""
        if name == "router":
            return self.router.start and (not self.hosts or self.router.host == self.host)
        return name in self.processes() and (self.host is None or name in self.hosts[self.host].runs)

    @property
    def realtime_here(self) -> bool:
        """Whether what keeps time on this machine is to have real-time priority."""
        return self.host is not None and self.hosts[self.host].realtime

    @property
    def router_endpoint(self) -> str:
        """Where the router listens, and where the others find it."""
        if self.router.host is None:
            return self.router.endpoint
        address = self.hosts[self.router.host].address
        return f"tls/{f'[{address}]' if ':' in address else address}:{self.router.port}"

    @property
    def sites(self) -> Sites:
        """What the router has to do with those of other sites."""
        return Sites(self.router.connect, self.router.reads, self.router.read_by_others)

    @property
    def session(self) -> SessionSettings:
        """How a person's command reaches the dataflow, as this host's operator."""
        return self.session_of(OPERATOR)

    def session_of(self, name: str) -> SessionSettings:
        """How a process, as `runs` writes it, reaches the dataflow."""
        return SessionSettings(rig=self.rig, endpoint=self.router_endpoint, identity=self.identity_of(name))

    def identity_of(self, name: str) -> Identity | None:
        """The certificate that a process of this host shows; None on a rig without certificates."""
        if self.security is None:
            return None
        return identity_in(self.security.certificates, common_name(*kind_and_instance(name, self.host or MAIN)))

    def common_names(self) -> list[str]:
        """The common names of everything that may reach the router, for which there are certificates."""
        runs = {host: section.runs for host, section in self.hosts.items()} or {MAIN: (*self.processes(), OPERATOR)}
        return [common_name(*kind_and_instance(name, host)) for host, names in runs.items() for name in names]


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
