"""The robot bridge: carries out armed plans on one arm, and refuses what is not safe.

Everything it does follows from what it is fed; the time is that of the ticks and commands.
"""

import logging
from collections.abc import Iterable

from agents.robot_bridge.backend import ArmState, Backend
from agents.robot_bridge.config import RobotBridgeConfig, RobotBridgeError
from agents.robot_bridge.execution import Execution, Patience
from agents.robot_bridge.motion import plan_motion
from agents.robot_bridge.plans import CLOCK_TOLERANCE_S, Plans, untimely, wrong_frame
from agents.robot_bridge.refusals import REPLAYED, UNMEASURED, Code, Refusal, other_arm
from agents.robot_bridge.standing import Standing
from agents.robot_bridge.state_changes import StateChanges
from agents.robot_bridge.telling import accepted, event_of, mode_of, refused, robot_state
from schemas.messages import (
    Arm,
    ChangeState,
    CommandAnswer,
    ExecutionKind,
    GraspPlan,
    Heartbeat,
    Hold,
    ReplayClock,
    RobotState,
    TissueSurface,
    ToolCorrection,
)
from schemas.topics import ARM, CHANGE_STATE, EXECUTION, HEARTBEAT, HOLD, PLAN, REPLAY_CLOCK, ROBOT_STATE, SURFACE, TOOL
from shared.runtime.agent import Command, Input, Output, Received, Tick

__all__ = ["RobotBridge", "RobotBridgeConfig", "RobotBridgeError"]

RESTS_AFTER_S = 1.0
"""So long after it was armed or moved last, an arm is at rest."""
REPLAY_OVER_S = 2.0
"""A replay that was not heard for so long is over."""


