"""How the agents of a rig fare by their own account, as a table, and which of them are silent."""

import dataclasses
import threading
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass

from rich.table import Table

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import AgentHealth
from schemas.topics import HEALTH, MAIN, REPLAY_CLOCK
from shared.clock import monotonic_s
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

SILENT_S = 3.0
"""Health comes once a second; an agent that has been silent for longer is not well."""
MISSING_S = 1.5
"""Health that is younger shows an agent to be there, whatever was heard of its token."""
STARTING_S = 10.0
"""How long an agent may take until its first health."""
WELL, STARTING, NEVER, SILENT = "well", "starting", "never heard of", "silent"
ABSENT, GONE, HANGING = "absent", "gone", "hanging"
REPLAYED = "replayed"
"""Of an agent for which a replay stands: what it tells is of the recording."""


@dataclass(frozen=True)
class Fare:
    """How one agent fares.

    Fields:
        health: its newest; None where none has come.
        silent_s: since then, or since its session was first seen, or the watch began, by the clock of this machine.
        present: whether its session is there, as the router tells; None where nobody asked.
        restarts: how often it began anew since the watch began.
        restarted_s: since it was last heard to have begun anew, or was first heard.
        expected: whether the rig's configuration has it; and on which of its hosts, empty where that is not told.
        refused_s: since it was seen to refuse a message, or was first heard.
        leaves_out: the inputs of which it left out messages for newer ones since its health before.
        epoch: of the run that told its health; None where that is not known.
        replayed: whether a replay told it.
    """

    name: str
    health: AgentHealth | None
    silent_s: float
    present: bool | None = None
    restarts: int = 0
    expected: bool = True
    placed: str = ""
    refused_s: float = 0.0
    leaves_out: frozenset[str] = frozenset()
    epoch: int | None = None
    replayed: bool = False
    restarted_s: float = 0.0

    @property
    def state(self) -> str:
        """How it is, in one or two words, or its fault."""
        if self.present is False and (self.health is None or self.silent_s > MISSING_S):
            return ABSENT if self.health is None or self.replayed else GONE
        if self.replayed:
            return REPLAYED
        if self.silent_s > SILENT_S and self.present:
            # its session lives in threads of its own, and health comes from its loop
            return HANGING
        if self.health is None:
            return STARTING if self.silent_s < STARTING_S else NEVER
        return SILENT if self.silent_s > SILENT_S else self.health.fault or WELL

    @property
    def host(self) -> str:
        """Where it runs: the host of the rig's configuration, or where that tells none, the name of its machine."""
        return self.placed or (self.health.host if self.health is not None else "")


class HealthWatch:
    """The newest health of every agent, those that are expected and any other that reports."""

    def __init__(
        self, connection: Connection, expected: Iterable[str] = (), placed: Mapping[str, str] | None = None
    ) -> None:
        """`placed` tells on which of the rig's hosts they run, and others that may report."""
        self._lock = threading.Lock()
        self._hosts = placed or {}
        self._newest = {name: Fare(name, None, monotonic_s(), placed=self._hosts.get(name, "")) for name in expected}
        """With the time at which each was heard in place of how long it has been silent."""
        self._told: dict[str, str] = {}
        self._cut_off_s = 0.0
        self._replays = set[int]()
        connection.listen((HEALTH, REPLAY_CLOCK), self._take)

    def _take(self, tapped: Tapped) -> None:
        epoch = tapped.beside.epoch if tapped.beside is not None else None
        if tapped.topic is REPLAY_CLOCK:
            if epoch is not None:
                with self._lock:
                    self._replays.add(epoch)
            return
        try:
            health = decode(AgentHealth, tapped.payload)
        except MessageError:
            return
        # the key is what the router lets its owner alone publish; the message could say anything
        kind, instance = tapped.key.split("/")[2:4]
        name = name_of(kind, instance)
        with self._lock:
            before = self._newest.get(name) or Fare(name, None, 0.0, expected=False, placed=self._hosts.get(name, ""))
            began = before.health is not None and health.uptime_s < before.health.uptime_s
            restarts, now_s = before.restarts + began, monotonic_s()
            refused = 0 if before.health is None or began else _refused(before.health)
            seen = before.health is not None and _refused(health) > refused
            known = {} if before.health is None or began else {i.topic: i.dropped for i in before.health.inputs}
            refused_s = now_s if seen or before.health is None else before.refused_s
            self._newest[name] = dataclasses.replace(
                before,
                health=health,
                silent_s=now_s,
                restarts=restarts,
                refused_s=refused_s,
                leaves_out=frozenset(i.topic for i in health.inputs if i.dropped > known.get(i.topic, 0)),
                epoch=epoch,
                restarted_s=now_s if began or before.health is None else before.restarted_s,
            )

    def cut_off(self) -> None:
        """Take note that no router answers: that nothing is heard meanwhile says nothing of the agents."""
        self._cut_off_s = monotonic_s()

    def note_present(self, present: Collection[str]) -> None:
        """Take over whose sessions are there, as `kind/instance`."""
        names = {name_of(*name.split("/")) for name in present}
        with self._lock:
            for name, fare in self._newest.items():
                appeared = name in names and not fare.present and fare.health is None
                since_s = monotonic_s() if appeared else fare.silent_s
                self._newest[name] = dataclasses.replace(fare, present=name in names, silent_s=since_s)

    def fares(self) -> list[Fare]:
        """How each agent fares: the expected ones in their order, then those that nobody expected."""
        now_s = monotonic_s()
        with self._lock:
            return [
                dataclasses.replace(
                    fare,
                    silent_s=now_s - max(fare.silent_s, self._cut_off_s),
                    refused_s=now_s - fare.refused_s,
                    restarted_s=now_s - fare.restarted_s,
                    replayed=fare.epoch in self._replays,
                )
                for fare in self._newest.values()
            ]

    def changes(self) -> list[str]:
        """Which agents fell silent, reported a fault or became well again since the last call, in plain words."""
        said: list[str] = []
        for fare in self.fares():
            before, self._told[fare.name] = self._told.get(fare.name, ""), fare.state
            if fare.state == before or (before in ("", STARTING) and fare.state in (WELL, STARTING)):
                continue
            since = f" for {fare.silent_s:.0f} s" if fare.silent_s > SILENT_S else ""
            said.append(f"{fare.name}: {'well again' if fare.state == WELL else fare.state + since}")
        return said


