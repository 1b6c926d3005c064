"""What is wrong by the agents' own accounts and by their silence; `up` and `status` share this judgement."""

from collections.abc import Iterable, Iterator, Mapping, Set
from itertools import groupby

from agents.diagnostics.status.health_watch import ABSENT, GONE, HANGING, NEVER, SILENT, Fare, span_of
from agents.diagnostics.status.wrong import Wrong, listed
from schemas.messages import AgentHealth, InputHealth, OutputHealth
from schemas.topics import TOPICS

AWAY = (ABSENT, GONE, SILENT, NEVER)
Pair = tuple[str, str]
"""The hosts at both ends of a link, the sender's first."""
GUARD = "guard "
"""What the name of a guard begins with; its arm follows."""
SLOW_SHARE = 0.5
"""Below this share of its rate a topic is too slow."""
FILLED_SHARE = 0.8
"""Above this share of an agent's time its usual step explains how seldom it speaks."""
LASTS_S = 10.0
"""What was refused longer ago, with nothing since, is over, and a process that began anew longer ago runs."""
RESTARTED = "restarted"
SETTLED_S = 5.0
"""Rates are over two seconds, and sources and models take as long to begin."""
HOST_NEEDS = 2
"""How many agents of a host must be away before the host is named in their place; a single one may have died alone."""


def judge_agents(
    fares: Iterable[Fare],
    rates_hz: Mapping[str, float],
    addresses: Mapping[str, str] | None = None,
    late_s: Mapping[Pair, float] | None = None,
) -> Iterator[Wrong]:
    """What is wrong with these agents.

    `rates_hz` are those at which topics are expected, by name; `addresses` those of the rig's hosts; `late_s` for how
    long each link between two hosts has carried too little.
    """
    fares = tuple(fares)
    hosts = _hosts_away(fares) if addresses else {}
    for host, away in hosts.items():
        yield _host_away(host, (addresses or {}).get(host, ""), away)
    for fare in fares:
        if fare.placed not in hosts:
            yield from _presence(fare)
        if fare.health is not None and fare.state not in AWAY:
            yield from _own_account(fare, fare.health)
    yield from _links(fares, rates_hz, late_s or {})
    yield from _slow(fares, rates_hz)
    yield from _versions(fares)


def _hosts_away(fares: tuple[Fare, ...]) -> dict[str, tuple[Fare, ...]]:
    """The hosts of which nothing is heard, with what they run."""
    placed = sorted((f for f in fares if f.expected and f.placed), key=lambda f: f.placed)
    groups = {host: tuple(group) for host, group in groupby(placed, key=lambda f: f.placed)}
    return {h: g for h, g in groups.items() if len(g) >= HOST_NEEDS and all(f.state in AWAY for f in g)}


def _host_away(host: str, address: str, away: tuple[Fare, ...]) -> Wrong:
    names, at = listed(fare.name for fare in away), f" ({address})" if address else ""
    heard = [fare.silent_s for fare in away if fare.health is not None]
    if not heard:
        return Wrong("host", host, f"nothing is heard from host {host}{at}: none of {names} runs there, or it is away")
    last = f"{names} were last heard {span_of(min(heard))} ago"
    return Wrong("host", host, f"host {host}{at} is away: {last}; it is down, or its network is")


def _presence(fare: Fare) -> Iterator[Wrong]:
    name = f"{fare.name} on {fare.placed}" if fare.placed else fare.name
    since = span_of(fare.silent_s)
    if fare.expected and fare.name.startswith(GUARD) and fare.state in AWAY:
        arm = fare.name.removeprefix(GUARD)
        heard = f"{name} was last heard {since} ago" if fare.health is not None else f"nothing is heard of {name}"
        yield Wrong("guard", fare.name, f"no guard stands by {arm}: {heard}; run suturegrasp guard on its computer")
        return
    match fare.state:
        case s if s == ABSENT:
            if fare.expected:
                yield Wrong("absent", fare.name, f"{name} is not there: it does not run, is stopped, or is cut off")
        case s if s == GONE:
            gone = f"{name} is gone, last heard {since} ago: its process has ended, is stopped, or is cut off"
            yield Wrong("gone", fare.name, gone, grave=fare.expected)
        case s if s == HANGING:
            still = f"{name} is there and its loop has not turned for {since}"
            yield Wrong("hanging", fare.name, f"{still}: it hangs, is in one long step, or is not heard")
        case s if s in (SILENT, NEVER):
            heard = f"{name} has been silent for {since}" if fare.health else f"{name} was never heard of"
            yield Wrong("silent", fare.name, f"{heard}: it hangs, has ended, or is cut off")
        case _ if fare.restarts and fare.restarted_s <= LASTS_S:
            often = "" if fare.restarts == 1 else f", {fare.restarts} times since this watch began"
            anew = (
                f"{name} began anew {span_of(fare.restarted_s)} ago{often}: its process had ended, and its log says why"
            )
            yield Wrong(RESTARTED, fare.name, anew, grave=False)
        case _:
            pass


def _own_account(fare: Fare, health: AgentHealth) -> Iterator[Wrong]:
    name = fare.name
    since = f"since it started {span_of(health.uptime_s)} ago"
    if health.fault:
        yield Wrong("fault", name, f"{name} tells a fault: {health.fault}")
    for heard in health.inputs:
        topic = next((t for t in TOPICS if str(t) == heard.topic), None)
        if heard.refused:
            refused = f"{name} refused {_messages(heard.refused)} of {heard.topic} {since}"
            why = "another version sends them, an intruder, or a link that broke mixed keys up: its log says which"
            over = fare.refused_s > LASTS_S
            last = f", none for {span_of(fare.refused_s)}" if over else ""
            yield Wrong("refused", name, f"{refused}{last}: {why}", grave=not over)
        if topic is None:
            continue
        if heard.missed and topic.rate_hz is None:
            lost = f"{_messages(heard.missed)} of {heard.topic} never reached {name} {since}"
            yield Wrong("missed", name, f"{lost}, though none may be lost")
        if _is_old(heard, topic.maximum_age_ms):
            old = f"{heard.topic} reaches {name} {heard.age_ms:.0f} ms after it was sent"
            yield Wrong("old", heard.topic, f"{old}, where {topic.maximum_age_ms:.0f} ms are allowed")


