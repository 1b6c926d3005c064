"""The dataflow on two hosts with the router between them; network namespaces stand for the hosts."""

import dataclasses
import itertools
import os
import random
import re
import shutil
import subprocess
from pathlib import Path

import psutil
import pytest

from schemas.messages import Status
from schemas.topics import PLAN, THREAD

PREFIX, NETWORK, PORT = "sg", "10.213", 7447
# what it takes to start all processes, and to wait for a plan, may both fall to one test
pytestmark = pytest.mark.timeout(600)
ON = {
    "field": (("simulator",), ("camera",), ("robot-bridge",)),
    "brain": (("perception",), ("reconstruction",), ("planner",)),
}


@dataclasses.dataclass(frozen=True)
class Hosts:
    """Two namespaces on a bridge, named after the process of the tests, on a network that nobody uses."""

    bridge: str
    network: str
    names: dict[str, str]

    @property
    def endpoint(self):
        """Of the router, which is in our own namespace."""
        return f"tcp/{self.network}.1:{PORT}"

    def inside(self, side):
        """What comes before a command that is to run there."""
        return ("ip", "netns", "exec", self.names[side])


def ip(*words):
    """Run `ip`; whether it succeeded, and what it said."""
    done = subprocess.run(["ip", *words], capture_output=True, text=True, timeout=60.0, check=False)  # noqa: S607
    return done.returncode == 0, done.stderr.strip()


def made(*words):
    """Run `ip`; skip where the system does not let us."""
    succeeded, said = ip(*words)
    if not succeeded:
        pytest.skip(f"this system makes no network namespaces: ip {' '.join(words)}: {said}")


def free_network():
    """The first three numbers of a network that no interface of this system is in."""
    said = subprocess.run(["ip", "-4", "-oneline", "address"], capture_output=True, text=True, check=True).stdout  # noqa: S607
    free = [f"{NETWORK}.{number}" for number in range(256) if f" {NETWORK}.{number}." not in said]
    return random.SystemRandom().choice(free)


def built(hosts, name, address):
    """A namespace that reaches the bridge."""
    outside, inside = f"{name}o", f"{name}i"
    made("netns", "add", name)
    made("link", "add", outside, "type", "veth", "peer", "name", inside)
    made("link", "set", inside, "netns", name)
    made("link", "set", outside, "master", hosts.bridge, "up")
    made("-n", name, "address", "add", f"{hosts.network}.{address}/24", "dev", inside)
    made("-n", name, "link", "set", inside, "up")
    made("-n", name, "link", "set", "lo", "up")


def torn_down(owner):
    """Remove what the process of that id has made."""
    for side in ON:
        name = f"{PREFIX}{owner}{side[0]}"
        ip("link", "delete", f"{name}o")
        ip("netns", "delete", name)
    ip("link", "delete", f"{PREFIX}{owner}")


def left_behind():
    """The ids of processes that were killed before they could tear down."""
    names = [path.name for path in (*Path("/run/netns").glob(f"{PREFIX}*"), *Path("/sys/class/net").glob(f"{PREFIX}*"))]
    owners = {int(found[1]) for name in names if (found := re.fullmatch(rf"{PREFIX}(\d+)[a-z]*", name))}
    return [owner for owner in owners if not psutil.pid_exists(owner)]


@pytest.fixture(scope="module")
def namespaces():
    """Two namespaces on a bridge, removed in the end."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root")
    if shutil.which("ip") is None:
        pytest.skip("network namespaces need the command ip (Debian: iproute2)")
    for owner in left_behind():
        torn_down(owner)
    mine = f"{PREFIX}{os.getpid()}"
    hosts = Hosts(mine, free_network(), {side: f"{mine}{side[0]}" for side in ON})
    try:
        made("link", "add", hosts.bridge, "type", "bridge")
        made("address", "add", f"{hosts.network}.1/24", "dev", hosts.bridge)
        made("link", "set", hosts.bridge, "up")
        for address, name in enumerate(hosts.names.values(), start=2):
            built(hosts, name, address)
        yield hosts
    finally:
        torn_down(os.getpid())


@pytest.fixture(scope="module")
def ear(namespaces, processes, listening, hosts, until):
    """The agents of both hosts, once a thread has been reconstructed from frames of the other one."""
    rig = hosts.small_rig(namespaces.endpoint)
    processes.config.write_text(rig.model_dump_json(exclude_none=True))
    processes.start("router")
    for side, agents in ON.items():
        for agent in agents:
            processes.start(*agent, inside=namespaces.inside(side))
    ear = listening(rig)
    until(lambda: any(t.status is Status.OK for t in ear.messages(THREAD)), "the first thread")
    until(lambda: len(ear.health()) == 6, "the health of all agents")
    return ear


@pytest.mark.usefixtures("ear")
def test_neither_host_reaches_the_other_but_through_the_router(namespaces):
    """Agents connect to the router alone: a listening socket besides it would be another way in."""
    for side in ON:
        done = subprocess.run(
            [*namespaces.inside(side), "cat", "/proc/net/tcp"],
            capture_output=True,
            text=True,
            timeout=60.0,
            check=True,
        )
        sockets = [line.split() for line in done.stdout.splitlines()[1:]]
        remote_ports = {int(s[2].split(":")[1], 16) for s in sockets}
        assert remote_ports == {PORT}


@pytest.mark.parametrize("side", ON)
def test_a_goal_from_either_host_gets_a_plan(side, namespaces, ear, processes, hosts, until):
    before = len(ear.messages(PLAN))
    places = itertools.cycle(("0.5", "0.4", "0.6", "0.3"))

    def asked():
        goal = processes.start("goal", "--s", next(places), inside=namespaces.inside(side))
        return goal.wait(hosts.DEADLINE_S) == 0

    def told():
        plans = [p for p in ear.messages(PLAN)[before:] if p.status is Status.OK]
        return any(f"plan {p.plan_id}: " in processes.said("goal") for p in plans)

    until(asked, "a plan", hosts.GOAL_DEADLINE_S)
    until(told, "the plan to be heard beside it")


def test_no_agent_ended_and_nothing_was_lost_unaccounted(ear, processes):
    assert set(processes.ended()) <= {"goal"}
    assert not [h.fault for h in ear.health().values() if h.fault]
    assert not [i for h in ear.health().values() for i in h.inputs if i.refused]
