"""Hosts whose file of the rig is another than the one here, as far as agents tell with which they began."""

from collections.abc import Iterator

from agents.configuration.digest import differing
from agents.diagnostics.status.gathered import Gathered
from agents.diagnostics.status.health_watch import agent_name
from agents.diagnostics.status.wrong import Wrong, listed

HERE = "here"
FEWEST_ALIKE = 2
"""So many hosts that agree with each other and not with this one have the right file, more likely than not."""


def judge_files(gathered: Gathered) -> Iterator[Wrong]:
    """What is wrong with the files of a rig's hosts; of agents that do not tell, nothing."""
    told = {name: facts for name, facts in gathered.facts.items() if facts.rig_sections}
    placed = {fare.name: fare.placed for fare in gathered.fares}
    others: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    digests = set[frozenset[str]]()
    hosts = set[str]()
    for name, facts in told.items():
        called = agent_name(name)
        host = placed.get(called) or facts.host
        hosts.add(host)
        digests.add(frozenset(f"{section.name} {section.digest}" for section in facts.rig_sections))
        if apart := differing(gathered.rig_sections, facts.rig_sections):
            others.setdefault((host, apart), []).append(called)
    if len(digests) == 1 and len(others) == len(hosts) >= FEWEST_ALIKE:
        ((_, apart), *_) = others
        text = f"the file of the rig here differs from the one that every agent began with, in {_sections(apart)}"
        yield Wrong("file", HERE, f"{text}; take theirs, or restart them if they began before it was changed")
        return
    for (host, apart), names in others.items():
        them = "it" if len(names) == 1 else "them"
        text = f"{listed(names)} on {host} began with another file of the rig than the one here, and they differ in"
        yield Wrong("file", host, f"{text} {_sections(apart)}; take the right one there and restart {them}")


def _sections(names: tuple[str, ...]) -> str:
    return listed("the rig's name" if name == "rig" else f"[{name}]" for name in names)
