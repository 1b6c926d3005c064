"""A rig as its deployment sees it: hosts, what runs on each, and where they meet."""

from dataclasses import dataclass

from agents.deployment.robot_zenoh import ROBOT_ZENOH, ReachedArm
from schemas.topics import MAIN
from shared.runtime.access import ALONE, Sites, common_name

ROUTER = "router"
ROUTER_NAME = common_name(ROUTER)
SERVERS = (ROUTER, ROBOT_ZENOH)
"""What others look up by its host's address; all others only call."""
ANSWERING = (*SERVERS, "operator")
"""Whose certificates hold for its host's address: the page is served with the operator's (docs/running.md)."""


@dataclass(frozen=True)
class Process:
    """Something that runs on a host.

    Fields:
        kind: such as `camera`, `robot_bridge`, `recorder`, `operator`, `router`.
        instance: `main`, the arm, or for what may run on several hosts the host's name.
    """

    kind: str
    instance: str = MAIN

    @property
    def common_name(self) -> str:
        """What its certificate is called."""
        return common_name(self.kind, self.instance)


@dataclass(frozen=True)
class Host:
    """One machine of a rig.

    Fields:
        address: by which the others reach it.
        processes: what runs on it, the router included.
        realtime: whether its agents are given real-time priority.
        arms: whose consoles run there.
    """

    name: str
    address: str
    processes: tuple[Process, ...]
    realtime: bool = False
    arms: tuple[ReachedArm, ...] = ()


@dataclass(frozen=True)
class Layout:
    """A whole rig.

    Fields:
        endpoint: of the router, as Zenoh writes it.
        leaf_days, authority_days: how long certificates are valid.
        calibration: of the camera, beside the rig's file; empty where there is none.
        sites: what the router has to do with those of other sites.
    """

    rig: str
    endpoint: str
    hosts: tuple[Host, ...]
    leaf_days: int
    authority_days: int
    calibration: str = ""
    sites: Sites = ALONE

    def common_names(self) -> list[str]:
        """The names of all that connects to the router."""
        return [p.common_name for host in self.hosts for p in host.processes if p.kind not in SERVERS]
