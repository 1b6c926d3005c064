"""The configuration of a rig: one TOML file, from which every agent of it is built.

A section that is there means that `suturegrasp up` runs that agent, on this machine or on the host whose `runs` names
it; every agent reads the same file.
"""

import dataclasses
import importlib
import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from pydantic import Field, create_model, field_validator, model_validator

from agents.configuration.base_pose import standing_apart
from agents.configuration.hosts import (
    LOCALHOST,
    OPERATOR,
    HostName,
    HostSection,
    SecuritySection,
    host_fault,
    kind_and_instance,
    run_name,
)
from agents.configuration.migrations import lifted
from agents.configuration.sections import (
    ArmSection,
    CameraSection,
    DvrkSection,
    Name,
    PerceptionSection,
    PlannerSection,
    ReconstructionSection,
    RecorderSection,
    RouterSection,
    SimulatorSection,
    ViewerSection,
)
from agents.configuration.topics import TopicSections, overrides, rows_otherwise
from agents.reconstruction.method_names import MATCHING_METHODS
from agents.registry import AGENTS, GUARD, RECORDER, TOOL_TRACKER, VIEWER, Kind
from schemas.messages import TopicOverride
from schemas.topics import MAIN, Topic
from shared.runtime.access import Sites, common_name
from shared.runtime.config import Settings
from shared.runtime.identity import Identity, identity_in
from shared.runtime.session import LOCAL_ENDPOINT, SessionSettings, host_of, on_loopback


