"""The trials of one thread: its images, what perception and reconstruction make of them, and grasp by grasp."""

from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

import numpy as np

from agents.camera.agent import CameraConfig, FrameSender
from agents.camera.sources import Pair
from agents.cli.builders import build
from agents.cli.evaluate_scenes import Scenery, scenery_of
from agents.cli.rig import PlannerSection, ReconstructionSection, RigConfig, simulated_rig
from agents.evaluation.came import Came
from agents.evaluation.least_time import SpeedLimits
from agents.evaluation.look import Look, looked, seen_places
from agents.evaluation.protocol import Laid, MethodName, Protocol, Trial, injected_m, tool_seed
from agents.evaluation.trial import CAPTURED_NS, Cast, Told, carried_out
from agents.robot_bridge.limits import MotionLimits
from agents.simulator.agent import Simulator, SimulatorConfig
from schemas.messages import ImageEncoding, Status, StereoCalibration
from shared.arc_length import even_parameters
from shared.camera import project
from shared.clock import processor_s
from shared.splines import evaluate

ARM = "psm1"
PERCEPTION, RECONSTRUCTION, PLANNER, BRIDGE = "perception", "reconstruction", "planner", "robot_bridge"


class Table:
    """One thread with all that trials on it share."""

    def __init__(self, protocol: Protocol, laid: Laid, folder: Path) -> None:
        """Lay the thread; nothing is looked at before it has to be.

        Raises:
            SceneError: where the thread cannot be laid.
        """
        self.protocol, self.laid = protocol, laid
        self.scenery: Scenery = scenery_of(protocol, laid, folder)
        self._looks: dict[MethodName, Look] = {}

    def look(self, method: MethodName) -> Look:
        """What a method makes of the field before the grasp."""
        if method not in self._looks:
            self._looks[method] = look_at(self.scenery.images, self.scenery.calibration, method, CAPTURED_NS, 0)
        return self._looks[method]

    def tried(self, trial: Trial, recorded: bool = False) -> Told:
        """Carry out one trial."""
        began_s = processor_s()
        look = self.look(trial.method)
        if look.thread.status is not Status.OK:
            came = Came(trial=trial, outcome="declined", code="no_thread", sentence=look.thread.reason)
            return Told(came, [])
        places = seen_places(look.thread, self.protocol.goals)
        if not len(places):
            came = Came(
                trial=trial, outcome="declined", code="unseen", sentence="nothing of the thread is seen by both"
            )
            return Told(came, [])
        s, by_m = float(places[trial.goal]), injected_m(self.protocol, trial)
        told = carried_out(trial, s, look.moved(by_m), self._cast(trial), recorded)
        more = {
            "goal_px": _pixel(look, told.came.s),
            "capture_px": _pixel(look, told.came.s_capture),
            "injected_m": float(np.linalg.norm(by_m)),
            "processor_s": processor_s() - began_s,
        }
        return replace(told, came=told.came.model_copy(update=more))

    def _cast(self, trial: Trial) -> Cast:
        rig = rig_for(trial.method)
        return Cast(
            planner=build(rig, PLANNER, "main"),
            bridge=build(rig, BRIDGE, ARM),
            simulator=Simulator(self._simulated(trial), self.scenery.field),
            limits=speed_limits(),
        )

    def _simulated(self, trial: Trial) -> SimulatorConfig:
        return replace(
            self.scenery.simulated,
            tool_error_mm=trial.tool_error_mm,
            hand_eye_error_mm=self.protocol.hand_eye_mm,
            hand_eye_error_deg=self.protocol.hand_eye_deg,
            error_seed=tool_seed(self.protocol, trial),
            physics=self.protocol.judge,
        )


def tried_on(protocol: Protocol, laid: Laid, trials: list[Trial], folder: Path) -> Generator[Came]:
    """What comes of each of the trials of a thread.

    Raises:
        SceneError: where the thread cannot be laid.
    """
    table = Table(protocol, laid, folder)
    for trial in trials:
        yield table.tried(trial).came


def look_at(images: Pair, calibration: StereoCalibration, method: MethodName, captured_ns: int, sequence: int) -> Look:
    """What perception and reconstruction make of images, as if they had never seen any before."""
    rig = rig_for(method)
    sender = FrameSender(CameraConfig(encoding=ImageEncoding.PNG))
    sender.calibrated(calibration)
    sender.sent = sequence
    frame = sender.frame(images, captured_ns)
    return looked(build(rig, PERCEPTION, "main"), build(rig, RECONSTRUCTION, "main"), calibration, frame)


def rig_for(method: MethodName) -> RigConfig:
    """The simulated rig, which grasps wherever it is asked to, as the paper did."""
    sections = {
        "planner": PlannerSection(least_probability=0.0),
        "reconstruction": ReconstructionSection(method=method),
    }
    return simulated_rig().model_copy(update=sections)


def speed_limits() -> SpeedLimits:
    """Those of the simulated arm's bridge."""
    limits = MotionLimits()
    return SpeedLimits(limits.speed, limits.angular_speed, limits.jaw_speed, limits.contact_share)


def _pixel(look: Look, s: float | None) -> tuple[float, float] | None:
    """Where a place on the reconstructed thread is in the left image."""
    if s is None:
        return None
    thread = look.thread
    parameter = even_parameters(thread.knots, thread.control_points_camera, thread.degree, 1001)[round(1000 * s)]
    point = evaluate(thread.knots, thread.control_points_camera, thread.degree, np.array([parameter]))
    left, _ = project(thread.camera, point)
    return float(left[0, 0]), float(left[0, 1])
