"""What is wrong with a rig, in plain words: a pure function of what was heard of it."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from agents.configuration.topics import Override, in_words
from agents.diagnostics.status.agents import judge_agents
from agents.diagnostics.status.calibrations import too_old
from agents.diagnostics.status.files import judge_files
from agents.diagnostics.status.gathered import FROZEN, ArmHeard, Gathered
from agents.diagnostics.status.health_watch import SILENT_S, agent_name, name_of, span_of
from agents.diagnostics.status.tool import judge_tool
from agents.diagnostics.status.wrong import Wrong, listed
from agents.robot_bridge.plans import Code
from schemas.messages import AgentFacts, ExecutionKind, LogLevel, LogRecord, RobotMode
from schemas.topics import HEALTH
from shared.runtime.clocks import ClockOffset, by_host

CLOCKS_APART_MS = 100.0
"""Half of what a heartbeat may take; where clocks are farther apart, what is fresh soon seems old, or yet to come."""
LEAST_FREE_BYTES = 2 << 30
EXPIRES_SOON_S = 5 * 86400.0
"""Certificates are renewed with a third of their 30 days left; with less than this, nobody does so."""
NOBODY_S = SILENT_S - 1.0 / (HEALTH.rate_hz or 1.0)
"""Before any agent is silent for long, it is known that all are."""
SAID_S = 60.0
"""How long an error that an agent logged is told."""
NS_PER_S = 1e9
ROUTER = "router"
SYNCHRONISE = "synchronise both with chrony (chronyc tracking tells how far each is off)"


def judge(gathered: Gathered) -> list[Wrong]:
    """Everything that is wrong, the gravest first; where no router answers, that alone, as all follows from it."""
    if not gathered.router:
        at = f" on host {gathered.router_host}" if gathered.router_host else ""
        away = f"no router answers on {gathered.endpoint}{at}, so nothing is known of the rig"
        return [Wrong("router", "router", away)]
    if cut_off := _nothing_heard(gathered):
        return [cut_off]
    replayed, gathered = _replay(gathered), gathered.without_replayed()
    found = [
        *_other_rigs(gathered),
        *_faulty_images(gathered),
        *judge_agents(gathered.fares, gathered.rates_hz, gathered.addresses, gathered.late_s),
        *replayed,
        *_arms(gathered),
        *_clocks(gathered),
        *_schemas(gathered),
        *topics_told_otherwise(gathered.overrides, gathered.facts),
        *judge_files(gathered),
        *(wrong for name, facts in gathered.facts.items() for wrong in _facts(name, facts, gathered.at_ns)),
        *_calibrations(gathered),
        *_own_certificate(gathered),
        *_logged(gathered),
    ]
    return sorted(found, key=lambda wrong: not wrong.grave)


def _nothing_heard(gathered: Gathered) -> Wrong | None:
    """That nothing comes through a router on another host, where so: its session outlives its link by seconds."""
    heard = [fare.silent_s for fare in gathered.fares if fare.health is not None]
    if not gathered.router_host or len(heard) < 2 or min(heard) <= NOBODY_S:
        return None
    text = (
        f"nothing is heard from any host: the router's host {gathered.router_host} is away, or all agents are stopped"
    )
    return Wrong("router", gathered.router_host, text)


def _replay(gathered: Gathered) -> list[Wrong]:
    """That a recording is replayed into the rig, and which agents it stands for."""
    if not gathered.replayed:
        return []
    names = listed(gathered.replayed)
    text = f"a recording is replayed into this rig and stands for {names}: what they tell is of then, and is not judged"
    return [Wrong("replay", "replay", text, grave=False)]


def _faulty_images(gathered: Gathered) -> list[Wrong]:
    """What keeps perception from using the camera's images, and an arm from being moved by them."""
    said = [(one, f"{one.finding}; {one.remedy}") for one in gathered.faults]
    return [
        Wrong("images", one.code, f"the camera stands still: {text}", grave=bool(gathered.arms))
        if one.code == FROZEN
        else Wrong("images", one.code, f"the images are of no use: {text}")
        for one, text in said
    ]