class _Rig(Settings):
    """A whole rig, but for the sections that are made of the registry."""

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
    topics: TopicSections = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _lifted(cls, told: Any) -> Any:
        if not isinstance(told, dict):
            return told
        if isinstance(host := told.get("host"), dict):
            raise ValueError(f"[host.{next(iter(host), 'NAME')}] is no section; did you mean [hosts.NAME]?")
        return lifted(told)

    @field_validator("robot")
    @classmethod
    def _each_arm_has_a_place_of_its_own(cls, robot: dict[str, ArmSection]) -> dict[str, ArmSection]:
        # what a file tells is known where the arm is, on the host of its bridge
        told = {arm: section for arm, section in robot.items() if section.T_camera_base_file is None}
        standing_apart({arm: section.T_camera_base for arm, section in told.items()})
        return robot

    @model_validator(mode="after")
    def _method_has_its_matches(self) -> "_Rig":
        if self.needs_matching and self.perception is not None and self.perception.matching is False:
            method = self.reconstruction.method if self.reconstruction else ""
            raise ValueError(f"reconstruction.method {method!r} needs perception.matching = true, or leave it out")
        return self

    @model_validator(mode="after")
    def _tools_are_of_arms(self) -> "_Rig":
        for arm in self.arms_of(TOOL_TRACKER):
            if arm not in self.robot:
                arms = ", ".join(self.robot) or "none"
                raise ValueError(f"[tool_tracker.{arm}] names an arm that there is not; the arms are {arms}")
            if self.robot[arm].kinematics is not None:
                raise ValueError(f"[tool_tracker.{arm}] is for an arm whose tool is no PSM's; leave it out")
        for arm, section in self.robot.items():
            if section.correction == "tool_tracker" and arm not in self.arms_of(TOOL_TRACKER):
                raise ValueError(f"robot.{arm}.correction = 'tool_tracker' needs a section [tool_tracker.{arm}]")
        return self

    @model_validator(mode="after")
    def _sites_are_told_apart(self) -> "_Rig":
        if self.rig in self.router.reads:
            raise ValueError(f"router.reads names {self.rig!r}, this rig itself; name rigs of other sites")
        for endpoint in self.router.connect:
            if not on_loopback(endpoint) and not (self.security is not None and endpoint.startswith("tls/")):
                raise ValueError(f"router.connect {endpoint!r} leaves this machine, which needs tls and [security]")
        return self

    @model_validator(mode="after")
    def _robots_are_reached_safely(self) -> "_Rig":
        camera = self.camera.endpoint if self.camera is not None else None
        arms = {arm: section.dvrk for arm, section in self.robot.items() if section.dvrk is not None}
        named = {f"robot.{arm}.dvrk.endpoint": dvrk.endpoint for arm, dvrk in arms.items()}
        for name, endpoint in (named | ({"camera.endpoint": camera} if camera is not None else {})).items():
            if not on_loopback(endpoint) and not (self.security is not None and endpoint.startswith("tls/")):
                raise ValueError(
                    f"{name} {endpoint!r} leaves this machine, which needs tls and [security]; or run what needs it on "
                    "the robot's computer: docs/dvrk.md"
                )
        for (one, its), (other, theirs) in itertools.combinations(arms.items(), 2):
            if its.pedal and theirs.pedal and self._console(one, its) == self._console(other, theirs):
                both = f"robot.{one} and robot.{other} both count the pedal of the console at {its.endpoint}"
                raise ValueError(f"{both}: a foot stands by for one arm; leave pedal out of the other")
            apart = its.codec == theirs.codec == "rmw_zenoh" and its.domain != theirs.domain
            if its.arm == theirs.arm and self._console(one, its) == self._console(other, theirs) and not apart:
                twice = f"robot.{one} and robot.{other} are both {its.arm} of the console at {its.endpoint}"
                raise ValueError(f"{twice}: two bridges would fight over it; name another arm, or keep one")
        return self

    @model_validator(mode="after")
    def _real_arms_are_seen_now(self) -> "_Rig":
        # whatever a source gives is echoed as seen just now: no bridge could tell a recording from the field
        moved = [arm for arm, section in self.robot.items() if section.dvrk is not None and section.dvrk.moves]
        if moved and self.camera is not None and (unseen := self.camera.unlike_now):
            otherwise = "leave dry_run on, or name an emulated console in emulated_at"
            raise ValueError(f"{unseen}; {moved[0]} is real and would go by it: {otherwise}")
        return self

    def _console(self, arm: str, dvrk: DvrkSection) -> tuple[str, str]:
        """Address and port of an arm's console, as far as its endpoint tells: a host may have several names."""
        address, port = host_of(dvrk.endpoint).lower(), dvrk.endpoint.rpartition(":")[2]
        if not on_loopback(dvrk.endpoint):
            return address, port
        # whatever answers on loopback answers the bridge on the bridge's own host
        sits = [told.address.lower() for told in self.hosts.values() if f"robot_bridge {arm}" in told.runs]
        return sits[0] if sits else LOCALHOST, port

    @model_validator(mode="after")
    def _guards_sit_at_their_robots(self) -> "_Rig":
        for arm, section in self.robot.items():
            name, at = f"guard {arm}", "" if section.dvrk is None else host_of(section.dvrk.endpoint)
            sits = [host for host, told in self.hosts.items() if name in told.runs]
            robots = [host for host, told in self.hosts.items() if told.address == at]
            # whatever answers on loopback answers the bridge on the bridge's own host
            robots = robots or [host for host, told in self.hosts.items() if f"robot_bridge {arm}" in told.runs]
            if sits and robots and sits != robots:
                raise ValueError(
                    f"{name!r} must run on {robots[0]}, the robot's computer, not on {sits[0]}: a guard that "
                    "is elsewhere is lost with the link"
                )
        return self

    @model_validator(mode="after")
    def _links_are_secured(self) -> "_Rig":
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

    @property
    def rows_otherwise(self) -> tuple[Topic, ...]:
        """The rows of the topic table that this rig has otherwise."""
        return rows_otherwise(self.topics)

    @property
    def overrides(self) -> tuple[TopicOverride, ...]:
        """What this rig does otherwise with topics than the table says, as its processes tell whoever asks."""
        return tuple(one.told for one in overrides(self.topics))

    def processes(self) -> list[str]:
        """Everything that has a section, on whichever host, as `runs` writes it; the router is apart."""
        agents = [run_name(kind, instance) for kind, instance in self.agents()]
        guards = [run_name(GUARD.name, arm) for arm, section in self.robot.items() if section.dvrk is not None]
        beside = [kind.name for kind in (RECORDER, VIEWER) if self.section_of(kind) is not None]
        return [*agents, *guards, *beside]

    def agents(self) -> list[tuple[str, str]]:
        """Kind and instance of every agent that has a section, on whichever host; those of arms come last."""
        alone = [(kind.name, MAIN) for kind in AGENTS if not kind.per_arm and self.section_of(kind) is not None]
        return [*alone, *((kind.name, arm) for kind in AGENTS if kind.per_arm for arm in self.arms_of(kind))]

    def arms_of(self, kind: Kind) -> tuple[str, ...]:
        """The arms that have a process of a kind of which each arm may have one."""
        return tuple(dict(self)[kind.section])

    def agents_here(self) -> list[tuple[str, str]]:
        """Those that are to run on this machine."""
        return [(kind, instance) for kind, instance in self.agents() if self.runs_here(run_name(kind, instance))]

    def section_of(self, kind: Kind, instance: str = MAIN) -> Any:
        """The section that a process is made from; None where there is none."""
        section = dict(self)[kind.section]
        return section.get(instance) if isinstance(section, dict) else section

    def runs_here(self, name: str) -> bool:
        """Whether a process, as `runs` writes it, or the `router`, is to run on this machine."""
        if name == "router":
            return self.router.start and (not self.hosts or self.router.host == self.host)
        return name in self.processes() and (self.host is None or name in self.hosts[self.host].runs)

    @property
    def sessions(self) -> Path:
        """Where a session's files lie, in a folder of its own."""
        return self.recorder.folder if self.recorder is not None else Path("sessions")

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
        return SessionSettings(self.rig, self.router_endpoint, self.identity_of(name), self.rows_otherwise)

    def identity_of(self, name: str) -> Identity | None:
        """The certificate that a process of this host shows; None on a rig without certificates."""
        if self.security is None:
            return None
        return identity_in(self.security.certificates, common_name(*kind_and_instance(name, self.host or MAIN)))

    def common_names(self) -> list[str]:
        """The common names of everything that may reach the router, for which there are certificates."""
        runs = {host: section.runs for host, section in self.hosts.items()} or {MAIN: (*self.processes(), OPERATOR)}
        return [common_name(*kind_and_instance(name, host)) for host, names in runs.items() for name in names]


def section_made_of(kind: Kind) -> tuple[Any, Any]:
    """The type and default of the section that is made of an agent's config; its arm is told by the section's name."""
    module, _, name = kind.config.partition(":")
    config = getattr(importlib.import_module(module), name)
    hints = get_type_hints(config, include_extras=True)
    fields: dict[str, Any] = {
        field.name: (hints[field.name], ... if field.default is dataclasses.MISSING else field.default)
        for field in dataclasses.fields(config)
        if not (kind.per_arm and field.name == "arm")
    }
    made = create_model(f"{config.__name__}Section", __base__=Settings, __doc__=config.__doc__, **fields)
    return (dict[Name, made], Field(default_factory=dict)) if kind.per_arm else (made | None, None)


if TYPE_CHECKING:

    class RigConfig(_Rig):
        """A whole rig."""

else:
    RigConfig = create_model(
        "RigConfig",
        __base__=_Rig,
        __module__=__name__,
        __doc__="A whole rig.",
        **{kind.section: section_made_of(kind) for kind in AGENTS if kind.config},
    )


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
