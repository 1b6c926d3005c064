"""Any one process killed in mid-session: the others survive, the robot holds, and what is started again rejoins."""

import pytest

from agents.operator.operator import ask_for_grasp
from schemas.codec import decode
from schemas.messages import (
    ExecutionEvent,
    ExecutionKind,
    Outcome,
    Policy,
    RobotMode,
    Status,
)
from schemas.topics import EXECUTION, OBSERVATIONS, PLAN, ROBOT_STATE, THREAD
from shared.runtime.session import free_local_endpoint

AGENTS = {
    "simulator": "simulator",
    "camera": "camera",
    "perception": "perception",
    "reconstruction": "reconstruction",
    "planner": "planner",
    "robot-bridge": "robot_bridge",
}
"""Commands, and the kinds of agents that they run."""
FEEDS_THREADS = ("simulator", "camera", "perception", "reconstruction")


@pytest.fixture(scope="module")
def rig(hosts):
    return hosts.small_rig(free_local_endpoint())


@pytest.fixture(scope="module")
def ear(rig, processes, listening, hosts):
    """A whole session in processes of their own, once a first thread has been reconstructed."""
    processes.config.write_text(rig.model_dump_json(exclude_none=True))
    for name in ("router", *AGENTS):
        processes.start(name)
    ear = listening(rig)
    hosts.wait_for(lambda: threads(ear), f"the first thread; ended so far: {processes.ended()}")
    hosts.wait_for(lambda: set(ear.health()) == set(AGENTS.values()), "the health of all agents")
    return ear


def threads(ear):
    return [t for t in ear.messages(THREAD) if t.status is Status.OK]


def planned(ear, hosts):
    """A plan that can be armed."""

    def ask():
        for s in (0.5, 0.4, 0.6, 0.3, 0.7):
            answer, plan = ask_for_grasp(ear.connection, "psm1", Policy.CAPTURE_SLIDE_GRASP, s=s)
            if answer.outcome is Outcome.ACCEPTED and plan is not None and plan.status is Status.OK:
                return plan
        return None

    return hosts.wait_for(ask, "a plan")


def test_the_robot_holds_when_the_operator_is_killed_in_mid_motion(ear, processes, hosts):
    plan = planned(ear, hosts)
    processes.start("arm", "--plan", plan.plan_id)

    def states():
        return [s for s in ear.messages(ROBOT_STATE) if s.plan_id == plan.plan_id]

    hosts.wait_for(lambda: any(s.mode is RobotMode.MOVING for s in states()), "the arm to move")
    processes.kill("arm")

    def held():
        events = [decode(ExecutionEvent, t.payload) for t in ear.of(EXECUTION)]
        return [e for e in events if e.plan_id == plan.plan_id and e.kind is ExecutionKind.HELD]

    (event,) = hosts.wait_for(held, "the arm to hold")
    assert event.code == "heartbeat_lost"
    moving = [s.measured_ns for s in states() if s.mode is RobotMode.MOVING]
    last = [s for s in ear.messages(ROBOT_STATE) if s.measured_ns > max(moving)]
    hosts.wait_for(lambda: ear.messages(ROBOT_STATE)[-1].mode is RobotMode.HOLDING, "the state to say so")
    assert not [s for s in last if s.mode is RobotMode.MOVING]


@pytest.mark.parametrize("name", AGENTS)
def test_the_others_survive_and_the_restarted_agent_rejoins(name, ear, processes, hosts):
    processes.kill(name)
    killed = AGENTS[name]
    before = {kind: health.heartbeat for kind, health in ear.health().items() if kind != killed}

    def others_go_on():
        return all(ear.health()[kind].heartbeat > beats for kind, beats in before.items())

    hosts.wait_for(others_go_on, f"the health of the others after {name}")
    assert not processes.ended()
    assert not [h.fault for h in ear.health().values() if h.agent != killed and h.fault]
    uptime_s = ear.health()[killed].uptime_s
    seen, observed = len(threads(ear)), len(ear.of(OBSERVATIONS))
    processes.start(name)
    hosts.wait_for(lambda: ear.health()[killed].uptime_s < uptime_s, f"the health of the restarted {name}")
    hosts.wait_for(lambda: len(threads(ear)) > seen + 2 and len(ear.of(OBSERVATIONS)) > observed + 2, "new threads")


def test_a_goal_is_planned_after_every_agent_was_restarted(ear, hosts):
    assert planned(ear, hosts).waypoints


def test_a_router_that_was_killed_and_started_again_finds_all_agents(ear, processes, hosts):
    processes.kill("router")
    processes.start("router")
    seen = len(threads(ear))
    hosts.wait_for(lambda: len(threads(ear)) > seen + 3, "threads through the new router")
    before = {kind: health.heartbeat for kind, health in ear.health().items()}
    hosts.wait_for(lambda: all(h.heartbeat > before[k] for k, h in ear.health().items()), "everyone's health")
    assert not processes.ended()
    assert planned(ear, hosts).plan_id in {p.plan_id for p in ear.messages(PLAN)}
