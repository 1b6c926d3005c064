"""The planner as an agent: it keeps the newest thread, tissue, arms and account of clocks, and answers goals."""

from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Bool, Float64

from agents.planner.captures import ArmView
from agents.planner.config import PlannerConfig
from agents.planner.plan import plan_grasp
from agents.planner.refusal import RefusedGoalError, clock_unknown, planned_from, surface_unusable
from agents.planner.standing import SeenTissue
from agents.planner.tissue import tissue_of
from agents.planner.tools import tool_cells
from schemas.messages import (
    CommandAnswer,
    GraspGoal,
    HostClocks,
    Outcome,
    RobotState,
    ThreadReconstruction,
    TissueSurface,
)
from schemas.topics import CHECK, CLOCKS, GOAL, MAIN, PLAN, ROBOT_STATE, SURFACE, THREAD, Topic
from shared.kinematics import psm
from shared.rigid_transforms import compose, inverse
from shared.runtime.agent import Command, Input, Output, Received, Tick

Reaches = Callable[[Float64[np.ndarray, "n 4 4"]], Bool[np.ndarray, "n"]]
"""Whether an arm can bring its tool to each `T_base_tool`."""


def psm_reaches(T_base_tool: Float64[np.ndarray, "n 4 4"]) -> Bool[np.ndarray, "n"]:
    """Whether a PSM with a Large Needle Driver can, within the limits of its joints."""
    return psm.inverse(T_base_tool).problem == psm.Problem.NONE


class Planner:
    """Goals to plans, for all arms."""

    kind: str = "planner"
    instance: str = MAIN
    inputs: tuple[Input, ...] = (
        Input(THREAD, only_newest_counts=True, only_remembered=True),
        Input(SURFACE, only_newest_counts=True, only_remembered=True),
        Input(ROBOT_STATE, instance="*", only_newest_counts=True, only_remembered=True),
        Input(CLOCKS, only_newest_counts=True),
    )
    outputs: tuple[Topic, ...] = (PLAN, CHECK)
    commands: tuple[Topic, ...] = (GOAL,)
    tick_hz: float | None = None
    watches_clocks = ("camera",)

    def __init__(self, config: PlannerConfig | None = None, reaches: Reaches | None = None) -> None:
        self.config, self._reaches = config or PlannerConfig(), reaches or psm_reaches
        self._thread: ThreadReconstruction | None = None
        self._surface: TissueSurface | None = None
        self._arms: dict[str, RobotState] = {}
        self._clocks: HostClocks | None = None

    def configure(self, config: PlannerConfig) -> None:
        """Go on with another config, in which only what may be set while the agent runs has changed."""
        self.config = config

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """Remember what was received; answer a goal, and follow an acceptance with a plan or a rejection."""
        if isinstance(arrived, Command):
            return self._answer(arrived.message, arrived.now_ns)
        if isinstance(arrived, Received):
            self._remember(arrived)
        return ()

    def _remember(self, arrived: Received) -> None:
        if arrived.topic is THREAD:
            self._thread = arrived.message
        elif arrived.topic is SURFACE:
            self._surface = arrived.message
        elif arrived.topic is CLOCKS:
            self._clocks = arrived.message
        else:
            self._arms[arrived.message.arm] = arrived.message

    def _answer(self, goal: GraspGoal, now_ns: int) -> Iterable[Output | CommandAnswer]:
        try:
            thread, arm = planned_from(goal, self._thread, self._arms, now_ns, self.config, self._clocks)
        except RefusedGoalError as error:
            return (CommandAnswer(goal.header.id, Outcome.REFUSED, error.code, str(error)),)
        plan = plan_grasp(goal, thread, self._view(arm), self.config, self._seen_tissue(thread, now_ns))
        unknown = clock_unknown(self._clocks)
        return CommandAnswer(goal.header.id, Outcome.ACCEPTED, "", unknown), Output(PLAN, plan)

    def _seen_tissue(self, thread: ThreadReconstruction, now_ns: int) -> SeenTissue:
        surface = self._surface
        why = surface_unusable(surface, thread, now_ns)
        if surface is None or why:
            return SeenTissue(None, surface.stamp if surface else None, why)
        hidden = tool_cells(surface, self._arms.values(), self.config.tool_near_m)
        tissue = tissue_of(surface, hidden)
        return SeenTissue(tissue, surface.stamp, "" if tissue else "tools hide all that was measured")

    def _view(self, state: RobotState) -> ArmView:
        T_base_camera = inverse(state.T_camera_base)
        return ArmView(
            T_camera_base=state.T_camera_base,
            T_camera_tool=compose(state.T_camera_base, state.T_base_tool),
            reachable=lambda T_camera_tool: self._reaches(compose(T_base_camera, T_camera_tool)),
        )
