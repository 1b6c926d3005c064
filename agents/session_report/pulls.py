"""Pulls as a recording tells them: goal, segments, what the tail came to, and why it ended."""

from dataclasses import dataclass, field
from typing import Any

from agents.session_report.grasps import UNKNOWN, Arming, arming_ended
from schemas.codec import decode
from schemas.messages import (
    Arm,
    CommandAnswer,
    CommandRecord,
    ExecutionEvent,
    ExecutionKind,
    GraspJudgement,
    GraspPlan,
    Outcome,
    Phase,
    PullGoal,
    Status,
    Tail,
)
from schemas.topics import ARM, COMMANDS, EXECUTION, JUDGEMENT, PLAN, PULL_GOAL, TAIL, Topic


@dataclass
class Pulled:
    """One goal to pull thread, or to let go of it, and all that followed.

    Fields:
        goal: None where the recording lacks it.
        at_ns: when the planner got the goal, or when the first thing that is known of it was published.
        segments: the plans, by their ids, in order.
        tails: as they were measured, with when their frames were taken.
    """

    at_ns: int
    goal: PullGoal | None
    answer: CommandAnswer
    segments: dict[str, GraspPlan] = field(default_factory=dict[str, GraspPlan])
    armings: dict[str, Arming] = field(default_factory=dict[str, Arming])
    tails: list[tuple[int, Tail]] = field(default_factory=list[tuple[int, Tail]])

    @property
    def arm(self) -> str:
        """That pulls."""
        return next((plan.arm for plan in self.segments.values()), self.goal.arm if self.goal else "")

    @property
    def asked_m(self) -> float | None:
        """How long the tail was to be; None where the jaws were to let go, or nobody told."""
        told = next((plan.pull.tail_m for plan in self.segments.values() if plan.pull), None)
        return told if self.goal is None else self.goal.tail_m

    @property
    def grasps(self) -> int:
        """How often the strand was grasped."""
        events = (event for arming in self.armings.values() for event in arming.events)
        return sum(e.kind is ExecutionKind.PHASE_REACHED and e.phase is Phase.GRASP for e in events)

    @property
    def ended(self) -> str:
        """How it ended in one sentence."""
        if self.answer.outcome is Outcome.REFUSED:
            return f"goal refused ({self.answer.code}): {self.answer.reason}"
        last = next(reversed(self.segments.values()), None)
        if last is not None and last.status is not Status.OK:
            return f"no plan: {last.reason}"
        if not self.armings:
            return "planned, never armed" if last else "no plan followed"
        taken = [one for one in self.armings.values() if one.answer.outcome is not Outcome.REFUSED]
        arming = (taken or [*self.armings.values()])[-1]
        finished = bool(arming.events) and arming.events[-1].kind is ExecutionKind.FINISHED
        pull = last.pull if last is not None else None
        if finished and pull is not None and pull.stop is not None:
            return f"{pull.stop.name.lower()}: {pull.sentence}"
        return arming_ended(arming)


class PullCollector:
    """Puts together, message by message, what belongs to one goal to pull."""

    topics: tuple[Topic, ...] = (COMMANDS, PLAN, EXECUTION, JUDGEMENT, TAIL)

    def __init__(self) -> None:
        self._of_goal: dict[str, Pulled] = {}
        self._of_plan: dict[str, Pulled] = {}

    @property
    def pulls(self) -> tuple[Pulled, ...]:
        """In the order of their goals."""
        return tuple(sorted(self._of_goal.values(), key=lambda pull: pull.at_ns))

    def take(self, published_ns: int, message: Any) -> bool:
        """Take one message of these topics; whether it belongs to a pull.

        Raises:
            MessageError: where the command within a command's record cannot be read.
        """
        match message:
            case CommandRecord():
                return self._command(message)
            case GraspPlan() if message.pull is not None or message.goal_id in self._of_goal:
                pull = self._of_plan[message.plan_id] = self._pull(message.goal_id, published_ns)
                pull.segments[message.plan_id] = message
            case ExecutionEvent() if message.plan_id in self._of_plan:
                self._arming(message.plan_id, message.arming_id).events.append(message)
            case Tail():
                if message.tail is not None and message.plan_id in self._of_plan:
                    self._of_plan[message.plan_id].tails.append((message.stamp.capture_left_ns, message))
            case GraspJudgement():
                return message.plan_id in self._of_plan
            case _:
                return False
        return True

    def _command(self, record: CommandRecord) -> bool:
        if record.topic == str(PULL_GOAL):
            goal = decode(PullGoal, record.payload)
            pull = self._pull(goal.header.id, record.received_ns)
            pull.at_ns, pull.goal, pull.answer = record.received_ns, goal, record.answer
            return True
        if record.topic == str(ARM):
            armed = decode(Arm, record.payload)
            if armed.plan_id in self._of_plan:
                arming = self._arming(armed.plan_id, armed.header.id)
                arming.at_ns, arming.answer = record.received_ns, record.answer
                return True
        return False

    def _pull(self, goal_id: str, at_ns: int) -> Pulled:
        return self._of_goal.setdefault(goal_id, Pulled(at_ns, None, UNKNOWN))

    def _arming(self, plan_id: str, arming_id: str) -> Arming:
        return self._of_plan[plan_id].armings.setdefault(arming_id, Arming(arming_id, None, UNKNOWN, plan_id))
