"""What `suturegrasp status` shows: tables and sentences for people, one document of JSON for programs."""

import dataclasses
import datetime
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from agents.diagnostics.status.agents import judge_agents
from agents.diagnostics.status.gathered import ArmHeard, Gathered
from agents.diagnostics.status.health_watch import STARTING, Fare, health_table, key_of
from agents.diagnostics.status.tool import tool_told
from agents.diagnostics.status.wrong import Wrong, listed
from shared.runtime.clocks import ClockOffset, by_host

WELL = "all is well"


def watched(fares: Sequence[Fare], rates_hz: Mapping[str, float]) -> RenderableType:
    """What `up` shows: a row an agent, and what is wrong by their own accounts."""
    return Group(health_table(fares), Text(), *_lines(judge_agents(fares, rates_hz), fares))


def report(gathered: Gathered, wrongs: Iterable[Wrong]) -> RenderableType:
    """A row an agent, a row a host where there are several, and below them what is wrong."""
    at = datetime.datetime.fromtimestamp(gathered.at_ns * 1e-9).strftime("%H:%M:%S")
    parts: list[RenderableType] = [Text(f"rig {gathered.rig}, router {gathered.endpoint}, {at}")]
    if gathered.overrides:
        parts.append(Text(f"otherwise than the table of topics: {', '.join(map(str, gathered.overrides))}"))
    if gathered.router:
        parts += [Text(), health_table(gathered.fares)]
        hosts = hosts_of(gathered)
        if len(hosts) > 1:
            parts += [Text(), _host_table(hosts)]
    return Group(*parts, Text(), *_lines(wrongs, gathered.fares))


def document(gathered: Gathered, wrongs: Iterable[Wrong]) -> dict[str, Any]:
    """The same as JSON can hold it; docs/diagnostics.md tells the fields."""
    wrongs = list(wrongs)
    return {
        "at_ns": gathered.at_ns,
        "rig": gathered.rig,
        "router": {"endpoint": gathered.endpoint, "answers": gathered.router},
        "well": _well(wrongs, gathered.fares),
        "agents": [_agent(fare, gathered) for fare in gathered.fares],
        "hosts": hosts_of(gathered),
        "arms": [_arm(arm) for arm in gathered.arms],
        "topics": [dataclasses.asdict(one) for one in gathered.overrides],
        "wrong": [_wrong(wrong) for wrong in wrongs if wrong.grave],
        "notes": [_wrong(wrong) for wrong in wrongs if not wrong.grave],
    }


def hosts_of(gathered: Gathered) -> list[dict[str, Any]]:
    """Each host with its clock by the one here, and what runs there."""
    hosts: dict[str, list[Fare]] = {}
    for fare in gathered.fares:
        if fare.host:
            hosts.setdefault(fare.host, []).append(fare)
    return [_host(host, hosts[host], gathered.clocks) for host in sorted(hosts)]


def _host(host: str, fares: list[Fare], clocks: Mapping[str, ClockOffset | None]) -> dict[str, Any]:
    told = [offset for fare in fares if (offset := clocks.get(key_of(fare.name))) is not None]
    # two machines that were given one name show the worse of them
    worst = max(by_host(told), key=lambda offset: offset.least_ms, default=None)
    ahead_ms, within_ms = (None, None) if worst is None else (round(worst.ahead_ms, 3), round(worst.within_ms, 3))
    machines = sorted({fare.health.host for fare in fares if fare.health is not None})
    names = [fare.name for fare in fares]
    return {"host": host, "machine": " ".join(machines), "agents": names, "ahead_ms": ahead_ms, "within_ms": within_ms}


def _lines(wrongs: Iterable[Wrong], fares: Iterable[Fare]) -> list[Text]:
    unheard = _unheard(fares)
    nothing = f"{listed(unheard)} {'was' if len(unheard) == 1 else 'were'} not heard yet" if unheard else WELL
    return [Text(f"{'WRONG' if wrong.grave else 'note':5}  {wrong.text}") for wrong in wrongs] or [Text(nothing)]


def _well(wrongs: Iterable[Wrong], fares: Iterable[Fare]) -> bool | None:
    """Whether nothing is wrong; None where that is too early to say."""
    if any(wrong.grave for wrong in wrongs):
        return False
    return None if _unheard(fares) else True


def _unheard(fares: Iterable[Fare]) -> list[str]:
    return [fare.name for fare in fares if fare.expected and fare.state == STARTING]


def _host_table(hosts: list[dict[str, Any]]) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("host", "clock ahead ms", "give or take ms", "agents"):
        table.add_column(column, justify="right" if "ms" in column else "left")
    for host in hosts:
        clock = ("-", "-") if host["ahead_ms"] is None else (f"{host['ahead_ms']:.1f}", f"{host['within_ms']:.1f}")
        table.add_row(host["host"], *clock, ", ".join(host["agents"]))
    return table


def _agent(fare: Fare, gathered: Gathered) -> dict[str, Any]:
    told = {
        "name": fare.name,
        "state": fare.state,
        "host": fare.health.host if fare.health is not None else None,
        "placed": fare.placed or None,
        "expected": fare.expected,
        "present": fare.present,
        "restarts": fare.restarts,
        "heard_s": None if fare.health is None else round(fare.silent_s, 3),
    }
    health = None if fare.health is None else dataclasses.asdict(fare.health)
    facts = gathered.facts.get(key_of(fare.name))
    return told | {"health": health, "facts": None if facts is None else dataclasses.asdict(facts)}


def _arm(arm: ArmHeard) -> dict[str, Any]:
    state, event = arm.state, arm.event
    last = None
    if event is not None:
        last = {"kind": event.kind.name.lower(), "at_ns": event.at_ns, "plan_id": event.plan_id}
        last |= {"code": event.code, "reason": event.reason}
    mode = None if state is None else state.mode.name.lower()
    told = {"arm": arm.arm, "mode": mode, "plan_id": state.plan_id if state else "", "last_event": last}
    return told | {"tool": tool_told(arm)}


def _wrong(wrong: Wrong) -> dict[str, str]:
    return {"code": wrong.code, "about": wrong.about, "text": wrong.text}
