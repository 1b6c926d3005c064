"""The simulator agent: the field that the scene camera renders, and the judgement of every grasp in it."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from agents.simulator.contact.physics import ContactPhysics
from agents.simulator.field import MM, Field, distance_to_thread, field_of, s_of
from agents.simulator.judgement import MeasuredArm, Outcome, Physics
from agents.simulator.world import GeometricPhysics, ToolError, hand_eye_error, tool_error
from schemas.messages import (
    CommandAnswer,
    ExecutionEvent,
    ExecutionKind,
    GraspJudgement,
    GraspPlan,
    Phase,
    RectifiedStereo,
    RobotState,
    SimulatorState,
)
from schemas.topics import EXECUTION, JUDGEMENT, PLAN, ROBOT_STATE, SIMULATOR_STATE
from shared.rigid_transforms import apply, compose
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick
from shared.runtime.parameters import Between, settable

ENDOSCOPE = RectifiedStereo(
    image_width=960,
    image_height=540,
    fx_px=1000.0,
    fy_px=1000.0,
    cx_px=479.5,
    cy_px=269.5,
    baseline=5.5 * MM,
    metres_per_unit=1.0,
)

REMEMBERED_PLANS = 64
STOPPED = (ExecutionKind.HELD, ExecutionKind.REFUSED)
LATE_NS = 200_000_000
"""How long after a plan's end robot states may still arrive that belong to it."""
MOVING_HZ, RESTING_HZ = 60.0, SIMULATOR_STATE.resting_hz or 60.0
RESTS_AFTER_NS = 1_000_000_000
"""How long after an arm's last motion the field is told as often as before: thread may settle."""


@dataclass(frozen=True)
class SimulatorConfig:
    """What the field looks like, and how well the robot knows where its fingers are.

    Fields:
        config, background, colour, seed: as of shared.rendering.
        distance_mm: from the camera to the tissue.
        tool_error_mm: deviation of each axis of the error in the tool's position, which is drawn for each plan.
        hand_eye_error_mm, hand_eye_error_deg: the most by which an arm's tool is shifted, and turned about the middle
            of the thread, against where it is measured; drawn once for each arm, and constant from then on.
        error_seed: that these errors are drawn with; that of the field where it is None.
        hand_eye_seed: that the error of registration is drawn with, where it is to be another one.
        physics: "geometric" judges by where the fingers pass, "contact" by the forces between thread, fingers and
            tissue, which needs MuJoCo (extra `sim`).
        tissue_force_limit_n: above which a grasp has failed, whatever it holds; only contact physics computes forces.
        grip_depth_mm: where along the fingers, from the pin, a plan puts the reconstructed goal.
        camera: in metres.
        laid: how often the thread has been laid again as it was drawn, out of any jaw; setting it does so.
    """

    seed: int = 0
    config: str = "medium"
    background: str = "rendered"
    colour: str = "violet"
    distance_mm: float = 95.0
    tool_error_mm: float = 0.3
    hand_eye_error_mm: float = 0.0
    hand_eye_error_deg: float = 0.0
    error_seed: int | None = None
    hand_eye_seed: int | None = None
    physics: Literal["geometric", "contact"] = "geometric"
    tissue_force_limit_n: float = 1.0
    grip_depth_mm: float = 8.2
    camera: RectifiedStereo = ENDOSCOPE
    laid: int = settable(0, Between(0, 1_000_000))


