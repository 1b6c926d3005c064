"""One trial: planner, robot bridge and simulator in lockstep, from a look at the field to the judgement of a grasp."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from agents.simulated_trials.look import Came, Look
from agents.simulated_trials.protocol import Trial
from agents.simulated_trials.table import SpeedLimits, least_time_s
from schemas.messages import (
    Arm,
    CommandAnswer,
    CommandHeader,
    ExecutionEvent,
    ExecutionKind,
    GraspCheck,
    GraspGoal,
    GraspJudgement,
    GraspPlan,
    Heartbeat,
    Outcome,
    Phase,
    Policy,
    RobotState,
    SimulatorState,
    Status,
    Verdict,
)
from schemas.topics import (
    ARM,
    CHECK,
    EXECUTION,
    GOAL,
    HEARTBEAT,
    JUDGEMENT,
    PLAN,
    ROBOT_STATE,
    SIMULATOR_STATE,
    SURFACE,
    THREAD,
)
from shared.recording.mcap_file import Entry
from shared.rigid_transforms import compose
from shared.runtime.agent import Agent, Command, Output, Received, Tick
from shared.runtime.replay import BEGAN_NS, Lockstep

RIG, OPERATOR = "evaluation", "evaluation"
SETTLED_S = 0.2
"""By then the arm has told of itself."""
CAPTURED_NS = BEGAN_NS + round(SETTLED_S * 1e9)
"""When the frame of the first look is captured."""
SEES_S = 0.05
LOOK_S = 0.1
LONGEST_S = 150.0
JUDGED_S = 1.0
STILL_S = (0.3, 2.0)
"""After the end of a grasp, before it is looked at; and once more where that tells nothing."""
POLICY = {"direct": Policy.DIRECT, "robust": Policy.CAPTURE_SLIDE_GRASP}
CONTACT = (Phase.CAPTURE, Phase.SLIDE, Phase.GRASP)
END = (ExecutionKind.FINISHED, ExecutionKind.HELD)


@dataclass(frozen=True)
class Cast:
    """The agents of a trial, as they are before their first step, and what limits the arm."""

    planner: Agent
    bridge: Agent
    simulator: Agent
    limits: SpeedLimits


class Attendant(Agent):
    """The operator of an arm, who stands by: heartbeats for the plan that was armed last."""

    kind = "operator"
    outputs = (HEARTBEAT,)
    tick_hz = HEARTBEAT.rate_hz

    def __init__(self, arm: str) -> None:
        self.instance = arm
        self.armed: Arm | None = None

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output]:
        """A heartbeat at each tick while a plan is armed."""
        if self.armed is not None and isinstance(arrived, Tick):
            beat = Heartbeat(self.instance, self.armed.plan_id, arrived.now_ns, self.armed.header.id)
            return (Output(HEARTBEAT, beat),)
        return ()


@dataclass(frozen=True)
class Told:
    """What came of a trial, and all that was said in it where that was recorded."""

    came: Came
    entries: list[Entry]


Again = Callable[[SimulatorState, RobotState, int], Look]
"""A look at the field as it is, with the arm in it, at a time."""


def carried_out(trial: Trial, s: float, look: Look, cast: Cast, again: Again | None, recorded: bool = False) -> Told:
    """One trial with a goal at s of the thread that a look shows.

    Args:
        again: looks at the field after each grasp; without it, there is one attempt, and nobody looks.
    """
    attendant = Attendant(cast.bridge.instance)
    steps = Lockstep(cast.planner, cast.bridge, cast.simulator, attendant, rig=RIG, recorded=recorded, as_sent=True)
    steps.run(SETTLED_S + SEES_S)
    _tell(steps, look, recorded)
    header = CommandHeader(f"{trial.goal}-{trial.policy}", steps.now_ns + 10**9, OPERATOR)
    answer = steps.command(GOAL, GraspGoal(header, attendant.instance, POLICY[trial.policy], s, None, None))
    if answer.outcome is not Outcome.ACCEPTED:
        return Told(_declined(trial, s, answer), steps.entries)
    came, attempts, said = _grasped(trial, s, steps, attendant, cast), 1, None
    while again is not None and came.outcome != "declined":
        check = _checked(steps, again, recorded)
        said = check.verdict.name if check else None
        plan: GraspPlan = steps.last[PLAN]
        if check is None or plan.plan_id != check.next_plan_id or plan.status is not Status.OK:
            break
        following = _grasped(trial, s, steps, attendant, cast)
        if following.outcome == "declined":
            break
        came, attempts = following, attempts + 1
    return Told(came.model_copy(update={"attempts": attempts, "said": said}), steps.entries)


def _tell(steps: Lockstep, look: Look, recorded: bool) -> None:
    steps.tell(look.said if recorded else [said for said in look.said if said.topic in (SURFACE, THREAD)])


def _checked(steps: Lockstep, again: Again, recorded: bool) -> GraspCheck | None:
    """What the planner says of the grasp that has ended, once the field was looked at again."""
    for still_s in STILL_S:
        steps.run(still_s)
        _tell(steps, again(steps.last[SIMULATOR_STATE], steps.last[ROBOT_STATE], steps.now_ns), recorded)
        check: GraspCheck | None = steps.last.get(CHECK)
        if check is not None and check.plan_id == steps.last[EXECUTION].plan_id:
            return check
    return None


def _grasped(trial: Trial, s: float, steps: Lockstep, attendant: Attendant, cast: Cast) -> Came:
    """What comes of the plan that was published last."""
    plan: GraspPlan = steps.last[PLAN]
    known = {"s": s, "s_capture": plan.s_capture, "probability": plan.probability, "slide_m": plan.slide_m}
    if plan.status is not Status.OK:
        return Came(trial=trial, outcome="declined", code="rejected", sentence=plan.reason, s=s)
    here: RobotState = steps.last[ROBOT_STATE]
    armed = Arm(CommandHeader(f"arm-{plan.plan_id}", steps.now_ns + 10**9, OPERATOR), attendant.instance, plan.plan_id)
    answer = steps.command(ARM, armed)
    if answer.outcome is not Outcome.ACCEPTED:
        return _declined(trial, s, answer)
    began_ns, attendant.armed = steps.now_ns, armed
    end = _until_the_end(steps)
    known |= {"took_s": 1e-9 * (end.at_ns - began_ns) if end else None, "least_s": _least_s(here, plan, cast.limits)}
    return Came.model_validate({"trial": trial, **known, **_judged(steps, plan, end)})


def _declined(trial: Trial, s: float, answer: CommandAnswer) -> Came:
    return Came(trial=trial, outcome="declined", code=answer.code, sentence=answer.reason, s=s)


def _until_the_end(steps: Lockstep) -> ExecutionEvent | None:
    for _ in range(round(LONGEST_S / LOOK_S)):
        steps.run(LOOK_S)
        event: ExecutionEvent = steps.last[EXECUTION]
        if event.kind in END:
            return event
    return None


def _judged(steps: Lockstep, plan: GraspPlan, end: ExecutionEvent | None) -> dict[str, object]:
    """What the simulator says of a grasp that has ended."""
    if end is None or end.kind is not ExecutionKind.FINISHED:
        reason = end.reason if end else f"the motion had not ended after {LONGEST_S:.0f} s"
        return {"outcome": "failed", "code": end.code if end else "endless", "sentence": reason}
    for _ in range(round(JUDGED_S / LOOK_S)):
        judgement: GraspJudgement | None = steps.last.get(JUDGEMENT)
        if judgement is not None and judgement.plan_id == plan.plan_id:
            break
        steps.run(LOOK_S)
    else:
        return {"outcome": "failed", "code": "unjudged", "sentence": "the simulator gave no verdict"}
    return {
        "outcome": "held" if judgement.verdict is Verdict.HELD else "failed",
        "code": judgement.code or judgement.verdict.name,
        "sentence": judgement.sentence,
        "s_caught": judgement.s_caught,
        "peak_force_n": judgement.peak_tissue_force_n,
        "slipped_m": judgement.slipped_m,
    }


def _least_s(here: RobotState, plan: GraspPlan, limits: SpeedLimits) -> float:
    T_camera_here = compose(here.T_camera_base, here.T_base_tool)
    T = np.concatenate((T_camera_here[None], np.stack([waypoint.T_camera_tool for waypoint in plan.waypoints])))
    jaw_rad = np.array([here.jaw_rad, *(waypoint.jaw_rad for waypoint in plan.waypoints)])
    in_contact = np.array([False, *(waypoint.phase in CONTACT for waypoint in plan.waypoints)])
    return least_time_s(T, jaw_rad, in_contact, limits)
