"""The trials of one thread: its images, what perception and reconstruction make of them, and grasp by grasp.

Processes share the threads of an evaluation among them, and tell of each trial as it ends.
"""

import itertools
from collections.abc import Generator
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from agents.camera.agent import CameraConfig, FrameSender
from agents.camera.sources import Pair
from agents.cli.evaluate.scenes import Scenery, first_state, scenery_of
from agents.cli.evaluate.views import FieldView
from agents.cli.evaluate.workers import shared_out
from agents.configuration.rig import ReconstructionSection, RigConfig, simulated_rig
from agents.launch.builders import build
from agents.planner.agent import Planner
from agents.planner.config import PlannerConfig
from agents.robot_bridge.limits import MotionLimits
from agents.simulated_trials.look import Came, Look, looked, seen_places
from agents.simulated_trials.protocol import Laid, MethodName, Protocol, Trial, hand_eye_seed, injected_m, tool_seed
from agents.simulated_trials.table import SpeedLimits
from agents.simulated_trials.trial import CAPTURED_NS, Again, Cast, Told, carried_out
from agents.simulator.agent import Simulator, SimulatorConfig
from agents.simulator.field import DEGREE
from schemas.messages import ImageEncoding, RobotState, SimulatorState, Status
from shared.arc_length import even_parameters
from shared.camera import project
from shared.clock import processor_s
from shared.splines import evaluate

ARM = "psm1"
PLACES, FINE = 2001, 20_001
PERCEPTION, RECONSTRUCTION, BRIDGE = "perception", "reconstruction", "robot_bridge"


class Table:
    """One thread with all that trials on it share."""

    def __init__(
        self, protocol: Protocol, laid: Laid, folder: Path, encoding: ImageEncoding = ImageEncoding.RAW
    ) -> None:
        """Lay the thread; nothing is looked at before it has to be.

        Args:
            encoding: of frames, without loss; one that takes time is of use where they are recorded.

        Raises:
            SceneError: where the thread cannot be laid.
        """
        self.protocol, self.laid, self._encoding = protocol, laid, encoding
        self.scenery: Scenery = scenery_of(protocol, laid, folder)
        self._looks: dict[MethodName, Look] = {}
        self._evenly: dict[MethodName, np.ndarray] = {}
        self.view = FieldView(self.scenery)

    def look(self, method: MethodName) -> Look:
        """What a method makes of the field before the grasp."""
        if method not in self._looks:
            self._looks[method] = self._seen(self.scenery.images, method, CAPTURED_NS, 0)
        return self._looks[method]

    def _seen(self, images: Pair, method: MethodName, captured_ns: int, sequence: int) -> Look:
        """What perception and reconstruction make of images, as if they had never seen any before."""
        rig = rig_for(method)
        sender = FrameSender(CameraConfig(encoding=self._encoding))
        sender.calibrated(self.scenery.calibration)
        sender.sent = sequence
        frame = sender.frame(images, captured_ns)
        following = sender.frame(images, captured_ns) if self.protocol.tissue else None
        agents = build(rig, PERCEPTION, "main"), build(rig, RECONSTRUCTION, "main")
        return looked(*agents, self.scenery.calibration, frame, following)

    def _point(self, look: Look, method: MethodName, s: float) -> Float64[np.ndarray, "3"]:
        """A place on the thread of the first look, or of that moved as a whole, which moves no parameter."""
        if method not in self._evenly:
            first = self.look(method).thread
            self._evenly[method] = even_parameters(first.knots, first.control_points_camera, first.degree, PLACES)
        thread, at = look.thread, self._evenly[method][[round((PLACES - 1) * s)]]
        return evaluate(thread.knots, thread.control_points_camera, thread.degree, at)[0]

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
        again = self._again(trial) if self.protocol.attempts > 1 else None
        moved = look.moved(by_m)
        told = carried_out(trial, s, moved, self._cast(trial), again, recorded)
        more = {
            "goal_px": self._pixel(look, trial.method, told.came.s),
            "capture_px": self._pixel(look, trial.method, told.came.s_capture),
            "error_m": self._error_m(moved, trial.method, told.came.s),
            "capture_error_m": self._error_m(moved, trial.method, told.came.s_capture),
            "injected_m": float(np.linalg.norm(by_m)),
            "processor_s": processor_s() - began_s,
        }
        return replace(told, came=told.came.model_copy(update=more))

    def _error_m(self, look: Look, method: MethodName, s: float | None) -> float | None:
        """How far a place on the reconstructed thread is from the true one."""
        if s is None:
            return None
        return float(np.linalg.norm(self._true_points - self._point(look, method, s), axis=1).min())

    def _pixel(self, look: Look, method: MethodName, s: float | None) -> tuple[float, float] | None:
        """Where a place on the reconstructed thread is in the left image."""
        if s is None:
            return None
        left, _ = project(look.thread.camera, self._point(look, method, s)[None])
        return float(left[0, 0]), float(left[0, 1])

    @cached_property
    def _true_points(self) -> Float64[np.ndarray, "n 3"]:
        state = first_state(self.scenery.simulated, self.scenery.field)
        s = np.linspace(0.0, 1.0, FINE)
        return evaluate(state.knots, state.control_points_camera, DEGREE, s)

    def _again(self, trial: Trial) -> Again:
        """Looks at the field after a grasp, which find the thread moved as often as the first one."""
        looks = itertools.count(1)

        def look(state: SimulatorState, arm: RobotState, now_ns: int) -> Look:
            number = next(looks)
            images = self.view.pair(state, number, arm if self.protocol.instrument else None, whole=True)
            seen = self._seen(images, trial.method, now_ns, number)
            return seen.moved(injected_m(self.protocol, trial, number))

        return look

    def _cast(self, trial: Trial) -> Cast:
        rig = rig_for(trial.method)
        return Cast(
            planner=Planner(planner_config(self.protocol, trial)),
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
            hand_eye_seed=hand_eye_seed(self.protocol, self.laid),
            physics=self.protocol.judge,
        )