class RobotBridge:
    """Drives one arm: keeps plans, is armed for one at a time, follows it while heartbeats come, holds otherwise."""

    kind = "robot_bridge"
    outputs = (ROBOT_STATE, EXECUTION)
    commands = (ARM, HOLD, CHANGE_STATE)

    def __init__(self, config: RobotBridgeConfig, backend: Backend) -> None:
        """Stand ready, disarmed; nothing is asked of the backend before the first tick."""
        self.instance = config.arm
        self.accepts_replayed_time = backend.accepts_replayed_time
        clock = () if backend.accepts_replayed_time else (Input(REPLAY_CLOCK, only_newest_counts=True),)
        tissue = Input(SURFACE, only_newest_counts=True, only_remembered=True)
        images = Input(TOOL, config.arm, only_newest_counts=True, only_remembered=True)
        corrections = () if config.correction is None else (images,)
        self.inputs = (Input(PLAN), Input(HEARTBEAT, config.arm), tissue, *corrections, *clock)
        self.config, self._backend = config, backend
        self._plans, self._states = Plans(config.arm), StateChanges(config.arm, backend)
        self._now_ns: int | None = None
        self._replay_over_ns = 0
        self._rests_from_ns = 0
        self._execution: Execution | None = None
        self._holding = False
        self._turns = 0
        self._stands = Standing(config, backend, logging.getLogger(f"suturegrasp.{self.kind}.{config.arm}"))

    def configure(self, config: RobotBridgeConfig) -> None:
        """Go on with another config, in which only what may be set while the agent runs has changed."""
        self.config = config

    @property
    def executes(self) -> bool:
        """Whether a plan is armed, or being carried out."""
        return self._execution is not None

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
            case Command(message=ChangeState() as message):
                return [self._change_state(arrived, message)]
            case Received(message=GraspPlan() as plan):
                self._plans.keep(plan, replayed=(self._now_ns or 0) < self._replay_over_ns)
            case Received(message=Heartbeat() as heartbeat):
                self._beat(heartbeat)
            case Received(message=(TissueSurface() | ToolCorrection()) as told):
                self._stands.hear(told, armed=self.executes)
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
        arm = self._stands.measure(now_ns)
        if self._execution or (arm and self._stands.measured.has_moved(arm)):
            self._rests_from_ns = now_ns + round(RESTS_AFTER_S * 1e9)
        events = self._states.turn(now_ns)
        if self._execution:
            events += self._carry_on(self._execution, arm, now_ns, elapsed_s)
        return [Output(ROBOT_STATE, self._told(arm)), *events] if arm and (self._tells() or events) else events

    def _tells(self) -> bool:
        """Whether the state is told in this turn; where set points go out faster than it, not in each."""
        self._turns += 1
        return self._turns % max(1, round(self.tick_hz / (ROBOT_STATE.rate_hz or self.tick_hz))) == 0

    def _carry_on(self, execution: Execution, arm: ArmState | None, now_ns: int, elapsed_s: float) -> list[Output]:
        if (why := self._stands.broken(now_ns)) or arm is None:
            return self._hold(why or UNMEASURED, now_ns)
        following = execution.next(arm, now_ns, elapsed_s, self.config.ratio)
        if following is None:
            return []
        if isinstance(following, Refusal):
            return self._hold(following, now_ns)
        self._backend.move(following.joints, following.jaw_rad)
        of = execution.plan_id, execution.arming_id
        self._plans.moves(execution.plan_id, now_ns)
        reached = ExecutionKind.PHASE_REACHED
        events = [event_of(self.config.arm, *of, reached, now_ns, phase=phase) for phase in following.reached]
        if following.finished:
            self._execution = None
            self._plans.forget(execution.plan_id)
            events.append(event_of(self.config.arm, *of, ExecutionKind.FINISHED, now_ns))
        return events

    def _hold(self, why: Refusal, now_ns: int) -> list[Output]:
        """Stop and disarm."""
        self._backend.hold()
        self._holding = True
        execution, self._execution = self._execution, None
        if execution is None:
            return []
        return [event_of(self.config.arm, execution.plan_id, execution.arming_id, ExecutionKind.HELD, now_ns, why)]

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

    def _answer_arm(self, command: Command, message: Arm) -> list[Output | CommandAnswer]:
        armed, of = self._arm(command, message), (message.plan_id, message.header.id)
        if isinstance(armed, Refusal):
            event = event_of(self.config.arm, *of, ExecutionKind.REFUSED, command.now_ns, armed)
            return [refused(message.header.id, armed), event]
        self._execution, self._holding = armed, False
        event = event_of(self.config.arm, *of, ExecutionKind.ACCEPTED, command.now_ns)
        return [accepted(message.header.id), event]

    def _answer_hold(self, command: Command, message: Hold) -> list[Output | CommandAnswer]:
        if refusal := other_arm(self.config.arm, message.arm, command.instance):
            return [refused(message.header.id, refusal)]
        held = self._hold(Refusal(Code.HOLD_COMMAND, f"{message.header.sender} said hold"), command.now_ns)
        return [accepted(message.header.id), *held]

    def _change_state(self, command: Command, message: ChangeState) -> CommandAnswer:
        """A person has the console enable, home, pause: while nothing is armed, of an arm whose time is this one."""
        of = message.header.id
        if refusal := other_arm(self.config.arm, message.arm, command.instance):
            return refused(of, refusal)
        if command.now_ns < self._replay_over_ns:
            return refused(of, REPLAYED)
        if self._execution:
            return refused(of, self._busy())
        self._now_ns = command.now_ns
        self._stands.measure(command.now_ns)
        return self._states.answer(message, command.now_ns, self.config.ratio)

    def _arm(self, command: Command, message: Arm) -> Execution | Refusal:
        if refusal := other_arm(self.config.arm, message.arm, command.instance) or self._plans.unusable(
            message.plan_id
        ):
            return refusal
        if command.now_ns < self._replay_over_ns:
            return REPLAYED
        plan = self._busy() if self._execution else self._plans.find(message.plan_id)
        if isinstance(plan, Refusal):
            return plan
        if self._now_ns is not None:
            # between turns of an arm at rest much may have happened
            self._now_ns = command.now_ns
            self._stands.measure(command.now_ns)
        arm, why = self._stands.measured.state, self._stands.refusal(command.now_ns)
        if why or arm is None or self._now_ns is None:
            return why or UNMEASURED
        setup = self._stands.with_tissue(command.now_ns, self.config.maximum_plan_age_s)
        timely = command.now_ns, arm.still_since_ns, self._plans.last, self.config.maximum_plan_age_s
        if refusal := untimely(plan, *timely) or wrong_frame(plan, self._stands.frames(setup)):
            return refusal
        planned = plan_motion(plan.waypoints, arm.joints, arm.jaw_rad, setup)
        if isinstance(planned, Refusal):
            return planned
        if self._backend.dry_run:
            would = f"the motion of {planned.duration_s:.1f} s passes every check, and nothing was sent"
            return Refusal(Code.DRY_RUN, f"{would}: this is a dry run (dry_run of the arm's configuration)")
        patience = Patience(self.config.first_heartbeat_s, self.config.dead_man_s)
        return Execution(message, planned, self._now_ns, patience, self._backend.kinematics)

    def _busy(self) -> Refusal:
        carries_out = f"the arm carries out plan {self._execution.plan_id}" if self._execution else ""
        return Refusal(Code.BUSY, f"{carries_out}: let it end, or say hold, before arming")

    def _told(self, arm: ArmState) -> RobotState:
        execution = self._execution
        moving = execution is not None and execution.moving
        mode = mode_of(arm, self._stands, moving, self._holding)
        return robot_state(self.config.arm, arm, self._stands, mode, execution.plan_id if execution else "")
