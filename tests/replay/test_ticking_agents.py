"""What robot bridge and simulator did on their own clock's ticks, they do again on a recording, byte for byte."""

import contextlib
import dataclasses
import threading
from typing import Any

import numpy as np
import pytest

from agents.operator.operator import arm_and_stand_by, hold
from agents.recorder.recorder import Recorder
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from agents.simulator.agent import Simulator, SimulatorConfig
from schemas.messages import ExecutionKind, FrameStamp, Outcome, Phase, RobotMode, Waypoint
from schemas.topics import EXECUTION, JUDGEMENT, MAIN, PLAN, ROBOT_STATE, SIMULATOR_STATE, TOPICS, topic_of
from shared.recording.mcap_file import read_recording
from shared.rigid_transforms import exp_so3, transform
from shared.runtime.agent import Agent, Output
from shared.runtime.commands import new_header
from shared.runtime.connection import connected
from shared.runtime.replay import replay
from shared.runtime.session import SessionSettings
from tests.agents.session_report.conftest import plan as example
from tests.replay.conftest import of

ATTEMPTS = 5
# the fixture counts towards the first test, and may take several sessions of up to a minute
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
OPERATOR = "agents.operator.operator"
PATIENT_S = 60.0
PLACES = (((15, 5, 75), 0.5, Phase.APPROACH), ((20, 6, 80), 0.5, Phase.CAPTURE), ((20, 6, 80), 0, Phase.GRASP))
WAYPOINTS = tuple(
    Waypoint(transform(exp_so3(np.array((0.1, 0, 0.3))), np.array(place_mm) / 1e3), jaw, phase, None)
    for place_mm, jaw, phase in PLACES
)


def bridge():
    patient = RobotBridgeConfig(dead_man_s=10.0, first_heartbeat_s=PATIENT_S, maximum_plan_age_s=PATIENT_S)
    return RobotBridge(patient, SimulatedPsm())


def simulator():
    return Simulator(SimulatorConfig(config="easy", background="plain"))


AGENTS = {"robot_bridge": bridge, "simulator": simulator}


class Planning(Agent):
    """In the place of the planner: one plan by hand, again and again with the newest time."""

    kind, instance, inputs, outputs, commands, tick_hz = "planner", MAIN, (), (PLAN,), (), 2.0

    def step(self, arrived: Any):
        stamp = FrameStamp(0, arrived.now_ns, arrived.now_ns, "")
        plan = dataclasses.replace(example("goal", 0, 0.0), plan_id="by-hand", stamp=stamp, waypoints=WAYPOINTS)
        yield Output(PLAN, plan)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, router, in_threads, until):
    """A session with a refused arming, a motion that is held, and one to its end with a judgement.

    Whoever records may lose a state, of which no replay knows the list; then the session is held again.
    """
    entries = []
    for _ in range(ATTEMPTS):
        path = tmp_path_factory.mktemp("ticking") / "session.mcap"
        with router() as endpoint, pytest.MonkeyPatch.context() as patch:
            # a test machine may stall
            for name in ("PLAN_ARRIVES_S", "ARMING_S", "AWAKE_S", "SILENCE_S"):
                patch.setattr(f"{OPERATOR}.{name}", PATIENT_S if name != "PLAN_ARRIVES_S" else 0.5)
            patch.setattr(f"{OPERATOR}.new_header", lambda sender: new_header(sender, PATIENT_S))
            patch.setattr("shared.runtime.commands.FARTHEST_DEADLINE_S", 2 * PATIENT_S)
            hold_a_session(path, SessionSettings("replayed", endpoint), in_threads, until)
        entries = list(read_recording(path))
        if not any(output.missing for build in AGENTS.values() for output in replay(build, entries)):
            break
    return entries


def hold_a_session(path, settings, in_threads, until):
    recorder, heard = Recorder(path), []
    with contextlib.ExitStack() as stack:
        stack.callback(recorder.close)
        connection = stack.enter_context(connected(settings, PATIENT_S))
        connection.listen(tuple(t for t in TOPICS if t.recorded), recorder.put, recorder.missed)
        connection.listen((PLAN, ROBOT_STATE, SIMULATOR_STATE, JUDGEMENT), heard.append)
        with in_threads(settings, simulator(), bridge(), Planning()):
            until(lambda: {t.topic for t in list(heard)} >= {PLAN, ROBOT_STATE, SIMULATOR_STATE})
            refused = arm_and_stand_by(connection, "psm1", "nobody's", threading.Event(), lambda _: None)
            assert refused.answer.code == "unknown_plan"

            def armed(told, left):
                answer = arm_and_stand_by(connection, "psm1", "by-hand", left, told).answer
                assert answer.outcome is Outcome.ACCEPTED, answer.reason

            left = threading.Event()
            armed(lambda _: left.set(), left)
            assert hold(connection, "psm1").outcome is Outcome.ACCEPTED
            until(lambda: of(heard, ROBOT_STATE)[-1].mode is RobotMode.HOLDING)
            armed(lambda _: None, threading.Event())
            until(lambda: of(heard, JUDGEMENT))


def test_the_session_has_something_to_show(recorded):
    kinds = {event.kind for event in of(recorded, EXECUTION)}
    assert kinds >= {ExecutionKind.REFUSED, ExecutionKind.HELD, ExecutionKind.FINISHED}
    assert {state.mode for state in of(recorded, ROBOT_STATE)} >= {RobotMode.MOVING, RobotMode.HOLDING, RobotMode.IDLE}
    assert len(of(recorded, JUDGEMENT)) == 1


@pytest.mark.parametrize("build", AGENTS.values(), ids=AGENTS)
def test_every_output_is_the_same(build, recorded):
    agent = build()
    replayed = list(replay(build, recorded))
    assert len(replayed) == sum(topic_of(e.key) in agent.outputs for e in recorded)
    assert [r for r in replayed if not r.same] == []
    assert {topic_of(r.key) for r in replayed} == set(agent.outputs)
