"""Any one process killed in mid-session: the others survive, the robot holds, and what is started again rejoins."""

import pytest

from agents.operator.operator import ask_for_grasp
from schemas.messages import ExecutionKind, Outcome, Policy, RobotMode, Status
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
# what it takes to start all processes, and to wait for a plan, may both fall to one test
pytestmark = [pytest.mark.rig, pytest.mark.timeout(600)]
FEEDS_THREADS = ("simulator", "camera", "perception", "reconstruction")


@pytest.fixture(scope="module")
def rig(processes, hosts, until):
    """A rig whose router runs; a port that was free may be taken by the time that the router listens on it."""

    def started():
        rig = hosts.small_rig(free_local_endpoint())
        processes.config.write_text(rig.model_dump_json(exclude_none=True))
        router = processes.start("router")
        listens = f"router on {rig.router.endpoint}"
        return rig if until(lambda: listens in processes.said("router") or router.poll()) is True else None

    return until(started, "a router on a free port")


@pytest.fixture(scope="module")
def ear(rig, processes, listening, until):
    """A whole session in processes of their own, once a first thread has been reconstructed."""
    for name in AGENTS:
        processes.start(name)
    ear = listening(rig)
    until(lambda: threads(ear), f"the first thread; ended so far: {processes.ended()}")
    until(lambda: set(ear.health()) == set(AGENTS.values()), "the health of all agents")
    return ear


def threads(ear):
    return [t for t in ear.messages(THREAD) if t.status is Status.OK]


@pytest.fixture
def planned(ear, hosts, until):
    """A plan that can be armed."""

    def ask():
        for s in (0.5, 0.4, 0.6, 0.3, 0.7):
            answer, plan = ask_for_grasp(ear.connection, "psm1", Policy.CAPTURE_SLIDE_GRASP, s=s)
            if answer.outcome is Outcome.ACCEPTED and plan is not None and plan.status is Status.OK:
                return plan
        return None

    return lambda: until(ask, "a plan", hosts.GOAL_DEADLINE_S)


def test_the_robot_holds_when_the_operator_is_killed_in_mid_motion(ear, processes, planned, until):
    def states():
        return ear.messages(ROBOT_STATE)

    def in_motion():
        """The id of a plan that is carried out. On a machine that stalls, the arm may hold before it is looked at."""
        plan_id = planned().plan_id
        arm = processes.start("arm", plan_id)
        until(
            lambda: arm.poll() is not None or any((s.plan_id, s.mode) == (plan_id, RobotMode.MOVING) for s in states())
        )
        return arm.poll() is None and plan_id

    plan_id = until(in_motion, "the arm to move")
    processes.kill("arm")

    def held():
        return [e for e in ear.messages(EXECUTION) if e.plan_id == plan_id and e.kind is ExecutionKind.HELD]

    (event,) = until(held, "the arm to hold")
    assert event.code == "heartbeat_lost"
    until(lambda: states()[-1].mode is RobotMode.HOLDING and states()[-1].measured_ns > event.at_ns, "a state of it")
    assert not [s for s in states() if s.measured_ns > event.at_ns and s.mode is RobotMode.MOVING]


@pytest.mark.parametrize("name", AGENTS)
def test_the_others_survive_and_the_restarted_agent_rejoins(name, ear, processes, until):
    processes.kill(name)
    killed = AGENTS[name]
    before = {kind: health.heartbeat for kind, health in ear.health().items() if kind != killed}

    def others_go_on():
        return all(ear.health()[kind].heartbeat > beats for kind, beats in before.items())

    until(others_go_on, f"the health of the others after {name}")
    assert not processes.ended()
    assert not [h.fault for h in ear.health().values() if h.agent != killed and h.fault]
    uptime_s = ear.health()[killed].uptime_s
    seen, observed = len(threads(ear)), len(ear.messages(OBSERVATIONS))
    processes.start(name)
    until(lambda: ear.health()[killed].uptime_s < uptime_s, f"the health of the restarted {name}")

    def why():
        return [(m.stamp.sequence, m.status, m.reason) for t in (OBSERVATIONS, THREAD) for m in ear.messages(t)[-2:]]

    try:
        until(lambda: len(threads(ear)) > seen + 2 and len(ear.messages(OBSERVATIONS)) > observed + 2, "new threads")
    except AssertionError as error:
        raise AssertionError(f"{error}; last: {why()}") from error


def test_a_goal_is_planned_after_every_agent_was_restarted(planned):
    assert planned().waypoints


@pytest.mark.essential
def test_a_router_that_was_killed_and_started_again_finds_all_agents(ear, processes, planned, until):
    processes.kill("router")
    processes.start("router")
    seen = len(threads(ear))
    until(lambda: len(threads(ear)) > seen + 3, "threads through the new router")
    before = {kind: health.heartbeat for kind, health in ear.health().items()}
    until(lambda: all(h.heartbeat > before[k] for k, h in ear.health().items()), "everyone's health")
    assert not processes.ended()
    plan_id = planned().plan_id
    until(lambda: plan_id in {p.plan_id for p in ear.messages(PLAN)}, "the plan to be heard")