def _refused(health: AgentHealth) -> int:
    """How many messages it refused in all."""
    return sum(heard.refused for heard in health.inputs)


def name_of(kind: str, instance: str) -> str:
    """An agent as people call it."""
    return kind if instance == MAIN else f"{kind} {instance}"


def key_of(name: str) -> str:
    """An agent as people call it, as `kind/instance`."""
    kind, _, instance = name.partition(" ")
    return f"{kind}/{instance or MAIN}"


def agent_name(key: str) -> str:
    """`kind/instance` as people call it."""
    return name_of(*key.split("/"))


def health_table(fares: Iterable[Fare]) -> Table:
    """A row an agent; hosts have a column where there is more than one."""
    fares = list(fares)
    several = len({fare.host for fare in fares if fare.host}) > 1
    table = Table(box=None, pad_edge=False)
    for column in ("agent", *(["host"] if several else []), "state"):
        table.add_column(column, no_wrap=column != "state")
    for column in FIGURES:
        table.add_column(column, justify="right", no_wrap=True)
    for fare in fares:
        silent = "" if fare.silent_s <= SILENT_S else f" for {span_of(fare.silent_s)}"
        host = [fare.host or "-"] if several else []
        figures = ["-" if fare.health is None else figure(fare, fare.health) for figure in FIGURES.values()]
        table.add_row(fare.name, *host, fare.state + silent, *figures)
    return table


def _step(health: AgentHealth) -> str:
    return "-" if health.step_ms_p50 is None else f"{health.step_ms_p50:.1f}/{health.step_ms_p99 or 0:.1f}"


def _age(health: AgentHealth) -> str:
    # of what keeps coming: a state that came once grows no older
    ages = [i.age_ms for i in health.inputs if i.age_ms is not None and i.rate_hz > 0]
    return f"{max(ages):.0f}" if ages else "-"


FIGURES: dict[str, Callable[[Fare, AgentHealth], str]] = {
    "up": lambda _, health: span_of(health.uptime_s),
    "restarts": lambda fare, _: str(fare.restarts),
    "CPU %": lambda _, health: "-" if health.processor_share is None else f"{100 * health.processor_share:.0f}",
    "MB": lambda _, health: "-" if health.resident_bytes is None else f"{health.resident_bytes / 1e6:.0f}",
    "ms p50/p99": lambda _, health: _step(health),
    "in Hz": lambda _, health: " ".join(f"{i.rate_hz:.0f}" for i in health.inputs) or "-",
    "age ms": lambda _, health: _age(health),
    "dropped": lambda _, health: str(sum(i.dropped for i in health.inputs)),
    "missed": lambda _, health: str(sum(i.missed for i in health.inputs)),
    "refused": lambda _, health: str(_refused(health)),
    "out Hz": lambda _, health: " ".join(f"{o.rate_hz:.0f}" for o in health.outputs) or "-",
}
"""The columns of an agent that has told how it fares."""


def span_of(seconds: float) -> str:
    """A span of time as people read it."""
    for limit, unit, name in ((120, 1, "s"), (7200, 60, "min"), (172800, 3600, "h")):
        if seconds < limit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds / 86400:.0f} d"
