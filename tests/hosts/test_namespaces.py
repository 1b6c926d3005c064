"""The dataflow on four hosts with the router on a fifth, secured as in a lab; network namespaces are the hosts."""

import itertools
import subprocess

import pytest

from benchmarks.faults.rig import MODULE, ROUTER, RUNS
from schemas.messages import Status
from schemas.topics import HEALTH, PLAN

PORT = 7447
# what it takes to start all processes, and to wait for a plan, may both fall to one test
pytestmark = pytest.mark.timeout(600)
SIDES = tuple(host for host in RUNS if host != ROUTER)


@pytest.mark.parametrize("side", SIDES)
def test_a_host_reaches_the_others_only_through_the_router(side, lab):
    """Agents connect to the router alone: a listening socket besides it would be another way in."""
    command = [*lab.network.inside(side), "cat", "/proc/net/tcp"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=True)
    sockets = [line.split() for line in done.stdout.splitlines()[1:]]
    assert {int(s[2].split(":")[1], 16) for s in sockets} == {PORT}


@pytest.mark.parametrize("side", ["strong", "desk"])
def test_a_goal_from_any_host_gets_a_plan(side, lab, hosts, until):
    before = len(list(lab.observer.messages(PLAN)))
    places = itertools.cycle(("0.5", "0.4", "0.6", "0.3"))

    def asked():
        command = (*MODULE, "goal", "--s", next(places), "--config", str(lab.config(side)))
        return lab.processes.start(side, "goal", *command).wait(hosts.DEADLINE_S) == 0

    def told():
        plans = [h.message for h in itertools.islice(lab.observer.messages(PLAN), before, None)]
        return any(f"plan {p.plan_id}: " in lab.processes.said("goal") for p in plans if p.status is Status.OK)

    until(asked, "a plan", hosts.GOAL_DEADLINE_S)
    until(told, "the plan to be heard beside it")
    lab.processes.forget("goal")


def test_no_agent_ended_and_nothing_was_lost_unaccounted(lab):
    assert not lab.processes.all_ended()
    newest = {heard.message.agent: heard.message for heard in lab.observer.messages(HEALTH)}
    assert not [health.fault for health in newest.values() if health.fault]
    assert not [i for health in newest.values() for i in health.inputs if i.refused]
