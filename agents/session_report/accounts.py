"""What the agents said of themselves: how they fared, what they dropped, their faults and their logs."""

from dataclasses import dataclass, field

import numpy as np

from schemas.messages import AgentHealth, InputHealth, LogLevel, LogRecord
from schemas.topics import MAIN

GRAVE = (LogLevel.WARNING, LogLevel.ERROR)
FAULT = "FAULT"
KINDS_KEPT = 1000


@dataclass
class Remark:
    """A warning, an error or a fault, as often as it was said in the same words."""

    agent: str
    level: str
    text: str
    first_ns: int
    last_ns: int
    count: int = 1


@dataclass(frozen=True)
class Drops:
    """What became of one agent's input over all of its runs within the recording, as its health counts it."""

    agent: str
    topic: str
    received: int
    dropped: int
    missed: int
    refused: int


@dataclass(frozen=True)
class AgentAccount:
    """One agent of a session.

    Fields:
        runs: how often it was started, as far as health tells.
        step_ms_p50: the median of what it reported each second; step_ms_p99: the largest. None where it never stepped.
    """

    name: str
    host: str
    version: str
    config_hash: str
    runs: int
    step_ms_p50: float | None
    step_ms_p99: float | None
    drops: tuple[Drops, ...]


@dataclass
class _Agent:
    """What one agent said of itself, by run: last, and first where the run had begun before the recording."""

    last: dict[int, AgentHealth] = field(default_factory=dict[int, AgentHealth])
    before: dict[int, AgentHealth] = field(default_factory=dict[int, AgentHealth])
    p50_ms: list[float] = field(default_factory=list[float])
    p99_ms: list[float] = field(default_factory=list[float])
    fault: str = ""


class AccountCollector:
    """Takes health and logs one by one."""

    def __init__(self) -> None:
        self._agents: dict[str, _Agent] = {}
        self._remarks: dict[tuple[str, str, str], Remark] = {}

    def add_health(self, epoch: int, health: AgentHealth, first: bool = True) -> None:
        """Take what an agent says of itself each second; `first`: it is the first that its run said."""
        name = name_of(health.agent, health.instance)
        agent = self._agents.setdefault(name, _Agent())
        if not first and epoch not in agent.last:
            agent.before[epoch] = health
        agent.last[epoch] = health
        if health.step_ms_p50 is not None:
            agent.p50_ms.append(health.step_ms_p50)
        if health.step_ms_p99 is not None:
            agent.p99_ms.append(health.step_ms_p99)
        # health repeats a fault each second; it is one
        if health.fault and health.fault != agent.fault:
            self._remark(name, FAULT, health.fault, health.at_ns)
        agent.fault = health.fault

    def add_log(self, record: LogRecord) -> None:
        """Take a line of a log; only warnings and errors are kept."""
        if record.level in GRAVE:
            self._remark(name_of(record.agent, record.instance), record.level.name, record.text, record.at_ns)

    def agents(self) -> tuple[AgentAccount, ...]:
        """The agents by name."""
        return tuple(_account(name, agent) for name, agent in sorted(self._agents.items()))

    def remarks(self) -> tuple[Remark, ...]:
        """What was said, in the order in which it was said first."""
        return tuple(sorted(self._remarks.values(), key=lambda remark: remark.first_ns))

    def _remark(self, agent: str, level: str, text: str, at_ns: int) -> None:
        # the traceback of an error is in the agent's own log
        line = text.splitlines()[0] if text else ""
        name = agent, level, line
        if name not in self._remarks and len(self._remarks) >= KINDS_KEPT:
            name = agent, level, "(further kinds)"
        if name in self._remarks:
            self._remarks[name].count += 1
            self._remarks[name].last_ns = at_ns
        else:
            self._remarks[name] = Remark(agent, level, name[2], at_ns, at_ns)


def name_of(kind: str, instance: str) -> str:
    """An agent as people call it."""
    return kind if instance == MAIN else f"{kind} {instance}"


def _account(name: str, agent: _Agent) -> AgentAccount:
    healths = list(agent.last.values())
    inputs: dict[str, list[InputHealth]] = {}
    before: dict[str, list[InputHealth]] = {}
    for counted, all_of_them in ((inputs, healths), (before, agent.before.values())):
        for health in all_of_them:
            for account in health.inputs:
                counted.setdefault(account.topic, []).append(account)
    newest = healths[-1]
    return AgentAccount(
        name=name,
        host=newest.host,
        version=newest.version,
        config_hash=newest.config_hash,
        runs=len(healths),
        step_ms_p50=float(np.median(agent.p50_ms)) if agent.p50_ms else None,
        step_ms_p99=max(agent.p99_ms, default=None),
        drops=tuple(_drops(name, topic, accounts, before.get(topic, [])) for topic, accounts in inputs.items()),
    )


def _drops(agent: str, topic: str, accounts: list[InputHealth], before: list[InputHealth]) -> Drops:
    """The counts of all runs, each of which counts from its own start: without those of before the recording."""
    received, dropped, missed, refused = (
        sum(getattr(account, count) for account in accounts) - sum(getattr(account, count) for account in before)
        for count in ("received", "dropped", "missed", "refused")
    )
    return Drops(agent, topic, received, dropped, missed, refused)
