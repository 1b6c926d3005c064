"""The robot bridge: carries out armed plans on one arm, and refuses what is not safe.

Everything it does follows from what it is fed; the time is that of the ticks and commands. Stopping comes first: a hold
reaches the backend before anything is computed, told or written down, and is said again in each tick until it is known
to have come about.
"""

import dataclasses
import logging
from collections.abc import Iterable

import numpy as np

from agents.robot_bridge.arm_status import Challenges, Sight, Standing, too_old
from agents.robot_bridge.backend import ArmState, Backend
from agents.robot_bridge.config import RobotBridgeConfig, RobotBridgeError
from agents.robot_bridge.execution import Execution, Patience
from agents.robot_bridge.motion import Trajectory, contact_joints, left_of, plan_motion
from agents.robot_bridge.outputs import accepted, event_of, mode_of, refused, robot_state
from agents.robot_bridge.plans import (
    CLOCK_TOLERANCE_S,
    REPLAYED,
    UNMEASURED,
    Code,
    Plans,
    Refusal,
    other_arm,
    taken_ns,
    untimely,
    wrong_frame,
)
from agents.robot_bridge.pulling import AFTER, LETS_GO_RAD, Pulling, lets_go_only, pulling_of
from agents.robot_bridge.state_changes import StateChanges
from schemas.messages import (
    Arm,
    ChangeState,
    CommandAnswer,
    ExecutionKind,
    FrameNotice,
    GraspPlan,
    Heartbeat,
    Phase,
    ReplayClock,
    RobotState,
    StateWord,
    Status,
    Tail,
    TissueSurface,
    ToolCorrection,
)
from schemas.topics import (
    ARM,
    CHANGE_STATE,
    EXECUTION,
    FRAME_NOTICE,
    HEARTBEAT,
    HOLD,
    PLAN,
    REPLAY_CLOCK,
    ROBOT_STATE,
    SURFACE,
    TAIL,
    TOOL,
)
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick
from shared.runtime.commands import stops

__all__ = ["RobotBridge", "RobotBridgeConfig", "RobotBridgeError"]

RESTS_AFTER_S = 1.0
"""So long after it was armed or moved last, an arm is at rest."""
REPLAY_OVER_S = 2.0
"""A replay that was not heard for so long is over."""
UNTOLD = "the arm could not be told yet: it is told again in each turn, and the guard beside it lets nothing pass"
UNSENT = "nothing was sent: this is a dry run (dry_run of the arm's configuration); stop the arm at its console"
HELD_MEANWHILE = Refusal(
    Code.HOLD_COMMAND, "somebody said hold since whoever asks last heard of the arm: look, then ask again"
)
LEFT_HOLDING = Refusal(
    Code.PULL_ORDER, "the jaws may hold thread since a pull was held: let go first (suturegrasp pull --release)"
)
MOST_SEGMENTS = 8
"""Of a chained motion, which whoever arms it may only make fewer."""

Replies = Iterable[Output | CommandAnswer]