def _other_rigs(gathered: Gathered) -> list[Wrong]:
    """That agents of another rig are on the router, where so, and none of this one's."""
    if not gathered.other_rigs:
        return []
    names = listed(gathered.other_rigs)
    text = f"no agent of rig {gathered.rig} is on {gathered.endpoint}, and those of rig {names} are: name it as rig"
    return [Wrong("rig", names, f"{text} in the file, or give this rig a router of its own")]


def apart(offset: ClockOffset, of: str = "this host's") -> str:
    """How far a clock is from another one, in words."""
    way = "ahead of" if offset.ahead_ms > 0 else "behind"
    return f"{abs(offset.ahead_ms):.0f} ms {way} {of}, give or take {offset.within_ms:.1f} ms"


def expiry(name: str, expires_ns: int, at_ns: int) -> Wrong | None:
    """What is wrong with a certificate that ends then, if anything."""
    left_s = (expires_ns - at_ns) / NS_PER_S
    remedy = "renew it with suturegrasp deploy certificates"
    if left_s <= 0:
        return Wrong("certificate", name, f"the certificate of {name} has expired; {remedy}")
    if left_s < EXPIRES_SOON_S:
        return Wrong("certificate", name, f"the certificate of {name} expires in {span_of(left_s)}; {remedy}")
    return None


def _arms(gathered: Gathered) -> Iterator[Wrong]:
    for arm in gathered.arms:
        mode = arm.state.mode if arm.state is not None else None
        if mode is RobotMode.HOLDING:
            yield _held(arm, gathered.at_ns)
        elif mode in (RobotMode.FAULT, RobotMode.DISABLED):
            word = "has a fault" if mode is RobotMode.FAULT else "is disabled"
            yield Wrong("arm", arm.arm, f"{arm.arm} {word} and cannot be armed; its controller says why{_why(arm)}")

        yield from judge_tool(arm, gathered.at_ns)


def _held(arm: ArmHeard, at_ns: int) -> Wrong:
    event = arm.event
    if event is None or event.kind is not ExecutionKind.HELD:
        return Wrong("held", arm.arm, f"{arm.arm} holds, as it was told to; arm a plan to go on", grave=False)
    since = span_of(max(0.0, (at_ns - event.at_ns) / NS_PER_S))
    text = f"{arm.arm} has held for {since} ({event.code}): {event.reason}; arm a plan to go on"
    return Wrong("held", arm.arm, text, grave=event.code != Code.HOLD_COMMAND)


def _why(arm: ArmHeard) -> str:
    event = arm.event
    held = event is not None and event.kind in (ExecutionKind.HELD, ExecutionKind.REFUSED)
    return f" (last: {event.reason})" if event is not None and held else ""


def _clocks(gathered: Gathered) -> Iterator[Wrong]:
    offsets = list(by_host(o for o in gathered.clocks.values() if o is not None))
    named = {offset.host for offset in offsets if offset.least_ms > CLOCKS_APART_MS}
    if ours := _own_clock([offset for offset in offsets if offset.host != gathered.here]):
        yield ours
        return
    for offset in offsets:
        if offset.host in named:
            yield Wrong("clock", offset.host, f"the clock of host {offset.host} is {apart(offset)}; {SYNCHRONISE}")
    for clock in gathered.planner_clocks.clocks if gathered.planner_clocks is not None else ():
        if clock.ahead_ms is None or clock.within_ms is None or clock.host in named:
            continue
        offset = ClockOffset(clock.host, clock.ahead_ms, clock.within_ms)
        if offset.least_ms > CLOCKS_APART_MS:
            named.add(offset.host)
            text = f"the clock of host {offset.host} is {apart(offset, 'the planner')}; {SYNCHRONISE}"
            yield Wrong("clock", offset.host, text)


def _own_clock(offsets: Sequence[ClockOffset]) -> Wrong | None:
    """That the clock here is off, where it is off all others', and they agree; None where that is not so."""
    ahead_ms = [offset.ahead_ms for offset in offsets]
    if len(offsets) < 2 or any(offset.least_ms <= CLOCKS_APART_MS for offset in offsets):
        return None
    if max(ahead_ms) - min(ahead_ms) > CLOCKS_APART_MS + 2 * max(offset.within_ms for offset in offsets):
        return None
    off = f"{abs(np.median(ahead_ms)):.0f} ms {'behind' if np.median(ahead_ms) > 0 else 'ahead of'}"
    text = f"the clock of this machine is {off} those of all other hosts, which agree; {SYNCHRONISE}"
    return Wrong("clock", "here", text)


