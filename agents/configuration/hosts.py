"""Which machine runs what, as the `[hosts]` of a rig's configuration say, checked as a whole.

An agent that publishes runs once: two would own one topic. Recorders, viewers and operators may be on several hosts.
"""

import difflib
import ipaddress
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from agents.deployment.places import AUTHORITY_FOLDER
from schemas.topics import MAIN
from shared.runtime.config import Settings, spelled

OPERATOR, ROUTER = "operator", "router"
LOCALHOST = "localhost"
UNREACHED = "is no address that other hosts reach this one by; write the one it has on the lab's network (ip address)"
RUN = spelled(r"[a-z_]+( [a-z0-9_]+)?", "a section's name, and an arm's after a space: camera, robot_bridge psm1")
BESIDE = (OPERATOR, "recorder", "viewer")
"""What publishes nothing that another one could publish too; each host's own has the host's name as its instance."""
HOST_NAME = re.compile(r"(?=.{1,253}$)[A-Za-z0-9]([A-Za-z0-9-]{0,62})(\.[A-Za-z0-9-]{1,63})*")
ENDS_AS_NUMBERS_DO = re.compile(r"(^|\.)(0[xX][0-9a-fA-F]+|[0-9]+)$|\.[0-9][^.]*$")
"""What does is an IP address with a slip, and no name: the last of a name's parts begins with a letter (RFC 3696)."""
Name = Annotated[str, spelled(r"[a-z0-9_]{1,40}", "small letters, digits and _ alone, 40 at most, such as video_2")]
"""A certificate's name has room for 64 letters (RFC 5280), of which an agent's kind takes some."""
HostName = Name
"""A host of the rig as its own file calls it; it is part of keys and of certificates' names."""


def _address(address: str) -> str:
    try:
        ip = ipaddress.ip_address(address)
    except ValueError:
        if HOST_NAME.fullmatch(address) is None or ENDS_AS_NUMBERS_DO.search(address) is not None:
            raise ValueError(f"{address!r} is no address; write an IP address or a host name alone") from None
        if address == LOCALHOST or address.endswith(f".{LOCALHOST}"):
            raise ValueError(f"{address} {UNREACHED}") from None
        return address
    ip = getattr(ip, "ipv4_mapped", None) or ip
    # one of IPv6 that holds for one cable alone needs that named too, which each host calls otherwise
    of_a_cable = ip.version == 6 and ip.is_link_local
    if ip.is_unspecified or ip.is_loopback or ip.is_multicast or of_a_cable or (ip.version == 4 and ip.is_reserved):
        raise ValueError(f"{address} {UNREACHED}")
    return address


class HostSection(Settings):
    """One machine: how others reach it, what runs on it, and whether what moves a robot gets real-time priority."""

    address: Annotated[str, AfterValidator(_address)]
    runs: tuple[Annotated[str, RUN], ...] = ()
    realtime: bool = False


class SecuritySection(Settings):
    """Where certificates lie on each host, and how long those of agents are valid."""

    certificates: Path = Path("certificates")
    leaf_days: int = Field(default=30, ge=1, le=397)
    authority_days: int = Field(default=3650, ge=30, le=7300)

    @model_validator(mode="after")
    def _authority_outlives_what_it_signs(self) -> "SecuritySection":
        if self.authority_days <= self.leaf_days:
            days = f"authority_days = {self.authority_days} and leaf_days = {self.leaf_days}"
            raise ValueError(f"{days}: no certificate holds for longer than its authority; let that last for years")
        return self


def kind_and_instance(name: str, host: str = MAIN) -> tuple[str, str]:
    """`robot_bridge psm1` as kind and instance; what has no instance is `main`, or of its host."""
    kind, _, instance = name.partition(" ")
    return kind, instance or (host if kind in BESIDE else MAIN)


def run_name(kind: str, instance: str) -> str:
    """A process as `runs` writes it."""
    return kind if instance == MAIN else f"{kind} {instance}"


def host_fault(hosts: Mapping[str, HostSection], configured: Iterable[str]) -> str:
    """What is wrong with who runs where, in one sentence; empty where nothing is.

    `configured` are the processes that the configuration has a section for, as `runs` writes them.
    """
    configured = set(configured)
    if AUTHORITY_FOLDER in hosts:
        return (
            f"no host may be called {AUTHORITY_FOLDER!r}: its folder would hold the authority's key; call it otherwise"
        )
    if twice := [(host, name) for host, s in hosts.items() for name, times in Counter(s.runs).items() if times > 1]:
        return f"{twice[0][0]} runs {twice[0][1]!r} twice; leave it there once"
    counted = Counter(name for host in hosts.values() for name in host.runs)
    for name in counted:
        if name not in configured and name != OPERATOR:
            return f"{_on(hosts, name)} runs {name!r}, {_without_section(name, configured)}"
        if counted[name] > 1 and name not in BESIDE:
            twice = f"{name!r} runs on {_on(hosts, name)}: what it publishes would have two owners"
            return f"{twice}; leave it in the runs of one host"
    if idle := sorted(configured - set(counted)):
        return f"no host runs {idle[0]!r}; put it in the runs of one of {', '.join(hosts)}"
    addresses = Counter(host.address for host in hosts.values())
    if shared := [address for address, count in addresses.items() if count > 1]:
        return f"two hosts have the address {shared[0]}; what runs on one machine belongs in one section"
    return ""


def _without_section(name: str, configured: set[str]) -> str:
    """What is wrong with that, and what was meant perhaps."""
    if name == ROUTER:
        return "which is no agent; name its host in router.host, and take it out of runs"
    near = [one for one in sorted(configured) if one.split()[0] == name] or difflib.get_close_matches(
        name, (*configured, OPERATOR), n=1
    )
    meant = f"did you mean {near[0]!r}? else " if near else ""
    return f"for which there is no section; {meant}add it, or take it out of runs"


def _on(hosts: Mapping[str, HostSection], name: str) -> str:
    return " and ".join(host for host, section in hosts.items() for run in section.runs if run == name)
