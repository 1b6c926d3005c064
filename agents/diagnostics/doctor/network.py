"""Whether the links between a rig's hosts bear what crosses them, by what was measured and what the rig's file says.

What is measured passes beside all that flows at the moment. So a link bears what was measured, and what its hearers
tell that it carries besides.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from agents.configuration.hosts import kind_and_instance
from agents.configuration.rig import RigConfig
from agents.diagnostics.doctor.crossing import Crossing, crossings, rate_of, traffic
from agents.diagnostics.doctor.finding import UNKNOWN, Finding
from agents.diagnostics.status.agents import AWAY
from agents.diagnostics.status.gathered import Gathered
from agents.diagnostics.status.health_watch import key_of
from agents.diagnostics.status.wrong import listed
from shared.runtime.facts import Link

HEADERS = 1.05
"""What encryption and headers add, as measured between two sites (docs/performance.md)."""
ROOM = 0.7
"""The share of a link that steady streams may take: what bursts beside them comes late otherwise."""
LEAST_BYTES_PER_S = 1e5
"""What is less is no reason to look at a link."""
LARGEST = 3
OUT, INTO = "out of", "into"
REMEDY = (
    "have it wired to the router's switch, let its agents run nearer to what they hear, or lower camera.rate_hz or "
    "camera.jpeg_quality: docs/performance.md"
)


@dataclass(frozen=True)
class Way:
    """One direction of a host's link, in bytes a second.

    Fields:
        passes: measured beside what flows; None where nothing there answers.
        is_its_own: whether nothing else on the way that was measured could be what is slow.
        flows: what hearers tell that it carries.
        needed: by topic.
    """

    name: str
    passes: float | None
    is_its_own: bool
    flows: float
    needed: Mapping[str, float]

    @property
    def needs(self) -> float:
        """All of it together, headers included."""
        return HEADERS * sum(self.needed.values())


def networks(
    rig: RigConfig, measured: Mapping[str, Link | None], gathered: Gathered, bytes_of: Mapping[str, float]
) -> Iterator[Finding]:
    """One line for each host; `measured` by `kind/instance`, `bytes_of` by topic, as weighed."""
    if not rig.hosts or rig.host is None:
        return
    out, into = (_best(rig, measured, way) for way in ("bytes_per_s", "bytes_per_s_there"))
    flowing = flows(rig, gathered, bytes_of)
    for host, needed in traffic(rig, bytes_of).items():
        sides = (out, into) if host != rig.host else (into, out)
        ways = [
            Way(name, *_passes(rig, host, side, HEADERS * sum(of.values())), flowing.get((host, name), 0.0), of)
            for name, side, of in zip((OUT, INTO), sides, (needed.out, needed.into), strict=True)
        ]
        weighty = {topic for of in (needed.out, needed.into) for topic, rate in of.items() if rate > LEAST_BYTES_PER_S}
        assumed = sorted(weighty - bytes_of.keys())
        yield judged(host, ways, assumed, "" if rig.host == rig.router.host else rig.router.host or "")


def judged(host: str, ways: list[Way], assumed: list[str], elsewhere: str) -> Finding:
    """Whether a host's link bears what crosses it both ways; `elsewhere` is the host on which more could be told."""
    what = f"network of {host}"
    sizes = f"; sizes of {listed(assumed)} as the simulated field has them, for none came" if assumed else ""
    ways = [way for way in ways if way.needs > LEAST_BYTES_PER_S]
    if not ways:
        return Finding(what, "next to nothing of the rig's streams crosses it")
    if any(way.passes is None for way in ways):
        needs = " and ".join(f"{_mb(way.needs)} {way.name} it" for way in ways)
        return Finding(what, f"{UNKNOWN}, for nothing that runs there answers; needed are {needs}{sizes}")
    narrow = [way for way in ways if way.needs > ROOM * _bears(way)]
    told = "; ".join(_told(way) for way in narrow or ways) + sizes
    if not narrow:
        return Finding(what, told)
    if not all(way.is_its_own for way in narrow):
        where = f" (suturegrasp doctor on {elsewhere} can tell)" if elsewhere else ""
        return Finding(what, f"{UNKNOWN}, for another link on the way may be what is slow{where}: {told}")
    worst = "too slow" if any(way.needs > _bears(way) for way in narrow) else "tight"
    late = "newest messages are dropped, and what comes is late" if worst == "too slow" else "a burst makes them late"
    return Finding(what, f"{worst}: {told}", f"{late}; {REMEDY}")


