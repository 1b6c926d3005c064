"""The planner as an agent: it keeps the newest thread, tissue, arms and account of clocks, and answers goals."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64

from agents.planner.captures import ArmView
from agents.planner.config import PlannerConfig
from agents.planner.learning import Attempt, next_attempt, same_attempt
from agents.planner.needle import NeedleAround, needle_around
from agents.planner.plan import plan_grasp
from agents.planner.pulling.measuring import tail_of
from agents.planner.pulling.segments import begin, go_on, let_go_unseen
from agents.planner.pulling.way import Around, tool_places
from agents.planner.refusal import RefusedGoalError, clock_unknown, planned_from, surface_unusable
from agents.planner.tissue import tissue_of
from agents.planner.tissue_clearance import SeenTissue
from agents.planner.tools import tool_axis, tool_cells
from agents.planner.watch import Watch, check_of, goal_again
from schemas.messages import (
    Checked,
    CommandAnswer,
    GraspGoal,
    GraspPlan,
    HostClocks,
    NeedlePose,
    Outcome,
    PullGoal,
    RobotState,
    ThreadReconstruction,
    TissueSurface,
)
from schemas.topics import (
    CHECK,
    CLOCKS,
    EXECUTION,
    GOAL,
    NEEDLE,
    PLAN,
    PULL_GOAL,
    ROBOT_STATE,
    SURFACE,
    TAIL,
    THREAD,
    Topic,
)
from shared.kinematics import psm
from shared.kinematics.arm import ArmKinematics
from shared.rigid_transforms import compose, inverse
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick

Reaches = Callable[[Float64[np.ndarray, "n 4 4"]], Bool[np.ndarray, "n"]]
"""Whether an arm can bring its tool to each `T_base_tool`."""


def reaches_of(arm: ArmKinematics, least_dexterity: float) -> Reaches:
    """What an arm can bring its tool to, within the limits of its joints and clear of singular poses."""

    def reaches(T_base_tool: Float64[np.ndarray, "n 4 4"]) -> Bool[np.ndarray, "n"]:
        joints, problem = arm.reach(T_base_tool)
        within = problem == psm.Problem.NONE
        within[within] = arm.dexterity(joints[within]) >= least_dexterity
        return within

    return reaches


class Planner(Agent):
    """Goals to plans, for all arms."""

    kind = "planner"
    config: PlannerConfig
    inputs = (
        Input(THREAD, only_newest_counts=True, only_remembered=True),
        Input(SURFACE, only_newest_counts=True, only_remembered=True),
        Input(NEEDLE, only_newest_counts=True, only_remembered=True),
        Input(ROBOT_STATE, instance="*", only_newest_counts=True, only_remembered=True),
        Input(CLOCKS, only_newest_counts=True),
        Input(EXECUTION, instance="*"),
    )
    outputs = (PLAN, CHECK, TAIL)
    goes_on_from = PLAN
    commands = (GOAL, PULL_GOAL)
    watches_clocks = ("camera",)

    def __init__(
        self,
        config: PlannerConfig | None = None,
        reaches: Reaches | None = None,
        others: Mapping[str, ArmKinematics] | None = None,
    ) -> None:
        """`reaches` is asked of PSMs; `others` are the arms that are none, by their names."""
        self.config, self._others = config or PlannerConfig(), others or {}
        self._reaches = reaches or reaches_of(psm.LARGE_NEEDLE_DRIVER, self.config.least_dexterity)
        self._thread: ThreadReconstruction | None = None
        self._surface: TissueSurface | None = None
        self._needle: NeedlePose | None = None
        self._arms: dict[str, RobotState] = {}
        self._clocks: HostClocks | None = None
        self._watch = Watch()

    def acts_on(self, topic: Topic) -> bool:
        """Whether more follows from what is only remembered otherwise: threads, while a grasp waits for its check."""
        return topic is THREAD and self._watch.waits

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """Remember what was received; answer a goal, and follow an acceptance with a plan or a rejection.

        The first thread that is seen after a grasp brings a check, and the next plan unless that is held.
        """
        if isinstance(arrived, Command):
            return self._answer(arrived.message, arrived.now_ns)
        if isinstance(arrived, Received):
            self._remember(arrived)
            if arrived.topic is THREAD:
                return self._check(arrived.message)
        return ()

    def _remember(self, arrived: Received) -> None:
        if arrived.topic is THREAD:
            self._thread = arrived.message
        elif arrived.topic is SURFACE:
            self._surface = arrived.message
        elif arrived.topic is NEEDLE:
            self._needle = arrived.message
        elif arrived.topic is CLOCKS:
            self._clocks = arrived.message
        elif arrived.topic is EXECUTION:
            self._watch.told(arrived.message)
        elif arrived.topic is PLAN:
            # in a replay: its own last output, in which all lies that it goes on from
            self._watch.planned(arrived.message)
        else:
            self._arms[arrived.message.arm] = arrived.message

    def _answer(self, goal: GraspGoal | PullGoal, now_ns: int) -> Iterable[Output | CommandAnswer]:
        try:
            thread, arm = planned_from(goal, self._thread, self._arms, now_ns, self.config, self._clocks)
        except RefusedGoalError as error:
            return (CommandAnswer(goal.header.id, Outcome.REFUSED, error.code, str(error)),)
        tissue, needle = self._seen_tissue(thread, now_ns), needle_around(self._needle, thread, now_ns)
        if isinstance(goal, PullGoal):
            around = Around(tissue, needle, self._other_tools(arm))
            plan = begin(goal, thread, self._view(arm), self.config, around)
        else:
            plan = plan_grasp(goal, thread, self._view(arm), self.config, tissue, needle=needle)
        plan = replace(plan, maximum_frame_age_s=arm.maximum_frame_age_s)
        self._watch.planned(plan)
        unknown = "; ".join(filter(None, (clock_unknown(self._clocks), self._reach_unknown(arm))))
        return CommandAnswer(goal.header.id, Outcome.ACCEPTED, "", unknown), Output(PLAN, plan)

    def _check(self, thread: ThreadReconstruction) -> Iterable[Output]:
        """Of each grasp that ended before the thread was seen, whether it holds it; of each segment, how to go on; of
        thread that is pulled, how long its tail is.
        """
        yield from self._tails(thread)
        for plan, since_ms in self._watch.resting(thread):
            state = self._arms.get(plan.arm)
            if state is not None and plan.pull is not None and plan.pull.tail_m is not None:
                yield from self._pull_on(plan, thread, state, since_ms)
            elif state is not None and plan.goal is not None:
                self._watch.goes_on(plan)
                yield Output(PLAN, self._on(plan, thread, state))
        for ended in self._watch.due(thread, self.config):
            state = self._arms.get(ended.plan.arm)
            T_camera_tool = compose(state.T_camera_base, state.T_base_tool) if state else None
            check = check_of(ended, thread, T_camera_tool, self.config)
            if check is None:
                continue
            self._watch.done(ended)
            yield Output(CHECK, check)
            if check.next_plan_id and state is not None:
                yield Output(PLAN, self._again(ended.plan, check.verdict, thread, state))

    def _tails(self, thread: ThreadReconstruction) -> Iterable[Output]:
        seen_ns = max(thread.stamp.capture_left_ns, thread.stamp.capture_right_ns)
        for plan, reached in self._watch.pulls:
            state = self._arms.get(plan.arm)
            if state is not None and plan.pull is not None and plan.pull.tail_m is not None:
                T_camera_tool = compose(state.T_camera_base, state.T_base_tool)
                needle = needle_around(self._needle, thread, seen_ns)
                yield Output(TAIL, tail_of(plan, reached, thread, T_camera_tool, self.config, needle))

    def _pull_on(
        self, plan: GraspPlan, thread: ThreadReconstruction, state: RobotState, since_ms: float
    ) -> Iterable[Output]:
        """The next segment of a pull; none from a thread that does not tell how to go on, and the bridge waits."""
        seen_ns = max(thread.stamp.capture_left_ns, thread.stamp.capture_right_ns)
        needle = needle_around(self._needle, thread, seen_ns)
        around = Around(self._seen_tissue(thread, seen_ns), needle, self._other_tools(state))
        following = go_on(plan, thread, self._view(state), self.config, around)
        if following is None and since_ms >= self.config.check_within_ms:
            following = let_go_unseen(plan, thread, self._view(state), self.config)
        if following is not None:
            following = replace(following, maximum_frame_age_s=state.maximum_frame_age_s)
            self._watch.goes_on(plan)
            self._watch.planned(following)
            yield Output(PLAN, following)

    def _other_tools(self, state: RobotState) -> tuple[Float64[np.ndarray, "k 3"], ...]:
        """Where the tools of the other arms are, in the camera frame."""
        return tuple(tool_places(tool_axis(other)) for name, other in self._arms.items() if name != state.arm)

    def _on(self, plan: GraspPlan, thread: ThreadReconstruction, state: RobotState) -> GraspPlan:
        """The plan's next segment, from what is seen now."""
        goal = goal_again(plan, thread)
        assert goal is not None  # noqa: S101 - plans without a goal are not gone on with
        attempt = same_attempt(plan, self.config)
        following = plan_grasp(goal, thread, self._view(state), self.config, *self._beside(thread, attempt))
        named = f"{plan.plan_id}+"
        following = replace(
            following, plan_id=named, continues=plan.plan_id, maximum_frame_age_s=state.maximum_frame_age_s
        )
        self._watch.planned(following)
        return following

    def _again(self, tried: GraspPlan, verdict: Checked, thread: ThreadReconstruction, state: RobotState) -> GraspPlan:
        """The next attempt at the goal of a plan that missed, or of which that cannot be told."""
        attempt, goal = next_attempt(tried, verdict, self.config), goal_again(tried, thread)
        assert attempt is not None and goal is not None  # noqa: S101 - the check has named it
        plan = plan_grasp(goal, thread, self._view(state), self.config, *self._beside(thread, attempt))
        plan = replace(plan, maximum_frame_age_s=state.maximum_frame_age_s)
        self._watch.planned(plan)
        return plan

    def _beside(
        self, thread: ThreadReconstruction, attempt: Attempt
    ) -> tuple[SeenTissue, Attempt, NeedleAround | None]:
        """What a plan is made with beside a thread that was just seen."""
        seen_ns = max(thread.stamp.capture_left_ns, thread.stamp.capture_right_ns)
        return self._seen_tissue(thread, seen_ns), attempt, needle_around(self._needle, thread, seen_ns)

    def _seen_tissue(self, thread: ThreadReconstruction, now_ns: int) -> SeenTissue:
        surface = self._surface
        why = surface_unusable(surface, thread, now_ns)
        if surface is None or why:
            return SeenTissue(None, surface.stamp if surface else None, why)
        hidden = tool_cells(surface, self._arms.values(), self.config.tool_near_m)
        tissue = tissue_of(surface, hidden)
        return SeenTissue(tissue, surface.stamp, "" if tissue else "tools hide all that was measured")

    def _reaches_of(self, state: RobotState) -> Reaches | None:
        """Whether an arm reaches poses, by what kind of arm it says it is; None where nothing tells its geometry."""
        if not state.kinematics:
            return self._reaches
        other = self._others.get(state.arm)
        if other is None or other.name != state.kinematics:
            return None
        return reaches_of(other, self.config.least_dexterity)

    def _reach_unknown(self, state: RobotState) -> str:
        if self._reaches_of(state) is not None:
            return ""
        kind = f"{state.arm} is of kind {state.kinematics!r}, whose geometry the planner was not told"
        return f"whether the arm reaches the plan is not known before it is armed: {kind}"

    def _view(self, state: RobotState) -> ArmView:
        T_base_camera = inverse(state.T_camera_base)
        # what nobody can tell is not held against a goal: the arm's bridge refuses what it cannot reach
        reaches = self._reaches_of(state) or (lambda T: np.ones(len(T), dtype=bool))
        return ArmView(
            T_camera_base=state.T_camera_base,
            T_camera_tool=compose(state.T_camera_base, state.T_base_tool),
            reachable=lambda T_camera_tool: reaches(compose(T_base_camera, T_camera_tool)),
        )