class Simulator(Agent):
    """A thread on tissue, what the jaws do to it, and a judgement of each plan that is carried out.

    Raises:
        SceneError, ShapeError: where the configuration names no field that can be drawn.
        PhysicsError: where it asks for contact physics, and MuJoCo is not installed.
    """

    kind = "simulator"
    config: SimulatorConfig
    inputs = (Input(ROBOT_STATE, "*"), Input(EXECUTION, "*"), Input(PLAN))
    outputs = (SIMULATOR_STATE, JUDGEMENT)

    def __init__(self, config: SimulatorConfig = SimulatorConfig(), field: Field | None = None) -> None:
        """Lay the thread: the one that the configuration draws, or of a field that is given."""
        self.config = config
        in_mm = replace(config.camera, baseline=config.camera.baseline / MM, metres_per_unit=MM)
        if field is None:
            field = field_of(in_mm, config.config, config.background, config.distance_mm, config.seed)
        self._physics: Physics = (
            GeometricPhysics(field)
            if config.physics == "geometric"
            else ContactPhysics(field, config.tissue_force_limit_n)
        )
        self._middle_camera = field.points.mean(axis=0)
        self._hand_eye: dict[str, Float64[np.ndarray, "4 4"]] = {}
        self._tool_errors: dict[str, ToolError] = {}
        self._goal_error_m: dict[str, float] = {}
        # plans that were begun and have no verdict yet, and when those of them ended that have
        self._begun: dict[str, tuple[str, Outcome]] = {}
        self._judged: dict[str, str] = {}
        self._finished_ns: dict[str, int] = {}
        self._now_ns = 0
        self._poses: dict[str, object] = {}
        self._rests_from_ns = 0

    def configure(self, config: SimulatorConfig) -> None:
        """Go on with another config, in which only what may be set while the agent runs has changed."""
        if config.laid != self.config.laid:
            self._physics.lay()
            self._begun.clear()
            self._judged.clear()
        self.config = config

    @property
    def tick_hz(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride] - the runtime only reads it
        """All of its turns while an arm moves or a verdict is due; few are enough for a field that is still."""
        moves = 0 < self._rests_from_ns - self._now_ns <= RESTS_AFTER_NS
        return MOVING_HZ if moves or self._finished_ns else RESTING_HZ

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """The field at each tick, and a judgement when a grasp is settled."""
        if isinstance(arrived, Tick):
            yield from self._tick(arrived.now_ns)
        elif isinstance(arrived, Received) and arrived.topic is ROBOT_STATE:
            yield from self._follow(arrived.message)
        elif isinstance(arrived, Received) and arrived.topic is EXECUTION:
            self._note_end(arrived.message)
        elif isinstance(arrived, Received) and arrived.topic is PLAN:
            self._note_goal(arrived.message)

    def _tick(self, now_ns: int) -> Iterable[Output]:
        self._now_ns = now_ns
        late = [plan_id for plan_id, end_ns in self._finished_ns.items() if now_ns - end_ns > LATE_NS]
        for plan_id in late:
            del self._finished_ns[plan_id]
            if plan_id in self._begun:
                arm, outcome = self._begun.pop(plan_id)
                yield self._judgement(arm, plan_id, outcome)
        self._physics.carry()
        yield Output(SIMULATOR_STATE, self._state())

    def _follow(self, state: RobotState) -> Iterable[Output]:
        """Take in a measured pose; a judgement where it settles the grasp."""
        pose = state.T_camera_base.tobytes(), state.T_base_tool.tobytes(), state.jaw_rad
        if self._poses.setdefault(state.arm, pose) != pose:
            self._poses[state.arm], self._rests_from_ns = pose, self._now_ns + RESTS_AFTER_NS
        arm = MeasuredArm(state.arm, state.plan_id, self._true_pose(state), state.jaw_rad, state.measured_ns)
        outcome = self._physics.follow(arm)
        if not state.plan_id or self._judged.get(state.arm) == state.plan_id:
            return
        self._begun.pop(state.plan_id, None)
        if not outcome.settled:
            _remember(self._begun, state.plan_id, (state.arm, outcome))
        else:
            self._judged[state.arm] = state.plan_id
            yield self._judgement(state.arm, state.plan_id, outcome)

    def _true_pose(self, state: RobotState) -> Float64[np.ndarray, "4 4"]:
        """Where the arm's tool is, as opposed to where it is measured."""
        config = self.config
        seed = config.seed if config.error_seed is None else config.error_seed
        if state.arm not in self._hand_eye:
            registered = seed if config.hand_eye_seed is None else config.hand_eye_seed
            self._hand_eye[state.arm] = hand_eye_error(
                registered, state.arm, config.hand_eye_error_mm, config.hand_eye_error_deg, self._middle_camera
            )
        error = self._tool_errors.get(state.arm, ToolError("", 0, np.zeros(3)))
        if state.plan_id not in ("", error.plan_id):
            error = tool_error(seed, state.arm, state.plan_id, error.plans, config.tool_error_mm)
            self._tool_errors[state.arm] = error
        T_camera_tool = compose(self._hand_eye[state.arm], compose(state.T_camera_base, state.T_base_tool))
        T_camera_tool[:3, 3] += error.offset_camera
        return T_camera_tool

    def _note_end(self, event: ExecutionEvent) -> None:
        if event.kind is ExecutionKind.FINISHED:
            _remember(self._finished_ns, event.plan_id, self._now_ns)
        elif event.kind in STOPPED:
            self._begun.pop(event.plan_id, None)

    def _note_goal(self, plan: GraspPlan) -> None:
        """Remember how far the plan's goal is from the thread as it lies now."""
        grasps = [waypoint for waypoint in plan.waypoints if waypoint.phase is Phase.GRASP]
        if not grasps:
            return
        goal_tool = np.array([[0.0, 0.0, MM * self.config.grip_depth_mm]])
        goal_camera = apply(grasps[-1].T_camera_tool, goal_tool)[0]
        _remember(self._goal_error_m, plan.plan_id, distance_to_thread(self._physics.field, goal_camera))

    def _judgement(self, name: str, plan_id: str, outcome: Outcome) -> Output:
        error_m = self._goal_error_m.get(plan_id)
        judgement = GraspJudgement(
            plan_id=plan_id,
            arm=name,
            at_ns=self._now_ns,
            verdict=outcome.verdict,
            s_caught=outcome.s_caught,
            slid_m=outcome.slid_m,
            error_m=error_m,
            sentence=outcome.sentence + ("" if error_m is None else f"; true error {1e3 * error_m:.1f} mm"),
            peak_tissue_force_n=outcome.peak_tissue_force_n,
            slipped_m=outcome.slipped_m,
            code=outcome.code,
        )
        return Output(JUDGEMENT, judgement)

    def _state(self) -> SimulatorState:
        config, field, held = self.config, self._physics.field, self._physics.held_sample
        return SimulatorState(
            at_ns=self._now_ns,
            camera=config.camera,
            background=config.background,
            colour=config.colour,
            seed=config.seed,
            distance_m=MM * config.distance_mm,
            radius_m=field.radius_m,
            knots=field.knots,
            control_points_camera=field.control_points,
            held=None if held is None else s_of(held),
        )


def _remember(remembered: dict[str, Any], plan_id: str, value: object) -> None:
    """Keep it as the newest of a limited number."""
    remembered[plan_id] = value
    if len(remembered) > REMEMBERED_PLANS:
        del remembered[next(iter(remembered))]
