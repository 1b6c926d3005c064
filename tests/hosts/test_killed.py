"""A process killed in mid-session: the others survive, what is started again rejoins, and who stands by is missed."""

import pytest

from agents.configuration.rig import ArmSection, CameraSection, RouterSection, SimulatorSection, simulated_rig
from agents.operator.operator import ask_for_grasp
from schemas.messages import ExecutionKind, Outcome, Policy, RobotMode, Status
from schemas.topics import EXECUTION, HEALTH, PLAN, ROBOT_STATE, THREAD
from shared.runtime.session import free_local_endpoint
from tests.hosts.conftest import DEADLINE_S, GOAL_DEADLINE_S

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


@pytest.fixture(scope="module")
def rig(processes, until):
    """A rig whose router runs, with few enough frames for two cores, and plans that may wait."""

    def started():
        # a port that was free may be taken by the time that the router listens on it
        sections = {
            "router": RouterSection(endpoint=free_local_endpoint(), start=False),
            "camera": CameraSection(rate_hz=5.0),
            "robot": {"psm1": ArmSection(maximum_plan_age_s=DEADLINE_S)},
            "simulator": SimulatorSection(config="easy", background="plain"),
        }
        rig = simulated_rig().model_copy(update=sections)
        processes.config.write_text(rig.model_dump_json(exclude_none=True))
        router = processes.start("router")
        listens = f"router on {rig.router.endpoint}"
        return rig if until(lambda: listens in processes.said("router") or router.poll()) is True else None

    return until(started, "a router on a free port")


@pytest.fixture(scope="module")
def heard(rig, processes, listening, until):
    """What is said in a whole session in processes of their own, once a first thread has been reconstructed."""
    for name in AGENTS:
        processes.start(name)
    heard = listening(rig)
    until(lambda: threads(heard), f"the first thread; ended so far: {processes.ended()}")
    until(lambda: set(health(heard)) == set(AGENTS.values()), "the health of all agents")
    return heard


def messages(heard, topic):
    return [one.message for one in heard.messages(topic)]


def threads(heard):
    return [t for t in messages(heard, THREAD) if t.status is Status.OK]


def health(heard):
    """The newest by kind."""
    return {health.agent: health for health in messages(heard, HEALTH)}


@pytest.fixture
def planned(heard, until):
    """A plan that can be armed, asked for whenever there is a newer thread."""

    def ask():
        seen = len(threads(heard))
        until(lambda: len(threads(heard)) > seen, "a newer thread")
        for s in (0.5, 0.4, 0.6, 0.3, 0.7):
            answer, plan = ask_for_grasp(heard.connection, "psm1", Policy.CAPTURE_SLIDE_GRASP, s=s)
            if answer.outcome is Outcome.ACCEPTED and plan is not None and plan.status is Status.OK:
                return plan
        return None

    return lambda: until(ask, "a plan", GOAL_DEADLINE_S)


@pytest.fixture
def in_motion(heard, processes, planned, until):
    """The id of a plan that is being carried out."""

    def begun():
        """The id of a plan that is carried out. On a machine that stalls, the arm may hold before it is looked at."""
        plan_id = planned().plan_id
        arm = processes.start("arm", plan_id)
        moving = plan_id, RobotMode.MOVING
        until(
            lambda: arm.poll() is not None or any((s.plan_id, s.mode) == moving for s in messages(heard, ROBOT_STATE))
        )
        return arm.poll() is None and plan_id

    return until(begun, "the arm to move")


def test_the_robot_holds_when_the_operator_is_killed_in_mid_motion(heard, processes, in_motion, until):
    plan_id = in_motion
    processes.kill("arm")

    def held():
        return [e for e in messages(heard, EXECUTION) if e.plan_id == plan_id and e.kind is ExecutionKind.HELD]

    def modes():
        return [s.mode for s in messages(heard, ROBOT_STATE) if s.measured_ns > event.at_ns]

    (event,) = until(held, "the arm to hold")
    assert event.code == "heartbeat_lost"
    until(lambda: RobotMode.HOLDING in modes()[-1:], "a state of it")
    assert RobotMode.MOVING not in modes()


def test_a_planner_that_is_killed_in_mid_motion_stops_no_segment_that_is_under_way(heard, processes, in_motion, until):
    processes.kill("planner")

    def ended():
        ends = ExecutionKind.FINISHED, ExecutionKind.HELD
        return [e for e in messages(heard, EXECUTION) if e.plan_id == in_motion and e.kind in ends]

    (event,) = until(ended, "the end of the motion")
    # a plan of several segments holds once nobody plans the next one
    ends = {(ExecutionKind.FINISHED, ""): 0, (ExecutionKind.HELD, "segment"): 3}
    assert ends[event.kind, event.code] == processes.finished("arm")
    processes.start("planner")


@pytest.mark.parametrize("name", AGENTS)
def test_the_others_survive_and_the_restarted_agent_rejoins(name, heard, processes, until):
    processes.kill(name)
    killed = AGENTS[name]
    before = {kind: one.heartbeat for kind, one in health(heard).items() if kind != killed}
    until(lambda: all(health(heard)[k].heartbeat > n for k, n in before.items()), f"others' health after {name}")
    assert not processes.ended()
    assert not [h.fault for h in health(heard).values() if h.agent != killed and h.fault]
    uptime_s, seen = health(heard)[killed].uptime_s, len(threads(heard))
    processes.start(name)
    until(lambda: health(heard)[killed].uptime_s < uptime_s, f"the health of the restarted {name}")
    until(lambda: len(threads(heard)) > seen + 2, "new threads")


@pytest.mark.essential
def test_a_router_that_was_killed_and_started_again_finds_all_agents(heard, processes, planned, until):
    processes.kill("router")
    processes.start("router")
    seen = len(threads(heard))
    until(lambda: len(threads(heard)) > seen + 3, "threads through the new router")
    before = {kind: one.heartbeat for kind, one in health(heard).items()}
    until(lambda: all(h.heartbeat > before[k] for k, h in health(heard).items()), "everyone's health")
    assert not processes.ended()
    plan_id = planned().plan_id
    until(lambda: plan_id in {p.plan_id for p in messages(heard, PLAN)}, "the plan to be heard")
