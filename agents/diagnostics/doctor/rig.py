"""What the doctor finds across a rig that runs: agents, versions, clocks, links, streams, and what each was granted."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from agents.configuration.rig import RigConfig
from agents.configuration.topics import overrides
from agents.diagnostics.doctor.finding import UNKNOWN, Finding
from agents.diagnostics.status.agents import AWAY
from agents.diagnostics.status.calibrations import DAY_NS, Allowed, allowed_ages, too_old
from agents.diagnostics.status.files import HERE, judge_files
from agents.diagnostics.status.gathered import Gathered, placed_agents
from agents.diagnostics.status.health_watch import REPLAYED, Fare, agent_name, span_of
from agents.diagnostics.status.judgement import (
    CLOCKS_APART_MS,
    LEAST_FREE_BYTES,
    NS_PER_S,
    SYNCHRONISE,
    expiry,
    judge,
    topics_told_otherwise,
)
from agents.diagnostics.status.wrong import listed
from agents.registry import kind_of
from schemas.messages import AgentFacts
from schemas.topics import TOPICS
from shared.runtime.clocks import ClockOffset, by_host
from shared.runtime.facts import Link

SLOW_LINK_MS = 50.0
"""A quarter of what an operator's heartbeat may take until the arm holds."""
MOST_TOLD = 1e10
"""In bytes a second: shared memory, of which a clock tells no more."""
OF_STATUS = ("hanging", "slow", "old", "missed", "refused", "fault", "error", "arm", "held")
"""What the judgement of `status` finds and nothing here does."""
INSTALL = "install one version everywhere, and restart the agents"


def running(rig: RigConfig, fares: Iterable[Fare], here: str, other_rigs: Sequence[str] = ()) -> Iterator[Finding]:
    """Which agents of the rig's file are there. Where none is, nobody has started it yet, which is no fault.

    Where agents of other rigs are there on the same router, the file names another rig than runs.
    """
    fares = tuple(fares)
    replayed = {fare.name for fare in fares if fare.state == REPLAYED}
    placed = {name: host for name, host in placed_agents(rig).items() if name not in replayed}
    there = [fare for fare in fares if fare.state not in (*AWAY, REPLAYED)]
    if not there:
        if other_rigs:
            remedy = f"name {listed(other_rigs)} as rig in the file, or give this rig a router of its own"
            yield Finding("running agents", f"none of rig {rig.rig}, but of rig {listed(other_rigs)}", remedy)
            return
        yield Finding("running agents", f"none of rig {rig.rig}; suturegrasp up starts those of this machine")
        return
    for host in sorted({*placed.values(), *("" for fare in there if not fare.placed)}):
        names = sorted(f.name for f in there if f.placed == host)
        missing = sorted(name for name, where in placed.items() if where == host and name not in names)
        what = f"agents on {host}{' (here)' if host == here else ''}" if host else "running agents"
        yield Finding(what, ", ".join(names) or "none", _to_start(missing, host))


def _to_start(missing: list[str], host: str) -> str:
    """The remedy where agents do not run; empty where none is missing."""
    if not missing:
        return ""
    what = f"{listed(missing)} {'does' if len(missing) == 1 else 'do'} not run"
    if not host:
        return f"{what}; start {'it' if len(missing) == 1 else 'them'} with suturegrasp up"
    return f"{what}; on {host}, systemctl start suturegrasp.target starts what is installed, and suturegrasp up else"


def guards(rig: RigConfig, gathered: Gathered) -> Iterator[Finding]:
    """Whether a guard stands by each arm that needs one and answers; of a rig that nobody has started, nothing."""
    fares = {fare.name: fare for fare in gathered.fares if fare.state not in AWAY}
    if not fares:
        return
    for arm, section in rig.robot.items():
        if section.dvrk is None or section.dvrk.dry_run:
            continue
        what, name = f"guard of {arm}", f"guard {arm}"
        there, told = fares.get(name), gathered.facts.get(f"guard/{arm}")
        if there is None:
            run = f"run suturegrasp guard --arm {arm} on the robot's computer, before anything is armed"
            yield Finding(what, "none stands by", run)
        elif there.health is None or told is None:
            yield Finding(what, "is there and gives no answer", "restart it, and arm nothing until it answers")
        elif there.health.fault:
            yield Finding(what, f"stands by on {there.host}, and guards nothing", there.health.fault)
        else:
            yield Finding(what, f"stands by on {there.host}, reaches the arm's Zenoh, and answers")


