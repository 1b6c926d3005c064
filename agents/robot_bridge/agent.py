"""The robot bridge: carries out armed plans on one arm, and refuses what is not safe.

Everything it does follows from what it is fed; the time is that of the ticks and commands.
"""

import dataclasses
import logging
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.backend import ArmState, Backend, Readiness
from agents.robot_bridge.execution import Execution, Patience
from agents.robot_bridge.limits import MAXIMUM_PLAN_AGE_S, MotionLimits, Setup
from agents.robot_bridge.motion import plan_motion
from agents.robot_bridge.refusals import Code, Refusal
from schemas.checks import MessageError
from schemas.messages import (
    Arm,
    CommandAnswer,
    ExecutionEvent,
    ExecutionKind,
    GraspPlan,
    Heartbeat,
    Hold,
    Outcome,
    Phase,
    ReplayClock,
    RobotMode,
    RobotState,
    Status,
)
from schemas.messages.grasping import check_pose
from schemas.topics import ARM, EXECUTION, HEARTBEAT, HOLD, PLAN, REPLAY_CLOCK, ROBOT_STATE
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.runtime.agent import Command, Input, Output, Received, Tick
from shared.runtime.settable import Between, settable

KEPT_PLANS = 8
STILL = np.array([2e-3, 2e-3, 2e-4, 2e-3, 2e-3, 2e-3, 2e-3])
"""An arm whose joints (rad, the third m) and jaw are this near to where they were a while ago has not moved."""
RESTS_AFTER_S = 1.0
"""So long after it was armed or moved last, an arm is at rest."""
MEASUREMENT_AGE_S = 0.1
"""An arm that was measured longer ago than this is not ready."""
CLOCK_TOLERANCE_S = 0.5
"""How far a plan's frame may lie in the future, or a heartbeat off its time, before clocks are said to disagree."""
REPLAY_OVER_S = 2.0
"""A replay that was not heard for so long is over."""

FIGURES = re.compile(r"[\d.]+")

REPLAYED = Refusal(
    Code.REPLAY, "a recording is replayed on this rig, and this arm is real: end the replay, then set a goal and arm"
)


class RobotBridgeError(ValueError):
    """A configuration that no arm can be driven with; the text names the setting."""


@dataclass(frozen=True, eq=False)
class RobotBridgeConfig:
    """One arm and how it is driven.

    Fields:
        arm: its name, which is the instance in its keys.
        T_camera_base: where its base is, in the rectified left camera's frame, metres.
        dead_man_s: without a heartbeat for longer than this, the arm holds and is disarmed.
        first_heartbeat_s: how long the first one may take; nothing moves before it.
        maximum_plan_age_s: since the frame that the plan was made from was captured; while the arm runs it can only be
            made smaller than it was configured.
        tick_hz, resting_hz: turns a second while the arm is armed or moves, and while it is disarmed and still; each
            turn of a motion sends a set point.
    """

    arm: str = "psm1"
    T_camera_base: Float64[np.ndarray, "4 4"] = field(default_factory=lambda: SIMULATED_T_CAMERA_BASE)
    dead_man_s: float = 0.2
    first_heartbeat_s: float = 1.0
    maximum_plan_age_s: float = settable(MAXIMUM_PLAN_AGE_S, Between(0.1))
    tick_hz: float = ROBOT_STATE.rate_hz or 100.0
    resting_hz: float = ROBOT_STATE.resting_hz or 10.0
    limits: MotionLimits = field(default_factory=MotionLimits)

    def __post_init__(self) -> None:
        try:
            check_pose("the arm's T_camera_base", self.T_camera_base)
        except MessageError as error:
            raise RobotBridgeError(str(error)) from error
        for name in ("dead_man_s", "first_heartbeat_s", "maximum_plan_age_s", "tick_hz", "resting_hz"):
            if not 0 < getattr(self, name) < float("inf"):
                raise RobotBridgeError(f"{name} must be positive and finite, not {getattr(self, name)}")