def tried_on(protocol: Protocol, laid: Laid, trials: list[Trial], folder: Path) -> Generator[Came]:
    """What comes of each of the trials of a thread; an agent that raises has failed, and says why.

    Raises:
        SceneError: where the thread cannot be laid.
    """
    table = Table(protocol, laid, folder)
    for trial in trials:
        try:
            yield table.tried(trial).came
        except Exception as error:
            yield Came(trial=trial, outcome="failed", code="FAULT", sentence=f"{type(error).__name__}: {error}")


def rig_for(method: MethodName) -> RigConfig:
    """The simulated rig with a method of reconstruction."""
    return simulated_rig().model_copy(update={"reconstruction": ReconstructionSection(method=method)})


def planner_config(protocol: Protocol, trial: Trial) -> PlannerConfig:
    """The paper's policy with the paper's method, ours with ours, which is told the deviations of the errors.

    Either grasps wherever it is asked to, as the paper did.
    """
    return PlannerConfig(
        least_probability=0.0,
        policy_model="paper" if trial.method == "paper" else "geometric",
        tool_error_m=1e-3 * trial.tool_error_mm,
        hand_eye_error_m=1e-3 * protocol.hand_eye_mm,
        attempts=protocol.attempts,
    )


def speed_limits() -> SpeedLimits:
    """Those of the simulated arm's bridge."""
    limits = MotionLimits()
    return SpeedLimits(limits.speed, limits.angular_speed, limits.jaw_speed, limits.contact_share)


Work = list[tuple[Laid, list[Trial]]]


def all_tried(protocol: Protocol, work: Work, jobs: int, folder: Path) -> Generator[Came]:
    """What comes of all trials, in so many processes, as each ends.

    Raises:
        SceneError: where a thread cannot be laid.
        WorkError: where a worker dies.
    """
    yield from shared_out(tried_on, [(protocol, laid, trials, folder) for laid, trials in work], jobs)
