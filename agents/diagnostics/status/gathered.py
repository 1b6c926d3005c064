"""What `suturegrasp status` judges by: all that was heard of a rig at one moment, without sockets and clocks."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from agents.configuration.hosts import BESIDE, OPERATOR, kind_and_instance
from agents.configuration.rig import RigConfig
from agents.configuration.topics import Override
from agents.diagnostics.status.agents import Pair
from agents.diagnostics.status.calibrations import Allowed
from agents.diagnostics.status.health_watch import REPLAYED, Fare, name_of
from agents.registry import PERCEPTION, ROBOT_BRIDGE, TOOL_TRACKER
from schemas.messages import (
    AgentFacts,
    ExecutionEvent,
    HostClocks,
    Judgement,
    LogRecord,
    RigSection,
    RobotState,
    ToolCorrection,
)
from schemas.topics import TOPICS, Delivery
from shared.runtime.clocks import ClockOffset

FROZEN = "frozen"
"""Perception's word for a camera both of whose eyes stand still: it can use the images, and no arm may go by them."""


@dataclass(frozen=True)
class ArmHeard:
    """What was last heard of an arm, and of its tool in the images; None where nothing was."""

    arm: str
    state: RobotState | None = None
    event: ExecutionEvent | None = None
    tool: ToolCorrection | None = None


@dataclass(frozen=True)
class Gathered:
    """A rig at one moment.

    Fields:
        at_ns: by the clock of this machine.
        router: whether one answers.
        router_host: which of the rig's hosts runs it; empty on one machine.
        fares: of every agent that the rig's configuration has, or that was heard.
        addresses: of the rig's hosts, by name; empty on one machine.
        rates_hz: at which topics are expected, by name.
        here: this machine, as its agents would call it.
        clocks: of the agents' hosts as measured here, by `kind/instance`; None where the agent gave no answer.
        planner_clocks: as the planner measured them.
        facts: of the agents that told them, by `kind/instance`.
        said: log records that tell an error or a warning.
        here_expires_ns: when the certificate that status itself shows expires.
        overrides: what the rig's file here does otherwise with topics than their table says.
        rig_sections: of the rig's file here, by a digest of each.
        other_rigs: whose agents are on the same router, where none of this rig's is there.
        faults: what perception's newest observations find that keeps its input from being used.
        late_s: for how long each link between two hosts has carried too little, as far as it was watched.
        calibrations: how old those may be that agents use, by `kind/instance`, of agents that use any.
    """

    at_ns: int
    rig: str
    endpoint: str
    router: bool = True
    router_host: str = ""
    here: str = ""
    fares: tuple[Fare, ...] = ()
    addresses: Mapping[str, str] = field(default_factory=dict[str, str])
    rates_hz: Mapping[str, float] = field(default_factory=dict[str, float])
    clocks: Mapping[str, ClockOffset | None] = field(default_factory=dict[str, ClockOffset | None])
    planner_clocks: HostClocks | None = None
    arms: tuple[ArmHeard, ...] = ()
    facts: Mapping[str, AgentFacts] = field(default_factory=dict[str, AgentFacts])
    said: tuple[LogRecord, ...] = ()
    here_expires_ns: int | None = None
    overrides: tuple[Override, ...] = ()
    rig_sections: tuple[RigSection, ...] = ()
    calibrations: Mapping[str, Allowed] = field(default_factory=dict[str, Allowed])
    other_rigs: tuple[str, ...] = ()
    faults: tuple[Judgement, ...] = ()
    late_s: Mapping[Pair, float] = field(default_factory=dict[Pair, float])

    @property
    def replayed(self) -> tuple[str, ...]:
        """The agents for which a replay stands."""
        return tuple(fare.name for fare in self.fares if fare.state == REPLAYED)

    def without_replayed(self) -> "Gathered":
        """The same without what a replay tells for those agents: it is of the recording."""
        names = set(self.replayed)
        if not names:
            return self
        arms = (arm for arm in self.arms if name_of(ROBOT_BRIDGE.name, arm.arm) not in names)
        return replace(
            self,
            fares=tuple(fare for fare in self.fares if fare.name not in names),
            arms=tuple(
                replace(arm, tool=None) if name_of(TOOL_TRACKER.name, arm.arm) in names else arm for arm in arms
            ),
            said=tuple(record for record in self.said if name_of(record.agent, record.instance) not in names),
            faults=() if PERCEPTION.name in names else self.faults,
        )


def expected_rates(rig: RigConfig) -> dict[str, float]:
    """How often topics that come steadily are expected: what follows from frames, as often as the camera films."""
    steady = [t for t in TOPICS if t.delivery is Delivery.LATEST and t.steady]
    rates = {str(t): rate_hz for t in steady if (rate_hz := t.resting_hz or t.rate_hz)}
    if rig.camera is not None:
        rates |= {str(t): min(rates[str(t)], rig.camera.rate_hz) for t in steady if t.every_frame}
    return rates


def placed_agents(rig: RigConfig) -> dict[str, str]:
    """Every agent of a rig's configuration that tells how it fares, as people call it, with the host that runs it."""
    # nobody need guard an arm that nothing is sent to
    still = (f"guard {arm}" for arm, section in rig.robot.items() if section.dvrk is not None and section.dvrk.dry_run)
    quiet = ("viewer", OPERATOR, *still)
    if not rig.hosts:
        return dict.fromkeys((name for name in rig.processes() if name not in quiet), "")
    return {
        (f"{name} {kind_and_instance(name, host)[1]}" if name in BESIDE else name): host
        for host, section in rig.hosts.items()
        for name in section.runs
        if name not in quiet
    }


def placed_beside(rig: RigConfig) -> dict[str, str]:
    """What may tell how it fares and need not run, as people call it, with its host: viewers, and operators' pages."""
    named = {host: [name for name in section.runs if name in BESIDE] for host, section in rig.hosts.items()}
    return {f"{name} {host}": host for host, names in named.items() for name in names}