def _is_old(heard: InputHealth, allowed_ms: float | None) -> bool:
    # what does not come any more is too slow; its last age says nothing of now
    return allowed_ms is not None and heard.rate_hz > 0 and heard.age_ms is not None and heard.age_ms > allowed_ms


def _messages(count: int) -> str:
    return f"{count} message{'' if count == 1 else 's'}"


def _slow(fares: tuple[Fare, ...], rates_hz: Mapping[str, float]) -> Iterator[Wrong]:
    """Topics that come too seldom, from agents that are there, each with what it waits for."""
    there = [(f, f.health) for f in fares if f.health is not None and f.state not in AWAY]
    steady = {o.topic for _, h in there for o in h.outputs if o.rate_hz >= SLOW_SHARE * rates_hz.get(o.topic, 0.0)}
    slow = rates_hz.keys() - steady
    for fare, health in there:
        if health.uptime_s < SETTLED_S:
            continue
        name = fare.name
        for output in health.outputs:
            expected = rates_hz.get(output.topic, 0.0)
            if output.rate_hz >= SLOW_SHARE * expected:
                continue
            of = f"{output.topic} of {name}" if " " in name else output.topic
            at = f"{output.rate_hz:.1f} Hz" if 0 < output.rate_hz < 1 else f"{output.rate_hz:.0f} Hz"
            text = f"{of} comes at {at}, where {expected:.0f} Hz are expected"
            yield Wrong("slow", output.topic, text + _because(fare, health, slow, output, rates_hz))


def _links(fares: tuple[Fare, ...], rates_hz: Mapping[str, float], late_s: Mapping[Pair, float]) -> Iterator[Wrong]:
    """Links that have carried too little for a while: after a break, rates of both ends are of different times."""
    for (one, other), told in late_links(fares, rates_hz).items():
        if late_s.get((one, other), 0.0) >= SETTLED_S:
            text = f"the link from {one} to {other} carries too little: {'; '.join(told)}"
            yield Wrong("link", f"{one} {other}", text)


def late_links(fares: Iterable[Fare], rates_hz: Mapping[str, float]) -> dict[Pair, list[str]]:
    """Links between hosts that carry too little now: what leaves as often as it should, and arrives half as often."""
    there = [
        (fare, fare.health) for fare in fares if fare.health is not None and fare.state not in AWAY and fare.placed
    ]
    sent: dict[str, list[tuple[Fare, float]]] = {}
    for fare, health in there:
        for output in health.outputs:
            if health.uptime_s >= SETTLED_S and output.rate_hz >= SLOW_SHARE * rates_hz.get(output.topic, float("inf")):
                sent.setdefault(output.topic, []).append((fare, output.rate_hz))
    late: dict[Pair, list[str]] = {}
    for fare, health in there:
        for heard in health.inputs if health.uptime_s >= SETTLED_S else ():
            # of two senders of one topic nobody knows which is meant
            if len(senders := sent.get(heard.topic, [])) != 1 or senders[0][0].placed == fare.placed:
                continue
            sender, rate_hz = senders[0]
            # what is left out for newer ones has arrived
            if heard.rate_hz < SLOW_SHARE * rate_hz and heard.topic not in fare.leaves_out:
                told = f"{heard.topic} leaves at {rate_hz:.0f} Hz and reaches {fare.name} at {heard.rate_hz:.0f} Hz"
                late.setdefault((sender.placed, fare.placed), []).append(told)
    return late


def _because(
    fare: Fare, health: AgentHealth, slow: Set[str], output: OutputHealth, rates_hz: Mapping[str, float]
) -> str:
    """What keeps an agent from its rate: what it waits for, or steps that fill its time; empty where neither does."""
    # what only follows from it, and comes back to it, it does not wait for
    before = {str(topic) for topic in TOPICS[: [str(topic) for topic in TOPICS].index(output.topic)]}
    mine = [heard for heard in health.inputs if heard.topic in before]
    if waits := [heard.topic for heard in mine if heard.topic in slow]:
        return f", for it waits for {listed(waits)}"
    # what leaves its sender as it should, and of which no message is left out here for a newer one
    late = [
        f"{heard.topic}, which reaches it at {heard.rate_hz:.0f} Hz"
        for heard in mine
        if heard.rate_hz < SLOW_SHARE * rates_hz.get(heard.topic, 0.0) and heard.topic not in fare.leaves_out
    ]
    if late:
        return f", for it waits for {listed(late)}"
    if health.step_ms_p50 is not None and health.step_ms_p50 * output.rate_hz > FILLED_SHARE * 1e3:
        return f", for a step takes {health.step_ms_p50:.0f} ms"
    return ""


def _versions(fares: tuple[Fare, ...]) -> Iterator[Wrong]:
    versions: dict[str, list[str]] = {}
    for fare in fares:
        if fare.health is not None and fare.state not in AWAY:
            versions.setdefault(fare.health.version, []).append(fare.name)
    if len(versions) > 1:
        each = "; ".join(f"{version} on {listed(names)}" for version, names in sorted(versions.items()))
        yield Wrong("version", "versions", f"versions differ: {each}; install one everywhere")
