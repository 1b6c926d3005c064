"""How the agents of a rig fare by their own account, as a table, and which of them are silent."""

import threading
from collections.abc import Iterable
from dataclasses import dataclass

from rich.table import Table

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import AgentHealth
from schemas.topics import HEALTH, MAIN
from shared.clock import monotonic_s
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

SILENT_S = 3.0
"""Health comes once a second; an agent that has been silent for longer is not well."""
STARTING_S = 10.0
"""How long an agent may take until its first health."""
WELL = "well"


@dataclass(frozen=True)
class Fare:
    """How one agent fares.

    Fields:
        health: its newest; None where none has come.
        silent_s: since then, or since the watch began, by the clock of this machine.
    """

    name: str
    health: AgentHealth | None
    silent_s: float

    @property
    def state(self) -> str:
        """How it is, in one or two words, or its fault."""
        if self.health is None:
            return "starting" if self.silent_s < STARTING_S else "never heard of"
        if self.silent_s > SILENT_S:
            return "silent"
        return self.health.fault or WELL


class HealthWatch:
    """The newest health of every agent, those that are expected and any other that reports."""

    def __init__(self, connection: Connection, expected: Iterable[str] = ()) -> None:
        self._lock = threading.Lock()
        self._newest: dict[str, tuple[AgentHealth | None, float]] = dict.fromkeys(expected, (None, monotonic_s()))
        self._told: dict[str, str] = {}
        connection.listen((HEALTH,), self._take)

    def _take(self, tapped: Tapped) -> None:
        try:
            health = decode(AgentHealth, tapped.payload)
        except MessageError:
            return
        with self._lock:
            self._newest[name_of(health.agent, health.instance)] = (health, monotonic_s())

    def fares(self) -> list[Fare]:
        """How each agent fares: the expected ones in their order, then those that nobody expected."""
        now_s = monotonic_s()
        with self._lock:
            return [Fare(name, health, now_s - seen_s) for name, (health, seen_s) in self._newest.items()]

    def changes(self) -> list[str]:
        """Which agents fell silent, reported a fault or became well again since the last call, in plain words."""
        said: list[str] = []
        for fare in self.fares():
            before, self._told[fare.name] = self._told.get(fare.name, ""), fare.state
            if fare.state == before or (before in ("", "starting") and fare.state in (WELL, "starting")):
                continue
            since = f" for {fare.silent_s:.0f} s" if fare.silent_s > SILENT_S else ""
            said.append(f"{fare.name}: {'well again' if fare.state == WELL else fare.state + since}")
        return said


def name_of(kind: str, instance: str) -> str:
    """An agent as people call it."""
    return kind if instance == MAIN else f"{kind} {instance}"


def health_table(fares: Iterable[Fare]) -> Table:
    """A row an agent."""
    table = Table(box=None, pad_edge=False)
    for column in ("agent", "state", "step ms p50 / p99", "in Hz", "age ms", "dropped", "missed", "refused", "out Hz"):
        table.add_column(column, justify="left" if column in ("agent", "state") else "right")
    for fare in fares:
        silent = "" if fare.silent_s <= SILENT_S else f" for {fare.silent_s:.0f} s"
        table.add_row(fare.name, fare.state + silent, *_figures(fare.health))
    return table


def _figures(health: AgentHealth | None) -> tuple[str, ...]:
    if health is None:
        return ("-",) * 7
    steps = "-" if health.step_ms_p50 is None else f"{health.step_ms_p50:.1f} / {health.step_ms_p99 or 0:.1f}"
    ages = [i.age_ms for i in health.inputs if i.age_ms is not None]
    return (
        steps,
        " ".join(f"{i.rate_hz:.0f}" for i in health.inputs) or "-",
        f"{max(ages):.0f}" if ages else "-",
        str(sum(i.dropped for i in health.inputs)),
        str(sum(i.missed for i in health.inputs)),
        str(sum(i.refused for i in health.inputs)),
        " ".join(f"{o.rate_hz:.0f}" for o in health.outputs) or "-",
    )
