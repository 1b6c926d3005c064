"""A real session, from simulator to plan, heard from beside; run once for all tests of this folder."""

import contextlib
import dataclasses
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
from schemas.messages import GraspPlan, Outcome, Policy, RectifiedStereo, Status, ThreadReconstruction
from schemas.topics import FRAMES, PLAN, THREAD, TOPICS
from shared.runtime.connection import connected
from shared.runtime.session import SessionSettings
from shared.runtime.taps import Tapped

DEADLINE_S = 60.0
SMALL = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5e-3, 1.0)
"""Half the endoscope's size, so that two cores keep up."""


@dataclasses.dataclass
class Session:
    """What was heard, what the recorder wrote at the same time, and its report."""

    heard: list[Tapped]
    path: object
    report: object


def scene_camera():
    scene = SceneSource()

    def render(state, frame):
        pair = scene.render(state, frame)
        return pair.left_bgr, pair.right_bgr

    return SceneCamera(render, lambda state: calibration_of(state.camera), CameraConfig(rate_hz=10.0))


def simulator():
    return Simulator(SimulatorConfig(config="easy", background="plain", camera=SMALL))


def of(heard, topic):
    return [t for t in list(heard) if t.topic is topic]


@pytest.fixture(scope="session")
def live(tmp_path_factory, router, in_threads, until):
    """A session with two goals of each policy; perception, reconstruction and planner are restarted in its midst."""
    path = tmp_path_factory.mktemp("live") / "session.mcap"
    heard = []
    with contextlib.ExitStack() as stack:
        settings = SessionSettings("replayed", stack.enter_context(router()))
        connection = stack.enter_context(connected(settings, DEADLINE_S))
        recorder = Recorder(path)
        stack.callback(recorder.close)
        recorded = tuple(topic for topic in TOPICS if topic.recorded)
        connection.listen(recorded, heard.append)
        connection.listen(recorded, recorder.put, recorder.missed)
        bridge = RobotBridge(RobotBridgeConfig(), SimulatedPsm())
        with in_threads(settings, simulator(), scene_camera(), bridge):
            for _ in range(2):
                with in_threads(settings, Perception(), Reconstruction(), Planner()):
                    before = len(of(heard, THREAD))
                    until(lambda before=before: threads_ok(heard[:]) and len(of(heard, THREAD)) > before + 5)
                    for policy in Policy:
                        plan = asked(connection, policy, until)
                        until(lambda plan=plan: plan.plan_id in {p.plan_id for p in plans(heard)})
            # on a fast machine all of that takes few frames
            until(lambda: len(of(heard, FRAMES)) > 40)
        connection.close()
        report = recorder.close()
    return Session(heard, path, report)


def threads_ok(heard):
    return [t for t in of(heard, THREAD) if decode(ThreadReconstruction, t.payload).status is Status.OK]


def plans(heard):
    return [decode(GraspPlan, t.payload) for t in of(heard, PLAN)]


def asked(connection, policy, until):
    """A plan, or a rejection; what is busy starting refuses for a while."""
    places = itertools.cycle((0.5, 0.4, 0.6, 0.3))

    def ask():
        answer, plan = ask_for_grasp(connection, "psm1", policy, s=next(places))
        return plan if answer.outcome is Outcome.ACCEPTED else None

    return until(ask, "a plan or a rejection")


@pytest.fixture(scope="session")
def camera():
    """Builds the scene camera of the session."""
    return scene_camera
