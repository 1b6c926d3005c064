"""The dataflow on two hosts with the router between them; network namespaces stand for the hosts."""

import os
import shutil
import subprocess

import pytest

from schemas.messages import Status
from schemas.topics import PLAN, THREAD

SUBNET, PORT = "10.213.77", 7447
FIELD, BRAIN = "sgfield", "sgbrain"
ON = {
    FIELD: (("simulator",), ("camera",), ("robot-bridge",)),
    BRAIN: (("perception",), ("reconstruction",), ("planner",)),
}


def ip(*words):
    """Run `ip`; whether it succeeded, and what it said."""
    done = subprocess.run(["ip", *words], capture_output=True, text=True, timeout=10.0, check=False)  # noqa: S607
    return done.returncode == 0, done.stderr.strip()


def built(name, address):
    """A namespace that reaches the bridge; raises where the system does not let us."""
    outside, inside = f"{name}o", f"{name}i"
    for words in (
        ("netns", "add", name),
        ("link", "add", outside, "type", "veth", "peer", "name", inside),
        ("link", "set", inside, "netns", name),
        ("link", "set", outside, "master", "sgbridge", "up"),
        ("-n", name, "address", "add", f"{SUBNET}.{address}/24", "dev", inside),
        ("-n", name, "link", "set", inside, "up"),
        ("-n", name, "link", "set", "lo", "up"),
    ):
        succeeded, said = ip(*words)
        if not succeeded:
            pytest.skip(f"this system makes no network namespaces: ip {' '.join(words)}: {said}")


def torn_down():
    for name in (FIELD, BRAIN):
        ip("link", "delete", f"{name}o")
        ip("netns", "delete", name)
    ip("link", "delete", "sgbridge")


@pytest.fixture(scope="module")
def namespaces():
    """Two namespaces on a bridge and the command that runs in each; the bridge is in ours. Removed in the end."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root")
    if shutil.which("ip") is None:
        pytest.skip("network namespaces need the command ip (Debian: iproute2)")
    torn_down()
    try:
        for words in (
            ("link", "add", "sgbridge", "type", "bridge"),
            ("address", "add", f"{SUBNET}.1/24", "dev", "sgbridge"),
            ("link", "set", "sgbridge", "up"),
        ):
            succeeded, said = ip(*words)
            if not succeeded:
                pytest.skip(f"this system makes no bridge: ip {' '.join(words)}: {said}")
        for address, name in enumerate((FIELD, BRAIN), start=2):
            built(name, address)
        yield {name: ("ip", "netns", "exec", name) for name in ON}
    finally:
        torn_down()


@pytest.fixture(scope="module")
def ear(namespaces, processes, listening, hosts):
    """The agents of both hosts, once a thread has been reconstructed from frames of the other one."""
    rig = hosts.small_rig(f"tcp/{SUBNET}.1:{PORT}")
    processes.config.write_text(rig.model_dump_json(exclude_none=True))
    processes.start("router")
    for name, agents in ON.items():
        for agent in agents:
            processes.start(*agent, inside=namespaces[name])
    ear = listening(rig)
    hosts.wait_for(lambda: any(t.status is Status.OK for t in ear.messages(THREAD)), "the first thread")
    hosts.wait_for(lambda: len(ear.health()) == 6, "the health of all agents")
    return ear


@pytest.mark.usefixtures("ear")
def test_neither_host_reaches_the_other_but_through_the_router(namespaces):
    """Agents connect to the router alone: a listening socket besides it would be another way in."""
    for inside in namespaces.values():
        done = subprocess.run(
            [*inside, "cat", "/proc/net/tcp"],
            capture_output=True,
            text=True,
            timeout=10.0,
            check=True,
        )
        sockets = [line.split() for line in done.stdout.splitlines()[1:]]
        remote_ports = {int(s[2].split(":")[1], 16) for s in sockets}
        assert remote_ports == {PORT}


@pytest.mark.parametrize("side", ON)
def test_a_goal_from_either_host_gets_a_plan(side, namespaces, ear, processes, hosts):
    before = len(ear.of(PLAN))
    for s in ("0.5", "0.4", "0.6", "0.3"):
        goal = processes.start("goal", "--s", s, inside=namespaces[side])
        status = goal.wait(hosts.DEADLINE_S)
        if status == 0:
            break
    assert status == 0, processes.said("goal")
    plan = hosts.wait_for(lambda: ear.messages(PLAN)[before:], "the plan")[-1]
    assert plan.status is Status.OK
    assert f"plan {plan.plan_id}: " in processes.said("goal")


def test_no_agent_ended_and_nothing_was_lost_unaccounted(ear, processes):
    assert set(processes.ended()) <= {"goal"}
    assert not [h.fault for h in ear.health().values() if h.fault]
    assert not [i for h in ear.health().values() for i in h.inputs if i.refused]