def versions(facts: Mapping[str, AgentFacts], version: str, schemas_hash: str, zenoh: str) -> Iterator[Finding]:
    """Whether all agents run what is installed here, given its versions."""
    if not facts:
        return
    told: tuple[tuple[str, str, Callable[[AgentFacts], str]], ...] = (
        ("versions", version, lambda f: f.version),
        ("schemas", schemas_hash, lambda f: f.schemas_hash),
        ("Zenoh", zenoh, lambda f: f.zenoh),
    )
    for what, here, of in told:
        others: dict[str, list[str]] = {}
        for name, one in facts.items():
            if of(one) != here:
                others.setdefault(of(one), []).append(agent_name(name))
        each = "; ".join(f"{other} on {listed(names)}" for other, names in sorted(others.items()))
        yield Finding(what, f"{here} here, {each}" if each else f"{here} everywhere", INSTALL if each else "")


def clocks(offsets: Mapping[str, ClockOffset | None], here: str) -> Iterator[Finding]:
    """The clocks of the hosts of these agents by the one here; what cannot be told is unknown."""
    for name in (name for name, offset in offsets.items() if offset is None):
        yield Finding(f"clock of {name}", f"{UNKNOWN}, for it gives no answer")
    hosts = by_host(offset for offset in offsets.values() if offset is not None)
    # of this host itself there is nothing to say, unless another one has its name
    others = [h for h in hosts if h.host != here or h.least_ms > CLOCKS_APART_MS]
    for offset in others:
        way = "ahead of" if offset.ahead_ms > 0 else "behind"
        apart = f"{abs(offset.ahead_ms):.0f} ms {way} this host"
        found, remedy = f"{apart}, give or take {offset.within_ms:.1f} ms", ""
        if offset.least_ms > CLOCKS_APART_MS:
            remedy = SYNCHRONISE
        elif abs(offset.ahead_ms) + offset.within_ms > CLOCKS_APART_MS:
            found = f"{UNKNOWN}, for its answer takes {2 * offset.within_ms:.0f} ms"
        yield Finding(f"clock of {offset.host}", found, remedy)
    if not others:
        yield Finding("clocks of other hosts", f"{UNKNOWN}, for no agent answers from another host")


def topics(rig: RigConfig, facts: Mapping[str, AgentFacts]) -> Iterator[Finding]:
    """What the rig does otherwise with topics than their table says, and who was told something else."""
    here = overrides(rig.topics)
    each = ", ".join(f"{one} (the table: {str(one.table).lower()})" for one in here)
    yield Finding("topics", f"otherwise than the table: {each}" if here else "all as the table says")
    for wrong in topics_told_otherwise(here, facts):
        began, _, remedy = wrong.text.partition("; ")
        yield Finding(f"topics of {wrong.about}", began, remedy)


def files(gathered: Gathered) -> Iterator[Finding]:
    """Whether all agents began with the file of the rig that is here."""
    what = "file of the rig"
    wrongs = list(judge_files(gathered))
    for wrong in wrongs:
        began, _, remedy = wrong.text.partition("; ")
        yield Finding(f"{what} on {wrong.about}" if wrong.about != HERE else f"{what} here", began, remedy)
    silent = [agent_name(name) for name, facts in gathered.facts.items() if not facts.rig_sections]
    if silent:
        yield Finding(what, f"{UNKNOWN} of {listed(silent)}, whose version does not tell")
    elif gathered.facts and not wrongs:
        yield Finding(what, "every agent began with the same as here")


def links(measured: Mapping[str, Link | None]) -> Iterator[Finding]:
    """How far away each agent is, by what was measured."""
    for name, link in measured.items():
        what = f"link to {agent_name(name)}"
        if link is None:
            yield Finding(what, f"{UNKNOWN}, for it gives no answer, or not in time")
            continue
        took = f"{link.latency_ms:.1f} ms there and back (99 % within {link.latency_ms_p99:.1f} ms)"
        slow = link.latency_ms > SLOW_LINK_MS
        remedy = (
            "look at the network, and at how busy both hosts are: an arm holds where answers are late" if slow else ""
        )
        much = f"{_megabytes(link.bytes_per_s)} from it, {_megabytes(link.bytes_per_s_there)} to it"
        yield Finding(what, f"{took}, {much}", remedy)


