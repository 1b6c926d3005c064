"""The simulator agent: the field that the scene camera renders, and the judgement of every grasp in it."""

import zlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from agents.simulator.field import MM, Field, distance_to_thread, field_of, s_of
from agents.simulator.judgement import Grip, never_closed, sentence, slid_m
from agents.simulator.world import World, held_sample, moved, thread_carried
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
    Verdict,
)
from schemas.topics import EXECUTION, JUDGEMENT, MAIN, PLAN, ROBOT_STATE, SIMULATOR_STATE, Topic
from shared.rigid_transforms import apply, compose
from shared.runtime.agent import Command, Input, Output, Received, Tick
from shared.runtime.settable import Between, settable

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


@dataclass(frozen=True)
class SimulatorConfig:
    """What the field looks like, and how well the robot knows where its fingers are.

    Fields:
        config, background, colour, seed: as of shared.scene.
        distance_mm: from the camera to the tissue.
        tool_error_mm: deviation of each axis of the error in the tool's position, which is drawn for each plan.
        hand_eye_error_mm, hand_eye_error_deg: the most by which an arm's tool is shifted, and turned about the middle
            of the thread, against where it is measured; drawn once for each arm, and constant from then on.
        error_seed: that these errors are drawn with; that of the field where it is None.
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
    physics: Literal["geometric", "contact"] = "geometric"
    tissue_force_limit_n: float = 1.0
    grip_depth_mm: float = 8.2
    camera: RectifiedStereo = ENDOSCOPE
    laid: int = settable(0, Between(0, 1_000_000))


@dataclass(frozen=True)
class _ToolError:
    """How far an arm's tool is from where it is measured, while it carries out its n-th plan."""

    plan_id: str
    plans: int
    offset_camera: Float64[np.ndarray, "3"]


class Simulator:
    """A thread on tissue, what the jaws do to it, and a judgement of each plan that is carried out.

    Raises:
        SceneError, ShapeError: where the configuration names no field that can be drawn.
    """

    kind = "simulator"
    instance = MAIN
    inputs = (Input(ROBOT_STATE, "*"), Input(EXECUTION, "*"), Input(PLAN))
    outputs = (SIMULATOR_STATE, JUDGEMENT)
    commands: tuple[Topic, ...] = ()
    tick_hz = 60.0

    def __init__(self, config: SimulatorConfig = SimulatorConfig(), field: Field | None = None) -> None:
        """Lay the thread: the one that the configuration draws, or of a field that is given."""
        self.config = config
        in_mm = replace(config.camera, baseline=config.camera.baseline / MM, metres_per_unit=MM)
        if field is None:
            field = field_of(in_mm, config.config, config.background, config.distance_mm, config.seed)
        self._drawn = field
        self._world = World(field, field, {})
        self._tool_errors: dict[str, _ToolError] = {}
        self._goal_error_m: dict[str, float] = {}
        # plans that were begun and have no verdict yet, and when those of them ended that have
        self._begun: dict[str, tuple[str, Grip]] = {}
        self._finished_ns: dict[str, int] = {}
        self._now_ns = 0

    def configure(self, config: SimulatorConfig) -> None:
        """Go on with another config, in which only what may be set while the agent runs has changed."""
        if config.laid != self.config.laid:
            # arms are followed from where they are seen next
            self._world = World(self._drawn, self._drawn, {})
            self._begun.clear()
        self.config = config

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
                arm, grip = self._begun.pop(plan_id)
                yield self._judgement(arm, plan_id, never_closed(grip))
        self._world = thread_carried(self._world)
        yield Output(SIMULATOR_STATE, self._state())

    def _follow(self, state: RobotState) -> Iterable[Output]:
        """Take in a measured pose; a judgement where it settles the grasp."""
        T_camera_tool = compose(state.T_camera_base, state.T_base_tool)
        T_camera_tool[:3, 3] += self._tool_error(state)
        before = self._world.arms.get(state.arm)
        settled = before is not None and before.plan_id == state.plan_id and before.grip.verdict is not None
        self._world = moved(self._world, state.arm, state.plan_id, T_camera_tool, state.jaw_rad)
        grip = self._world.arms[state.arm].grip
        if not state.plan_id or settled:
            return
        self._begun.pop(state.plan_id, None)
        if grip.verdict is None:
            _remember(self._begun, state.plan_id, (state.arm, grip))
        else:
            yield self._judgement(state.arm, state.plan_id, grip)

    def _tool_error(self, state: RobotState) -> Float64[np.ndarray, "3"]:
        """The error of the arm's tool, drawn anew for each plan."""
        error = self._tool_errors.get(state.arm, _ToolError("", 0, np.zeros(3)))
        if state.plan_id not in ("", error.plan_id):
            rng = np.random.default_rng([self.config.seed, zlib.crc32(state.arm.encode()), error.plans])
            drawn = rng.normal(0.0, MM * self.config.tool_error_mm, 3)
            error = _ToolError(state.plan_id, error.plans + 1, drawn)
            self._tool_errors[state.arm] = error
        return error.offset_camera

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
        _remember(self._goal_error_m, plan.plan_id, distance_to_thread(self._world.field, goal_camera))

    def _judgement(self, name: str, plan_id: str, grip: Grip) -> Output:
        verdict, error_m = grip.verdict, self._goal_error_m.get(plan_id)
        assert verdict is not None  # noqa: S101 - only settled grasps are judged
        caught = grip.sample if verdict is Verdict.HELD else None
        judgement = GraspJudgement(
            plan_id=plan_id,
            arm=name,
            at_ns=self._now_ns,
            verdict=verdict,
            s_caught=None if caught is None else s_of(caught),
            slid_m=slid_m(grip, self._world.field),
            error_m=error_m,
            sentence=sentence(grip, self._world.field, error_m),
        )
        return Output(JUDGEMENT, judgement)

    def _state(self) -> SimulatorState:
        config, field, held = self.config, self._world.field, held_sample(self._world)
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
