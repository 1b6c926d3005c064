"""A real session, from simulator to plan, recorded from beside; run once for all tests of this folder."""

import contextlib
import itertools

import pytest

from agents.camera.agent import CameraConfig, SceneCamera
from agents.camera.scene_source import SceneSource, calibration_of
from agents.operator.operator import ask_for_grasp
from agents.perception.agent import Perception
from agents.planner.agent import Planner
from agents.reconstruction.agent import Reconstruction
from agents.recorder.recorder import Recorder
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from agents.simulator.agent import Simulator, SimulatorConfig
from schemas.codec import decode
from schemas.messages import Outcome, Policy, RectifiedStereo, Status
from schemas.topics import FRAMES, PLAN, THREAD, TOPICS, topic_of
from shared.recording.mcap_file import read_recording
from shared.runtime.connection import connected
from shared.runtime.session import SessionSettings

DEADLINE_S = 60.0
SMALL = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5e-3, 1.0)
"""Half the endoscope's size, so that two cores keep up."""


def scene_camera():
    return SceneCamera(SceneSource().render, lambda state: calibration_of(state.camera), CameraConfig(rate_hz=10.0))


def of(entries, topic):
    """The messages of one topic."""
    return [decode(topic.message, e.payload) for e in list(entries) if topic_of(e.key) is topic]


@pytest.fixture(scope="session")
def recorded(tmp_path_factory, router, in_threads, until):
    """A session with two goals of each policy; perception, reconstruction and planner are restarted in its midst."""
    path = tmp_path_factory.mktemp("live") / "session.mcap"
    heard = []
    with contextlib.ExitStack() as stack:
        settings = SessionSettings("replayed", stack.enter_context(router()))
        connection = stack.enter_context(connected(settings, DEADLINE_S))
        recorder = Recorder(path)
        stack.callback(recorder.close)
        topics = tuple(topic for topic in TOPICS if topic.recorded)
        connection.listen((FRAMES, THREAD, PLAN), heard.append)
        connection.listen(topics, recorder.put, recorder.missed)
        simulator = Simulator(SimulatorConfig(config="easy", background="plain", camera=SMALL))
        bridge = RobotBridge(RobotBridgeConfig(), SimulatedPsm())
        with in_threads(settings, simulator, scene_camera(), bridge):
            for _ in range(2):
                with in_threads(settings, Perception(), Reconstruction(), Planner()):
                    enough = len(of(heard, THREAD)) + 5
                    until(
                        lambda enough=enough: (
                            len(of(heard, THREAD)) > enough and of(heard, THREAD)[-1].status is Status.OK
                        )
                    )
                    for policy in Policy:
                        plan = asked(connection, policy, until)
                        until(lambda plan=plan: plan.plan_id in {p.plan_id for p in of(heard, PLAN)})
            # on a fast machine all of that takes few frames
            until(lambda: sum(t.topic is FRAMES for t in list(heard)) > 40)
        connection.close()
        recorder.close()
    return list(read_recording(path))


def asked(connection, policy, until):
    """A plan, or a rejection; what is busy starting refuses for a while."""
    places = itertools.cycle((0.5, 0.4, 0.6, 0.3))

    def ask():
        answer, plan = ask_for_grasp(connection, "psm1", policy, s=next(places))
        return plan if answer.outcome is Outcome.ACCEPTED else None

    return until(ask, "a plan or a rejection")