def streams(gathered: Gathered) -> Iterator[Finding]:
    """How old each stream is where it arrives, and what status finds wrong."""
    for fare in gathered.fares:
        heard = fare.health.inputs if fare.health is not None and fare.state not in AWAY else ()
        for one in heard:
            topic = next((t for t in TOPICS if str(t) == one.topic), None)
            if topic is None or topic.rate_hz is None:
                continue
            what = f"stream {one.topic} to {fare.name}"
            if one.rate_hz == 0 or one.age_ms is None:
                # what people send rests most of the time
                resting = kind_of(topic.agent) is None
                none = "none was taken in the last two seconds"
                yield Finding(what, none if resting else f"{UNKNOWN}, for {none}")
            else:
                yield Finding(what, f"{one.rate_hz:.3g} Hz, {one.age_ms:.1f} ms after it was sent")
    for wrong in judge(gathered):
        if wrong.code in OF_STATUS and wrong.grave:
            yield Finding(f"status ({wrong.code})", wrong.text, "suturegrasp status shows whether it lasts")


def granted(facts: Mapping[str, AgentFacts], rig: RigConfig, at_ns: int) -> Iterator[Finding]:
    """What each agent's process was granted where it runs, by its own account."""
    yield from _shared_memory(facts)
    realtime = {name for host in rig.hosts.values() if host.realtime for name in host.runs}
    placed, allowed = placed_agents(rig), allowed_ages(rig)
    for name, one in facts.items():
        called = agent_name(name)
        if one.realtime_asked is not None or one.realtime_granted is not None:
            had = one.realtime_granted is not None
            found = f"priority {one.realtime_granted}" if had else f"asked for {one.realtime_asked}, and not granted"
            yield Finding(f"real time for {called}", found, "" if had else one.realtime_reason or "it was not granted")
        elif called in realtime and placed.get(called):
            yield Finding(f"real time for {called}", "it has not asked for it, as its host's section wants")
        if one.disk_free_bytes is not None:
            free = f"{one.disk_free_bytes / (1 << 30):.1f} GiB free in {one.writes_to}"
            yield Finding(f"disk of {called}", free, "make room" if one.disk_free_bytes < LEAST_FREE_BYTES else "")
        if (limit := allowed.get(name)) is not None:
            yield _calibration(called, limit, one.calibrated_ns, at_ns)
        if one.certificate_expires_ns is not None:
            left_s = (one.certificate_expires_ns - at_ns) / NS_PER_S
            wrong = expiry(called, one.certificate_expires_ns, at_ns)
            found = f"expires in {span_of(left_s)}" if left_s > 0 else "has expired"
            renew = "renew it with suturegrasp deploy certificates, take it there, and restart the agent"
            yield Finding(f"certificate that {called} runs with", found, renew if wrong else "")


def _calibration(called: str, allowed: Allowed, made_ns: int | None, at_ns: int) -> Finding:
    what = f"calibration of {called}"
    if made_ns is None:
        return Finding(what, f"{UNKNOWN} when it was made: {allowed.untold}")
    if made_ns > at_ns + DAY_NS:
        return Finding(what, f"{UNKNOWN} how old it is, for by its file it is yet to be made; are all clocks set?")
    if old := too_old(allowed, made_ns, at_ns):
        return Finding(what, old, allowed.remedy)
    return Finding(what, f"made {span_of(max(0.0, (at_ns - made_ns) / NS_PER_S))} ago, {allowed.words}")


def _shared_memory(facts: Mapping[str, AgentFacts]) -> Iterator[Finding]:
    reasons: dict[tuple[bool, str], list[str]] = {}
    for name, one in facts.items():
        reasons.setdefault((one.shared_memory, one.shared_memory_reason), []).append(agent_name(name))
    for (used, reason), names in sorted(reasons.items(), reverse=True):
        yield Finding("shared memory", f"{'used' if used else 'not used'} by {listed(names)}: {reason}")


def _megabytes(rate: float) -> str:
    if rate > MOST_TOLD:
        return f"over {1e-6 * MOST_TOLD:.0f} MB/s"
    return f"{1e-6 * rate:.{0 if rate > 1e7 else 2}f} MB/s"