def flows(rig: RigConfig, gathered: Gathered, bytes_of: Mapping[str, float]) -> dict[tuple[str, str], float]:
    """What the hosts' links carry, in bytes a second by host and way, by the account of those who hear it.

    What tells nothing of what it hears, as recorders, is taken to hear all of it while it is there.
    """
    there = {key_of(fare.name): fare.health for fare in gathered.fares if fare.state not in AWAY}
    heard: dict[tuple[str, str], float] = {}
    for name, health in there.items():
        for one in health.inputs if health is not None else ():
            came_hz = max(one.rate_hz, (one.received + one.dropped) / max(health.uptime_s, 1.0)) if health else 0.0
            heard[name, one.topic] = came_hz

    def carried(one: Crossing) -> float:
        expected_hz, topic = rate_of(rig, one.topic), str(one.topic)
        if one.is_said:
            came = [hz for (_, of), hz in heard.items() if of == topic]
            share = max(came, default=0.0) / expected_hz
        elif one.process in there or one.process in gathered.facts:
            share = heard.get((one.process, topic), expected_hz) / expected_hz
        else:
            share = 0.0
        return min(1.0, share) * one.bytes_per_s

    found: dict[tuple[str, str], float] = {}
    for one in crossings(rig, bytes_of):
        for host, way in ((one.host, one.is_said), (rig.router.host or "", not one.is_said)):
            of = host, OUT if way else INTO
            found[of] = found.get(of, 0.0) + HEADERS * carried(one)
    return found


def _best(rig: RigConfig, measured: Mapping[str, Link | None], way: str) -> dict[str, float]:
    """Of each host, the most that passed to or from any of its agents."""
    best: dict[str, float] = {}
    for host, section in rig.hosts.items():
        links = [measured.get("/".join(kind_and_instance(name, host))) for name in section.runs]
        passed = [getattr(link, way) for link in links if link is not None]
        if passed:
            best[host] = max(passed)
    return best


def _passes(rig: RigConfig, host: str, best: Mapping[str, float], needs: float) -> tuple[float | None, bool]:
    """What was measured of one way of a host's link, and whether that link alone could be what is slow."""
    here, router = rig.host, rig.router.host
    if host == router:
        # all hosts share its port, and no one of them shows how much that bears
        return max((passed for other, passed in best.items() if other != here), default=None), False
    if host == here:
        others = [passed for other, passed in best.items() if other != here]
        # what is slow to several hosts is what the ways to them have in common
        return max(others, default=None), router in best or len(others) > 1
    # what passes between here and another host shows that the link of this host is not what is slow
    beside = [passed for other, passed in best.items() if other not in (here, host)]
    return best.get(host), here == router or max(beside, default=0.0) * ROOM >= needs


def _bears(way: Way) -> float:
    return (way.passes or 0.0) + way.flows


def _told(way: Way) -> str:
    largest = sorted(way.needed.items(), key=lambda item: -item[1])[:LARGEST]
    each = ", ".join(f"{topic} {1e-6 * HEADERS * rate:.1f}" for topic, rate in largest)
    flow = f" beside {_mb(way.flows)} that flow" if way.flows > LEAST_BYTES_PER_S else ""
    return f"{_mb(way.passes or 0.0)} pass {way.name} it{flow}, and {_mb(way.needs)} are needed ({each})"


def _mb(rate: float) -> str:
    return f"{1e-6 * rate:.1f} MB/s" if rate < 1e7 else f"{1e-6 * rate:.0f} MB/s"