class RobotBridge(Agent):
    """Drives one arm: keeps plans, is armed for one at a time, follows it while heartbeats come, holds otherwise."""

    kind = "robot_bridge"
    config: RobotBridgeConfig
    outputs = (ROBOT_STATE, EXECUTION)
    commands = (ARM, HOLD, CHANGE_STATE)

    def __init__(self, config: RobotBridgeConfig, backend: Backend) -> None:
        """Stand ready, disarmed; nothing is asked of the backend before the first tick."""
        self.instance = config.arm
        self.accepts_replayed_time = backend.accepts_replayed_time
        clock = () if backend.accepts_replayed_time else (Input(REPLAY_CLOCK, only_newest_counts=True),)
        tissue = Input(SURFACE, only_newest_counts=True, only_remembered=True)
        frames = Input(FRAME_NOTICE, only_newest_counts=True, only_remembered=True)
        images = Input(TOOL, config.arm, only_newest_counts=True, only_remembered=True)
        corrections = () if config.correction is None else (images,)
        # each counts: of another arm's none must take the place of this one's
        tails = Input(TAIL)
        self.inputs = (Input(PLAN), Input(HEARTBEAT, config.arm), tissue, frames, tails, *corrections, *clock)
        self.config, self._backend = config, backend
        self._plans, self._states = Plans(config.arm), StateChanges(config.arm, backend)
        self._challenges = Challenges()
        self._sight = Sight(config.arm, backend.is_real, self._challenges)
        self._now_ns: int | None = None
        self._replay_over_ns = 0
        self._rests_from_ns = 0
        self._may_be_armed_ns = 0
        self._execution: Execution | None = None
        self._holding = False
        self._unconfirmed = False
        self._told_to_hold = True
        self._held_at_ns = 0
        self._left_holding = False
        self._pauses = False
        self._turns = 0
        self._log = logging.getLogger(f"suturegrasp.{self.kind}.{config.arm}")
        self._stands = Standing(config, backend, self._log)

    @property
    def executes(self) -> bool:
        """Whether a plan is armed, or being carried out."""
        return self._execution is not None

    @property
    def keeps_time(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - the runtime only reads it
        """Whether its clock must not jump now."""
        return self.executes

    @property
    def tick_hz(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride] - the runtime only reads it
        """All of its turns while the arm is armed, moves, or is told to hold; few for one at rest."""
        now_ns = self._now_ns or 0
        # where the clock was set back, nobody waits for it to be as late again
        stirs = 0 < self._rests_from_ns - now_ns <= RESTS_AFTER_S * 1e9
        may_be_armed = 0 < self._may_be_armed_ns - now_ns <= self.config.maximum_plan_age_s * 1e9
        if self._execution or self._unconfirmed or stirs or may_be_armed:
            return self.config.tick_hz
        return min(self.config.resting_hz, self.config.tick_hz)

    def halt(self) -> None:
        """Stop the arm at once, from any thread: a command that stops has come, and will be stepped next."""
        self._backend.halt()

    def step(self, arrived: Received | Tick | Command) -> Replies:
        """What follows from one message, tick or command."""
        match arrived:
            case Tick(now_ns):
                return self._tick(now_ns)
            case Command(message=message) if stops(message):
                return self._answer_stop(arrived)
            case Command(message=Arm() as message):
                return self._answer_arm(arrived, message)
            case Command(message=ChangeState() as message):
                return [self._change_state(arrived, message)]
            case Received(message=GraspPlan() as plan):
                return self._keep(plan)
            case Received(message=Heartbeat() as heartbeat):
                self._beat(heartbeat)
            case Received(message=Tail() as tail):
                if self._execution is not None and self._execution.pull is not None and tail.arm == self.config.arm:
                    self._execution.pull.hear(tail)
            case Received(message=FrameNotice() as notice):
                self._sight.hear(notice.stamp)
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

    def stop(self, why: Refusal, now_ns: int) -> list[Output]:
        """Stop and disarm; a backend that fails is told again in the next tick, and the guard holds meanwhile."""
        self._holding = self._unconfirmed = True
        execution, self._execution = self._execution, None
        self._told_to_hold = False
        try:
            self._told_to_hold = self._backend.hold()
        except Exception:
            self._log.exception("the arm could not be told to hold; it is told again in each turn")
        if execution is None:
            return []
        pull = execution.pull
        pulled = pull is not None and (pull.held or (pull.holds and execution.touched))
        self._left_holding = self._left_holding or pulled
        return [event_of(self.config.arm, execution.plan_id, execution.arming_id, ExecutionKind.HELD, now_ns, why)]

    def _tick(self, now_ns: int) -> Iterable[Output]:
        """One turn; where anything in it fails, the arm holds and is disarmed before the failure is passed on.

        Raises:
            Exception: what failed, once what followed was given.
        """
        if self._unconfirmed:
            self._hold_again()
        try:
            # that a console does something by itself may be heard later than that it was told to
            self._pauses = self._pauses and (self._is_busy or bool(self._states.awaited))
            self._pause(now_ns)
            outputs, failure = self._turn(now_ns), None
        except Exception as error:
            failed = f"a turn of the bridge failed ({type(error).__name__}): see its log, then arm again"
            outputs, failure = self.stop(Refusal(Code.FAULT, failed), now_ns), error
        yield from outputs
        if failure is not None:
            raise failure

    @property
    def _is_busy(self) -> bool:
        arm = self._stands.measured.state
        return arm is not None and arm.busy

    def _pause(self, now_ns: int) -> None:
        """Have the console pause, again and again until it does nothing by itself any more."""
        if not self._pauses:
            return
        try:
            self._backend.change_state(StateWord.PAUSE, now_ns)
        except Exception:
            # a hold is answered whatever becomes of this, which is said again in each turn
            self._log.exception("the console could not be told to pause")

    def _hold_again(self) -> None:
        try:
            self._unconfirmed = not self._backend.holds
            if self._unconfirmed:
                self._backend.hold()
        except Exception as error:
            self._unconfirmed = True
            self._log.warning("the arm could not be told to hold: %s", error)

    def _turn(self, now_ns: int) -> list[Output]:
        elapsed_s = 0.0 if self._now_ns is None else (now_ns - self._now_ns) * 1e-9
        self._know_nothing_of_before(now_ns)
        self._now_ns = now_ns
        arm = self._stands.measure(now_ns)
        if arm is not None and arm.jaw_rad - self._stands.setup.jaw.told_rad > LETS_GO_RAD:
            self._left_holding = False
        if self._execution or (arm and self._stands.measured.has_moved(arm)):
            self._rests_from_ns = now_ns + round(RESTS_AFTER_S * 1e9)
        events = self._states.turn(now_ns)
        if self._execution:
            events += self._carry_on(self._execution, arm, now_ns, elapsed_s)
        return [Output(ROBOT_STATE, self._told(arm, now_ns)), *events] if arm and (self._tells() or events) else events

    def _know_nothing_of_before(self, now_ns: int) -> None:
        """A real arm's bridge that begins knows not what its jaws hold; one whose clock was set back, not what is old.

        What is kept of the planner's and the camera's comes again as soon as a bridge is there, however old it is.
        """
        if self._now_ns is None and self._backend.is_real:
            self._plans.begins(now_ns)
        elif self._now_ns is not None and now_ns < self._now_ns:
            self._plans.begins(now_ns)
            self._sight.hear(None)
            self._stands.forget_tissue()
            self._held_at_ns = min(self._held_at_ns, now_ns)

    def _tells(self) -> bool:
        """Whether the state is told in this turn; where set points go out faster than it, not in each."""
        self._turns += 1
        return self._turns % max(1, round(self.tick_hz / (ROBOT_STATE.rate_hz or self.tick_hz))) == 0

    def _carry_on(self, execution: Execution, arm: ArmState | None, now_ns: int, elapsed_s: float) -> list[Output]:
        if self._backend.halted:
            return self.stop(Refusal(Code.HOLD_COMMAND, "a command to stop has come"), now_ns)
        why = self._stands.broken(now_ns) or self._blind(now_ns) or self._unattended(execution, arm)
        why = why or self._pulls_on(execution, now_ns)
        if why or arm is None:
            return self.stop(why or UNMEASURED, now_ns)
        rested = execution.ended_ns is not None
        if not execution.let_through:
            # it stays at its first set point: what goes on before anything passes, the arm would make up for at once
            execution.let_through = self._backend.lets_through(execution.arming_id)
        following = execution.next(arm, now_ns, elapsed_s, self.config.ratio)
        if following is None:
            return []
        if isinstance(following, Refusal):
            return self.stop(following, now_ns)
        self._backend.move(following.joints, following.jaw_rad, execution.arming_id)
        of = execution.plan_id, execution.arming_id
        if not rested:
            # while it rests it touches nothing: the next segment is planned from a frame that is taken meanwhile
            self._plans.moves(execution.plan_id, now_ns, execution.touched)
        kinds: list[tuple[ExecutionKind, Phase | None]]
        kinds = [(ExecutionKind.PHASE_REACHED, phase) for phase in following.reached]
        if following.finished:
            self._execution = None
            self._backend.finish(execution.arming_id)
            self._plans.forget(execution.plan_id)
            if execution.pull is not None:
                self._left_holding = execution.pull.holds
            kinds.append((ExecutionKind.FINISHED, None))
        elif execution.ended_ns is not None and not rested:
            kinds.append((ExecutionKind.SEGMENT_ENDED, None))
        return [event_of(self.config.arm, *of, kind, now_ns, phase=phase) for kind, phase in kinds]

    def _pulls_on(self, execution: Execution, now_ns: int) -> Refusal | None:
        """Why a pull must not go on; the planner's word to stop ends its segment."""
        pull = execution.pull
        if pull is None or not execution.moving:
            return None
        if why := pull.overdue(execution.plan, now_ns):
            return why
        if not execution.pulls:
            return None
        if pull.says_stop:
            execution.end_early()
        seen = self.config.arm, self._backend.is_real, now_ns, self.config.pull.tail_age_s
        return pull.unwatched(execution.plans, *seen)

    def _blind(self, now_ns: int) -> Refusal | None:
        """Why nobody sees where the arm moves: the newest frame, or that of its plan, is too old."""
        if why := self._sight.refusal(now_ns, self.config.maximum_frame_age_s):
            return why
        execution = self._execution
        if execution is None:
            return None
        allowed_s = self.config.maximum_plan_age_s + self.config.maximum_motion_s
        of = self.config.arm, self._backend.is_real, now_ns, allowed_s, "the frame of its plan"
        return too_old(execution.plan.stamp, *of)

    def _unattended(self, execution: Execution, arm: ArmState | None) -> Refusal | None:
        """Why a real arm that a process armed must not go on: the console's pedal was released."""
        if not self._backend.is_real or execution.pressed or (arm is not None and arm.pedal):
            return None
        return Refusal(Code.NO_PRESENCE, "the console's operator-present pedal was released: press it, then arm again")

    def _beat(self, heartbeat: Heartbeat) -> None:
        execution, now_ns = self._execution, self._now_ns
        if execution is None or now_ns is None or heartbeat.plan_id not in execution.plans:
            return
        if (heartbeat.arm, heartbeat.arming_id) != (self.config.arm, execution.arming_id):
            return
        if heartbeat.pressed != execution.pressed and self._backend.is_real:
            # a process's heartbeat does not stand in for a press
            return
        age_ns = self._challenges.age_ns(heartbeat.challenge_ns, now_ns)
        if age_ns is not None:
            within = age_ns <= self.config.dead_man_s * 1e9
            execution.answered(heartbeat.challenge_ns) if within else execution.late(age_ns)
            return
        # one that was long on its way, or is played again, does not tell that anybody is there now
        timely = abs(heartbeat.at_ns - now_ns) * 1e-9 <= self.config.dead_man_s + CLOCK_TOLERANCE_S
        if heartbeat.challenge_ns == 0 and timely and not self._backend.is_real:
            execution.beaten(heartbeat.at_ns, now_ns)

    def _refuse_replay(self) -> list[Output]:
        """A recording is replayed on this arm's rig: it stays where it is until that is over."""
        self._replay_over_ns = (self._now_ns or 0) + round(REPLAY_OVER_S * 1e9)
        return self.stop(REPLAYED, self._now_ns or 0) if self._execution else []

    def _keep(self, plan: GraspPlan) -> list[Output]:
        """Keep a plan; one that continues the motion between two segments is gone on with."""
        now_ns = self._now_ns or 0
        self._plans.keep(plan, self._now_ns, replayed=now_ns < self._replay_over_ns)
        if self._backend.is_real and plan.status is Status.OK:
            # challenges come often from now on, so that how long an answer takes is known when somebody arms
            self._may_be_armed_ns = now_ns + round(self.config.maximum_plan_age_s * 1e9)
        execution = self._execution
        if execution is None or execution.ended_ns is None or plan.continues != execution.plan_id:
            return []
        planned = self._plans.unusable(plan.plan_id) or self._next_segment(execution, plan, now_ns)
        if isinstance(planned, Refusal):
            return self.stop(planned, now_ns)
        if execution.pull is not None:
            execution.pull.follow(plan, planned, self._stands.setup)
        execution.follow(plan, planned)
        return []

    def _next_segment(self, execution: Execution, plan: GraspPlan, now_ns: int) -> Trajectory | Refusal:
        """The motion of the next segment, planned from a frame that was taken after the last one had ended."""
        arm, ended_ns, pull = self._stands.measured.state, execution.ended_ns or now_ns, execution.pull
        if pull is None and execution.segment >= execution.segments:
            most = f"it was armed for {execution.segments} segments at most"
            return Refusal(Code.SEGMENT, f"{most}, and more are needed: let it go faster, or arm again")
        if taken_ns(plan.stamp, self.config.arm) < ended_ns:
            return Refusal(Code.SEGMENT, "the next segment was planned from a frame of before the last one ended")
        if arm is None:
            return UNMEASURED
        if pull is not None:
            return self._next_pull(execution, pull, plan, arm, now_ns)
        if plan.pull is not None or any(waypoint.phase in AFTER for waypoint in plan.waypoints):
            pulls = f"plan {plan.plan_id} pulls thread or lets go, and the motion that it continues pulls none"
            return Refusal(Code.PULL_ORDER, pulls)
        begun = dataclasses.replace(plan, waypoints=left_of(plan.waypoints, execution.approached))
        planned = self._planned(begun, arm, now_ns, execution.segments - execution.segment)
        if isinstance(planned, Refusal):
            return planned
        forward = self._backend.kinematics.forward
        was, now = (forward(joints)[:3, 3] for joints in (execution.contact, contact_joints(planned)))
        if (drift_m := float(np.linalg.norm(was - now))) > self.config.segment_drift_m:
            moved = f"the place of contact is {1e3 * drift_m:.1f} mm from where it was armed"
            return Refusal(
                Code.SEGMENT, f"{moved}, and {1e3 * self.config.segment_drift_m:g} mm are allowed: arm again"
            )
        return planned

    def _next_pull(
        self, execution: Execution, pull: Pulling, plan: GraspPlan, arm: ArmState, now_ns: int
    ) -> Trajectory | Refusal:
        """The motion of the next segment of a pull, within the bounds that the pull was armed for."""
        if pull.holds:
            # the jaws press on as they were told, and do not slacken to where they are measured
            arm = dataclasses.replace(arm, jaw_rad=execution.jaw_sent_rad)
        planned = self._planned(plan, arm, now_ns, 1, pull.holds)
        if isinstance(planned, Refusal):
            return planned
        return pull.refusal(plan, planned, self._stands.setup, self.config.segment_drift_m) or planned

    def _answer_stop(self, command: Command) -> Replies:
        """Hold, and where the console is to pause or disable the arm, tell it so; whatever else is the matter."""
        message = command.message
        if refusal := other_arm(self.config.arm, message.arm, command.instance):
            return [refused(message.header.id, refusal)]
        said, executing = message.word.name.lower() if isinstance(message, ChangeState) else "hold", self.executes
        why = Refusal(Code.HOLD_COMMAND, f"{message.header.sender} said {said}")
        # whoever is about to arm is told as well, so an arm that carries out nothing tells of its hold, too
        self._held_at_ns = command.now_ns
        held = self.stop(why, command.now_ns)
        told = UNSENT if self._backend.dry_run else "" if self._told_to_hold else UNTOLD
        held = held or [self._told_held(why, told, command.now_ns)]
        if not isinstance(message, ChangeState):
            # what a console does by itself, such as homing, it goes on with: what stops that is a state
            self._pauses = not executing and (bool(self._states.awaited) or self._is_busy)
            self._pause(command.now_ns)
            return [accepted(message.header.id, told), *held]
        return [self._states.answer(message, command.now_ns, self.config.ratio), *held]

    def _answer_arm(self, command: Command, message: Arm) -> list[Output | CommandAnswer]:
        armed, of = self._arm(command, message), (message.plan_id, message.header.id)
        if isinstance(armed, Execution) and (
            self._asked_before_a_hold(message) or not self._backend.rearm(message.challenge_ns)
        ):
            armed = HELD_MEANWHILE
        if isinstance(armed, Refusal):
            event = event_of(self.config.arm, *of, ExecutionKind.REFUSED, command.now_ns, armed)
            return [refused(message.header.id, armed), event]
        self._execution, self._holding, self._unconfirmed = armed, False, False
        event = event_of(self.config.arm, *of, ExecutionKind.ACCEPTED, command.now_ns)
        return [accepted(message.header.id), event]

    def _change_state(self, command: Command, message: ChangeState) -> CommandAnswer:
        """A person has the console enable, home, resume: while nothing is armed, of an arm whose time is this one."""
        of = message.header.id
        if refusal := other_arm(self.config.arm, message.arm, command.instance):
            return refused(of, refusal)
        if command.now_ns < self._replay_over_ns:
            return refused(of, REPLAYED)
        if self._execution:
            return refused(of, self._busy())
        self._now_ns = command.now_ns
        arm = self._stands.measure(command.now_ns)
        if self._backend.is_real and (why := self._nobody(message, arm, command.now_ns)):
            return refused(of, why)
        if self._asked_before_a_hold(message):
            return refused(of, HELD_MEANWHILE)
        self._pauses = False
        return self._states.answer(message, command.now_ns, self.config.ratio)

    def _asked_before_a_hold(self, message: Arm | ChangeState) -> bool:
        """Whether whoever asks had heard nothing of the arm since the last hold: commands that stop overtake others."""
        return 0 < message.challenge_ns <= self._held_at_ns

    def _told_held(self, why: Refusal, told: str, now_ns: int) -> Output:
        why = Refusal(why.code, "; ".join(filter(None, (why.sentence, told))))
        return event_of(self.config.arm, "", "", ExecutionKind.HELD, now_ns, why)

    def _arm(self, command: Command, message: Arm) -> Execution | Refusal:
        if refusal := other_arm(self.config.arm, message.arm, command.instance) or self._plans.unusable(
            message.plan_id
        ):
            return refusal
        if command.now_ns < self._replay_over_ns:
            return REPLAYED
        plan = self._busy() if self._execution or self._states.awaited else self._plans.find(message.plan_id)
        if isinstance(plan, Refusal):
            return plan
        if self._now_ns is not None:
            # between turns of an arm at rest much may have happened
            self._now_ns = command.now_ns
            self._stands.measure(command.now_ns)
        arm, why = self._stands.measured.state, self._stands.refusal(command.now_ns)
        if why or arm is None or self._now_ns is None:
            return why or UNMEASURED
        message = dataclasses.replace(message, segments=min(max(1, message.segments), MOST_SEGMENTS))
        pull = pulling_of(plan, message, self.config.pull)
        if isinstance(pull, Refusal):
            return pull
        if self._left_holding and not lets_go_only(plan):
            return LEFT_HOLDING
        segments, holds = (message.segments, False) if pull is None else (1, lets_go_only(plan))
        planned = self._planned(plan, arm, command.now_ns, segments, holds)
        if isinstance(planned, Refusal):
            return planned
        if pull is not None:
            if why := pull.refusal(plan, planned, self._stands.setup, self.config.segment_drift_m):
                return why
            pull.follow(plan, planned, self._stands.setup)
        if self._backend.dry_run:
            would = f"the motion of {planned.duration_s:.1f} s passes every check, and nothing was sent"
            return Refusal(Code.DRY_RUN, f"{would}: this is a dry run (dry_run of the arm's configuration)")
        if why := self._nobody(message, arm, command.now_ns):
            return why
        patience = Patience(self.config.first_heartbeat_s, self.config.dead_man_s, self.config.maximum_motion_s)
        of_arm = self._backend.kinematics, self._stands.setup.jaw
        return Execution(message, plan, planned, self._now_ns, patience, *of_arm, pull)

    def _planned(
        self, plan: GraspPlan, arm: ArmState, now_ns: int, segments: int, holds: bool = False
    ) -> Trajectory | Refusal:
        """The motion of a plan from where the arm is, or what speaks against plan, moment or motion."""
        if why := self._sight.refusal(now_ns, self.config.maximum_frame_age_s):
            return why
        setup = self._stands.with_tissue(now_ns, self.config.maximum_plan_age_s)
        timely = now_ns, arm.still_since_ns, self._plans.last, self.config.maximum_plan_age_s
        of = self.config.arm, self._backend.is_real, now_ns, self.config.maximum_plan_age_s, "the frame of its plan"
        if refusal := untimely(plan, *timely) or too_old(plan.stamp, *of):
            return refusal
        if refusal := wrong_frame(plan, self._stands.frames(setup)):
            return refusal
        if self._backend.is_real and (refusal := self._stands.unknown(plan, setup, now_ns)):
            return refusal
        return plan_motion(plan.waypoints, arm.joints, arm.jaw_rad, setup, segments, holds)

    def _nobody(self, message: Arm | ChangeState, arm: ArmState | None, now_ns: int) -> Refusal | None:
        """Why whoever asks does not stand by as this arm needs it; None where they do, as far as that can be told."""
        if self._backend.is_real and not message.pressed and not (arm and arm.pedal):
            alone, pedal = "a process by itself has no real arm move", "the console's operator-present pedal anew"
            remedy = (
                f"press the page's button, or {pedal}" if isinstance(message, Arm) else f"press {pedal}, or do it there"
            )
            return Refusal(Code.NO_PRESENCE, f"{alone}: {remedy}")
        if message.challenge_ns == 0 and not self._backend.is_real:
            return None
        behind_ns = self._challenges.behind_ns(message.challenge_ns, now_ns)
        if behind_ns is None:
            unheard = "whoever asks has heard no challenge of this bridge, or one of long ago"
            return Refusal(Code.ROUND_TRIP, f"{unheard}: see to the network between them, then ask again")
        if behind_ns <= self.config.dead_man_s * 1e9:
            return None
        took = f"from the bridge to whoever asks and back it takes {1e-6 * behind_ns:.0f} ms"
        allowed = f"{1e3 * self.config.dead_man_s:.0f} ms are allowed"
        return Refusal(Code.ROUND_TRIP, f"{took}, and {allowed}: see to the network between them")

    def _busy(self) -> Refusal:
        does = f"its console was told to {self._states.awaited}, and has not said that it has"
        carries_out = f"the arm carries out plan {self._execution.plan_id}" if self._execution else does
        return Refusal(Code.BUSY, f"{carries_out}: let it end, or say hold, before arming")

    def _told(self, arm: ArmState, now_ns: int) -> RobotState:
        execution = self._execution
        moving = execution is not None and execution.moving
        mode = mode_of(arm, self._stands, moving, self._holding)
        told = robot_state(self.config.arm, arm, self._stands, mode, execution.plan_id if execution else "")
        return dataclasses.replace(
            told,
            challenge_ns=self._challenges.issue(now_ns),
            guard_challenge=arm.guard_challenge,
            maximum_frame_age_s=self.config.maximum_frame_age_s,
            is_real=self._backend.is_real and not self._backend.dry_run,
        )