def _schemas(gathered: Gathered) -> Iterator[Wrong]:
    hashes: dict[str, list[str]] = {}
    for name, facts in gathered.facts.items():
        hashes.setdefault(facts.schemas_hash, []).append(agent_name(name))
    if len(hashes) > 1:
        each = "; ".join(f"{told} on {listed(names)}" for told, names in sorted(hashes.items()))
        yield Wrong("schemas", "schemas", f"schemas differ: {each}; install one version everywhere")


def topics_told_otherwise(here: Iterable[Override], facts: Mapping[str, AgentFacts]) -> Iterator[Wrong]:
    """Agents whose rig's file says other things of topics than the one here."""
    own = {str(one) for one in here}
    for name, told in facts.items():
        if (theirs := {in_words(one) for one in told.overrides}) != own:
            apart = listed([*(f"{one} (here)" for one in sorted(own - theirs)), *sorted(theirs - own)])
            agent = agent_name(name)
            text = f"{agent} began with another file of the rig than the one here, and they differ in {apart}"
            yield Wrong("topics", agent, f"{text}; take the right one there and restart it")


def _facts(name: str, facts: AgentFacts, at_ns: int) -> Iterator[Wrong]:
    called = agent_name(name)
    if facts.disk_free_bytes is not None and facts.disk_free_bytes < LEAST_FREE_BYTES:
        free = f"{facts.disk_free_bytes / (1 << 30):.1f} GiB are free where {called} writes ({facts.writes_to})"
        yield Wrong("disk", called, f"{free}; make room, a minute of everything takes some 700 MB")
    if facts.realtime_asked is not None and facts.realtime_granted is None:
        refused = f"{called} asked for real-time priority {facts.realtime_asked} and has none"
        yield Wrong("realtime", called, f"{refused}: {facts.realtime_reason}")
    if facts.certificate_expires_ns is not None and (wrong := expiry(called, facts.certificate_expires_ns, at_ns)):
        yield wrong


def _calibrations(gathered: Gathered) -> Iterator[Wrong]:
    """Those that are older than the rig's file allows: worth knowing, for whether they are off only a check tells."""
    for name, allowed in gathered.calibrations.items():
        facts = gathered.facts.get(name)
        made_ns = facts.calibrated_ns if facts is not None else None
        if made_ns is not None and (old := too_old(allowed, made_ns, gathered.at_ns)):
            called = agent_name(name)
            yield Wrong("calibration", called, f"the calibration of {called} was {old}; {allowed.remedy}", grave=False)


def _own_certificate(gathered: Gathered) -> Iterator[Wrong]:
    if gathered.here_expires_ns is not None and (w := expiry("operator", gathered.here_expires_ns, gathered.at_ns)):
        yield w


def _logged(gathered: Gathered) -> Iterator[Wrong]:
    """Each error once, and the last warning of each agent; a router warns of links that it refused, which is grave."""
    faults = {fare.health.fault for fare in gathered.fares if fare.health is not None and fare.health.fault}
    ages = [(record, max(0.0, (gathered.at_ns - record.at_ns) / NS_PER_S)) for record in gathered.said]
    recent = [(record, age_s) for record, age_s in ages if age_s <= SAID_S and record.text not in faults]
    groups: dict[tuple[str, ...], list[tuple[LogRecord, float]]] = {}
    for record, age_s in recent:
        error = record.level is LogLevel.ERROR
        group = (record.agent, record.instance, "error", record.text) if error else (record.agent, record.instance)
        groups.setdefault(group, []).append((record, age_s))
    for told in groups.values():
        record, age_s = told[-1]
        error, called = record.level is LogLevel.ERROR, name_of(record.agent, record.instance)
        times = f" {len(told)} times, last" if len(told) > 1 else ""
        first_line = record.text.split("\n")[0]
        said = f"{called} {'told an error' if error else 'warned'}{times} {span_of(age_s)} ago: {first_line}"
        yield Wrong("error" if error else "warning", called, said, grave=error or record.agent == ROUTER)