class RobotBridge:
    """Drives one arm: keeps plans, is armed for one at a time, follows it while heartbeats come, holds otherwise."""

    kind = "robot_bridge"
    outputs = (ROBOT_STATE, EXECUTION)
    commands = (ARM, HOLD)

    def __init__(self, config: RobotBridgeConfig, backend: Backend) -> None:
        """Stand ready, disarmed; nothing is asked of the backend before the first tick."""
        self.instance = config.arm
        self.accepts_replayed_time = backend.accepts_replayed_time
        clock = () if backend.accepts_replayed_time else (Input(REPLAY_CLOCK, only_newest_counts=True),)
        self.inputs = (Input(PLAN), Input(HEARTBEAT, config.arm), *clock)
        self.config, self._backend = config, backend
        self._setup = Setup(backend.kinematics, config.T_camera_base, config.limits, 1 / config.tick_hz)
        self._plans: dict[str, GraspPlan] = {}
        self._unusable: dict[str, Refusal] = {}
        self._now_ns: int | None = None
        self._replay_over_ns = 0
        self._arm_state: ArmState | None = None
        self._still_at = np.full(7, np.inf)
        self._tool: tuple[np.ndarray, Float64[np.ndarray, "4 4"]] | None = None
        self._rests_from_ns = 0
        self._not_ready = "the arm has not been measured yet"
        self._execution: Execution | None = None
        self._holding = False
        self._turns = 0
        self._log, self._logged = logging.getLogger(f"suturegrasp.{self.kind}.{config.arm}"), ""

    def configure(self, config: RobotBridgeConfig) -> None:
        """Go on with another config, in which only what may be set while the agent runs has changed."""
        self.config = config

    @property
    def tick_hz(self) -> float:
        """All of its turns while the arm is armed or moves; few are enough for one that is disarmed and still."""
        left_s = (self._rests_from_ns - (self._now_ns or 0)) * 1e-9
        # where the clock was set back, nobody waits for it to be as late again
        if self._execution or 0 < left_s <= RESTS_AFTER_S:
            return self.config.tick_hz
        return min(self.config.resting_hz, self.config.tick_hz)

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """What follows from one message, tick or command."""
        match arrived:
            case Tick(now_ns):
                return self._tick(now_ns)
            case Command(message=Arm() as message):
                return self._answer_arm(arrived, message)
            case Command(message=Hold() as message):
                return self._answer_hold(arrived, message)
            case Received(message=GraspPlan() as plan):
                self._keep(plan)
            case Received(message=Heartbeat() as heartbeat):
                self._beat(heartbeat)
            case Received(message=ReplayClock()):
                return self._refuse_replay()
            case _:
                pass
        return ()

    def close(self) -> None:
        """Have the arm stop where it is; nothing follows any more."""
        self._execution = None
        self._backend.close()

    def _tick(self, now_ns: int) -> list[Output]:
        """One turn; where anything in it fails, the arm holds and is disarmed before the failure is passed on."""
        try:
            return self._turn(now_ns)
        except Exception:
            self._execution, self._holding = None, True
            self._backend.hold()
            raise

    def _turn(self, now_ns: int) -> list[Output]:
        elapsed_s = 0.0 if self._now_ns is None else (now_ns - self._now_ns) * 1e-9
        self._now_ns = now_ns
        arm = self._measure(now_ns)
        if self._execution or (arm and self._has_moved(arm)):
            self._rests_from_ns = now_ns + round(RESTS_AFTER_S * 1e9)
        events = self._carry_on(self._execution, arm, now_ns, elapsed_s) if self._execution else []
        return [Output(ROBOT_STATE, self._robot_state(arm)), *events] if arm and (self._tells() or events) else events

    def _tells(self) -> bool:
        """Whether the state is told in this turn; where set points go out faster than it, not in each."""
        self._turns += 1
        return self._turns % max(1, round(self.tick_hz / (ROBOT_STATE.rate_hz or self.tick_hz))) == 0

    def _measure(self, now_ns: int) -> ArmState | None:
        """The newest finite state, noting why the arm is not ready."""
        state = self._backend.state(now_ns)
        if not (np.isfinite(state.joints).all() and np.isfinite(state.jaw_rad)):
            self._not_ready = state.reason or "the arm reports a joint that is not finite"
            self._tell_readiness()
            return self._arm_state
        self._arm_state = state
        if state.T_camera_base is not None:
            self._setup = dataclasses.replace(self._setup, T_camera_base=state.T_camera_base)
        late = abs(now_ns - state.measured_ns) > MEASUREMENT_AGE_S * 1e9
        if state.readiness is not Readiness.READY:
            self._not_ready = f"the arm is {state.readiness.name}: {state.reason}"
        else:
            self._not_ready = f"the arm was not measured for {MEASUREMENT_AGE_S:g} s" if late else ""
        self._tell_readiness()
        return state

    def _tell_readiness(self) -> None:
        """Log why the arm is not ready, and that it is again; not each change of a figure in it."""
        words = FIGURES.sub("", self._not_ready)
        if words != self._logged:
            self._logged = words
            self._log.warning("%s", self._not_ready) if words else self._log.info("the arm is ready")

    def _has_moved(self, arm: ArmState) -> bool:
        place = np.append(arm.joints, arm.jaw_rad)
        if (np.abs(place - self._still_at) <= STILL).all():
            return False
        self._still_at = place
        return True

    def _carry_on(self, execution: Execution, arm: ArmState | None, now_ns: int, elapsed_s: float) -> list[Output]:
        if self._not_ready or arm is None:
            return self._hold(Refusal(Code.NOT_READY, self._not_ready), now_ns)
        following = execution.next(arm, now_ns, elapsed_s)
        if following is None:
            return []
        if isinstance(following, Refusal):
            return self._hold(following, now_ns)
        self._backend.move(following.joints, following.jaw_rad)
        of = execution.plan_id, execution.arming_id
        events = [self._event(*of, ExecutionKind.PHASE_REACHED, now_ns, phase=p) for p in following.reached]
        if following.finished:
            self._execution = None
            self._plans.pop(execution.plan_id, None)
            events.append(self._event(*of, ExecutionKind.FINISHED, now_ns))
        return events

    def _hold(self, why: Refusal, now_ns: int) -> list[Output]:
        """Stop and disarm."""
        self._backend.hold()
        self._holding = True
        execution, self._execution = self._execution, None
        if execution is None:
            return []
        return [self._event(execution.plan_id, execution.arming_id, ExecutionKind.HELD, now_ns, why)]

    def _beat(self, heartbeat: Heartbeat) -> None:
        execution = self._execution
        named = (heartbeat.arm, heartbeat.plan_id, heartbeat.arming_id)
        ours = execution and named == (self.config.arm, execution.plan_id, execution.arming_id)
        if execution and ours and self._now_ns is not None:
            # one that was long on its way, or is played again, does not tell that anybody is there now
            ahead_s = (heartbeat.at_ns - self._now_ns) * 1e-9
            if abs(ahead_s) <= self.config.dead_man_s + CLOCK_TOLERANCE_S:
                execution.beat(heartbeat.at_ns, self._now_ns)
            else:
                execution.untimely(ahead_s)

    def _refuse_replay(self) -> list[Output]:
        """A recording is replayed on this arm's rig: it stays where it is until that is over."""
        self._replay_over_ns = (self._now_ns or 0) + round(REPLAY_OVER_S * 1e9)
        return self._hold(REPLAYED, self._now_ns or 0) if self._execution else []

    def _keep(self, plan: GraspPlan) -> None:
        """Keep a plan that this arm could be armed with, or else why it could not."""
        self._plans.pop(plan.plan_id, None)
        self._unusable.pop(plan.plan_id, None)
        if plan.arm != self.config.arm:
            sentence = f"plan {plan.plan_id} is for {plan.arm}, and this is {self.config.arm}"
            _keep_few(self._unusable, plan.plan_id, Refusal(Code.OTHER_ARM, sentence))
        elif plan.status is not Status.OK:
            sentence = f"the planner rejected plan {plan.plan_id}: {plan.reason}"
            _keep_few(self._unusable, plan.plan_id, Refusal(Code.REJECTED_PLAN, sentence))
        elif (self._now_ns or 0) < self._replay_over_ns:
            _keep_few(self._unusable, plan.plan_id, REPLAYED)
        else:
            _keep_few(self._plans, plan.plan_id, plan)

    def _answer_arm(self, command: Command, message: Arm) -> list[Output | CommandAnswer]:
        armed, of = self._arm(command, message), (message.plan_id, message.header.id)
        if isinstance(armed, Refusal):
            refused = self._event(*of, ExecutionKind.REFUSED, command.now_ns, armed)
            return [_refused(message.header.id, armed), refused]
        self._execution, self._holding = armed, False
        accepted = self._event(*of, ExecutionKind.ACCEPTED, command.now_ns)
        return [CommandAnswer(message.header.id, Outcome.ACCEPTED, "", ""), accepted]

    def _answer_hold(self, command: Command, message: Hold) -> list[Output | CommandAnswer]:
        if refusal := self._wrong_arm(command, message.arm):
            return [_refused(message.header.id, refusal)]
        held = self._hold(Refusal(Code.HOLD_COMMAND, f"{message.header.sender} said hold"), command.now_ns)
        return [CommandAnswer(message.header.id, Outcome.ACCEPTED, "", ""), *held]

    def _arm(self, command: Command, message: Arm) -> Execution | Refusal:
        plan = self._plans.get(message.plan_id)
        if refusal := self._wrong_arm(command, message.arm) or self._unusable.get(message.plan_id):
            return refusal
        if command.now_ns < self._replay_over_ns:
            return REPLAYED
        if self._execution:
            return Refusal(
                Code.BUSY, f"the arm carries out plan {self._execution.plan_id}: let it end, or say hold, before arming"
            )
        if plan is None:
            return Refusal(
                Code.UNKNOWN_PLAN, f"no plan {message.plan_id} is among the last {KEPT_PLANS}: set a goal again"
            )
        if self._now_ns is not None:
            # between turns of an arm at rest much may have happened
            self._now_ns = command.now_ns
            self._measure(command.now_ns)
        if self._not_ready or self._arm_state is None or self._now_ns is None:
            return Refusal(Code.NOT_READY, self._not_ready)
        if refusal := self._untimely(plan, command.now_ns):
            return refusal
        planned = plan_motion(plan.waypoints, self._arm_state.joints, self._arm_state.jaw_rad, self._setup)
        if isinstance(planned, Refusal):
            return planned
        if self._backend.dry_run:
            would = f"the motion of {planned.duration_s:.1f} s passes every check, and nothing was sent"
            return Refusal(Code.DRY_RUN, f"{would}: this is a dry run (dry_run of the arm's configuration)")
        patience = Patience(self.config.first_heartbeat_s, self.config.dead_man_s)
        return Execution(message, planned, self._now_ns, patience, self._backend.kinematics)

    def _wrong_arm(self, command: Command, arm: str) -> Refusal | None:
        named = next((name for name in (arm, command.instance) if name != self.config.arm), None)
        sentence = f"the command is for {named}, and this is {self.config.arm}"
        return Refusal(Code.OTHER_ARM, sentence) if named is not None else None

    def _untimely(self, plan: GraspPlan, now_ns: int) -> Refusal | None:
        captured_ns = min(plan.stamp.capture_left_ns, plan.stamp.capture_right_ns)
        age_s = (now_ns - captured_ns) * 1e-9
        if age_s > self.config.maximum_plan_age_s:
            allowed = f"more than the {self.config.maximum_plan_age_s:g} s allowed: plan again"
            return Refusal(Code.STALE, f"the frame of plan {plan.plan_id} is {age_s:.1f} s old, {allowed}")
        if self._arm_state is not None and captured_ns < self._arm_state.still_since_ns:
            moved = "camera, set-up joints or arm were moved by hand"
            return Refusal(Code.MOVED, f"{moved} after the frame of plan {plan.plan_id} was captured: plan again")
        if age_s < -CLOCK_TOLERANCE_S:
            future = f"the frame of plan {plan.plan_id} was captured {-age_s:.1f} s in the future"
            return Refusal(Code.CLOCK, f"{future}: set the clocks of camera and bridge by each other")
        return None

    def _robot_state(self, arm: ArmState) -> RobotState:
        return RobotState(
            arm=self.config.arm,
            measured_ns=arm.measured_ns,
            mode=self._mode(arm),
            T_base_tool=self._tool_pose(arm),
            joints=arm.joints,
            jaw_rad=arm.jaw_rad,
            T_camera_base=self._setup.T_camera_base,
            plan_id=self._execution.plan_id if self._execution else "",
        )

    def _tool_pose(self, arm: ArmState) -> Float64[np.ndarray, "4 4"]:
        """The pose of the tool, computed anew where the joints are others than the last time."""
        if self._tool is None or not np.array_equal(self._tool[0], arm.joints):
            self._tool = arm.joints.copy(), self._backend.kinematics.forward(arm.joints)
        return self._tool[1]

    def _mode(self, arm: ArmState) -> RobotMode:
        if self._not_ready:
            return RobotMode.DISABLED if arm.readiness is Readiness.DISABLED else RobotMode.FAULT
        if self._execution and self._execution.moving:
            return RobotMode.MOVING
        return RobotMode.HOLDING if self._holding else RobotMode.IDLE

    def _event(
        self,
        plan_id: str,
        arming_id: str,
        kind: ExecutionKind,
        at_ns: int,
        why: Refusal | None = None,
        phase: Phase | None = None,
    ) -> Output:
        code, reason = (why.code.value, why.sentence) if why else ("", "")
        event = ExecutionEvent(plan_id, self.config.arm, at_ns, kind, phase, code, reason, arming_id)
        return Output(EXECUTION, event)


def _refused(command_id: str, why: Refusal) -> CommandAnswer:
    return CommandAnswer(command_id, Outcome.REFUSED, why.code.value, why.sentence)


def _keep_few(kept: dict[str, Any], plan_id: str, value: Any) -> None:
    """Keep the newest ones; a dict remembers in which order they came."""
    kept[plan_id] = value
    if len(kept) > KEPT_PLANS:
        del kept[next(iter(kept))]
