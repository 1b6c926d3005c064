"""The planner and the bridge of a simulated rig, in step, as the driver of a pull: asked once, armed once, attended."""

from collections.abc import Iterable

from agents.cli.evaluate.pulling_field import ARM
from agents.cli.evaluate.trials import rig_for
from agents.launch.builders import build
from agents.planner.agent import Planner
from agents.planner.config import PlannerConfig
from agents.simulated_trials.look import Look
from agents.simulated_trials.pulling.driving import ArmState, Measured, Stop, Task
from agents.simulated_trials.trial import OPERATOR, RIG, SETTLED_S
from schemas.messages import (
    Arm,
    CommandHeader,
    ExecutionEvent,
    ExecutionKind,
    FrameNotice,
    GraspPlan,
    Heartbeat,
    Outcome,
    PullGoal,
    PullStop,
    RobotState,
    Status,
    Tail,
)
from schemas.topics import (
    ARM as ARMING,
)
from schemas.topics import (
    EXECUTION,
    FRAME_NOTICE,
    HEARTBEAT,
    PLAN,
    PULL_GOAL,
    ROBOT_STATE,
    SURFACE,
    TAIL,
    THREAD,
)
from shared.rigid_transforms import compose
from shared.runtime.agent import Agent, Command, Output, Received, Tick
from shared.runtime.replay import Lockstep

METHOD = "refined"
LOOKS = 4
"""So many frames are seen before the pull is asked for, so that the tissue is known."""
END = (ExecutionKind.FINISHED, ExecutionKind.HELD)


class Attendant(Agent):
    """Who stands by a pull that is armed."""

    kind = "operator"
    outputs = (HEARTBEAT,)
    tick_hz = HEARTBEAT.rate_hz

    def __init__(self) -> None:
        self.instance = ARM
        self.armed: Arm | None = None

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output]:
        """A heartbeat at each tick while a pull is armed."""
        if self.armed is not None and isinstance(arrived, Tick):
            yield Output(HEARTBEAT, Heartbeat(ARM, self.armed.plan_id, arrived.now_ns, self.armed.header.id))


class InStep:
    """A planner and a bridge in step, in virtual time."""

    def __init__(self, task: Task) -> None:
        errors = PlannerConfig(tool_error_m=task.tool_error_m, hand_eye_error_m=task.hand_eye_m, least_probability=0.0)
        self._attendant, self._task = Attendant(), task
        bridge = build(rig_for(METHOD), "robot_bridge", ARM)
        self._steps = Lockstep(Planner(errors), bridge, self._attendant, rig=RIG, as_sent=True)
        self._steps.run(SETTLED_S)
        self.began_ns = self._steps.now_ns
        self._looks = 0
        self.ended: Stop | None = None

    def advance(self, elapsed_s: float) -> ArmState:
        """Run all agents for so long."""
        if elapsed_s > 0.0:
            self._steps.run(elapsed_s)
        state: RobotState = self._steps.last[ROBOT_STATE]
        return ArmState(compose(state.T_camera_base, state.T_base_tool), state.jaw_rad)

    def see(self, look: Look) -> Measured | None:
        """Tell what was seen; ask and arm once the tissue is known."""
        self._looks += 1
        before = self._steps.last.get(TAIL)
        told = [said for said in look.said if said.topic in (SURFACE, THREAD)]
        self._steps.tell([Output(FRAME_NOTICE, FrameNotice(look.thread.stamp)), *told])
        self._steps.run(0.0)
        if self._looks == LOOKS:
            self._begin()
        tail: Tail | None = self._steps.last.get(TAIL)
        self._end()
        if tail is None or tail is before or tail.tail is None:
            return None
        return Measured(tail.tail.length_m, tail.tail.deviation_m, tail.tail.at_least)

    def _begin(self) -> None:
        header = CommandHeader("1", self._steps.now_ns + 10**9, OPERATOR)
        answer = self._steps.command(PULL_GOAL, PullGoal(header, ARM, self._task.goal_m, self._task.exit_px))
        if answer.outcome is not Outcome.ACCEPTED:
            self.ended = Stop(False, answer.code.upper() or "REFUSED", answer.reason)
            return
        plan: GraspPlan = self._steps.last[PLAN]
        if plan.status is not Status.OK:
            self.ended = Stop(False, "REJECTED", plan.reason)
            return
        header = CommandHeader("arm-1", self._steps.now_ns + 10**9, OPERATOR)
        bounds = None if plan.pull is None else plan.pull.bounds
        armed = Arm(header, ARM, plan.plan_id, pull=bounds)
        answer = self._steps.command(ARMING, armed)
        if answer.outcome is Outcome.ACCEPTED:
            self._attendant.armed = armed
        else:
            self.ended = Stop(False, answer.code.upper(), answer.reason)

    def _end(self) -> None:
        event: ExecutionEvent | None = self._steps.last.get(EXECUTION)
        if self._attendant.armed is None or event is None or event.kind not in END:
            return
        plan: GraspPlan = self._steps.last[PLAN]
        pull = plan.pull
        if event.kind is ExecutionKind.HELD or pull is None or pull.stop is None:
            self.ended = Stop(False, event.code.upper() or event.kind.name, event.reason)
            return
        tail = pull.tail
        measured = None if tail is None else Measured(tail.length_m, tail.deviation_m, tail.at_least)
        self.ended = Stop(pull.stop is PullStop.REACHED, pull.stop.name, pull.sentence, measured)
