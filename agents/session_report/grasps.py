"""Grasps as a recording tells them: goal, plan, arming, phases, judgement; and what was refused on the way."""

from dataclasses import dataclass, field
from typing import Any

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import (
    Arm,
    CommandAnswer,
    CommandRecord,
    ExecutionEvent,
    GraspGoal,
    GraspJudgement,
    GraspPlan,
    Hold,
    Outcome,
    Prompt,
)
from schemas.topics import ARM, COMMANDS, EXECUTION, GOAL, HOLD, JUDGEMENT, PLAN, PROMPT, Topic

COMMAND_TYPES = {str(topic): topic.message for topic in (GOAL, ARM, HOLD, PROMPT)}
UNKNOWN = CommandAnswer("", Outcome.UNKNOWN, "not_recorded", "the recording does not hold the command")


@dataclass
class Arming:
    """The consent to carry out a plan, and what came of it.

    Fields:
        at_ns: when the bridge got the command; None where the recording lacks it.
        judged_ns: when the judgement was published.
    """

    arming_id: str
    at_ns: int | None
    answer: CommandAnswer
    plan_id: str = ""
    events: list[ExecutionEvent] = field(default_factory=list[ExecutionEvent])
    judgement: GraspJudgement | None = None


@dataclass
class Grasp:
    """One goal and all that followed.

    Fields:
        goal: None where the recording lacks it, as for a plan that was made before it began.
        at_ns: when the planner got the goal, or when the first thing that is known of it was published.
        plans: by their ids, with when each was published, and whether that was before the recording began, which
            repeats it.
    """

    at_ns: int
    goal: GraspGoal | None
    answer: CommandAnswer
    plans: dict[str, tuple[GraspPlan, int, bool]] = field(default_factory=dict[str, tuple[GraspPlan, int, bool]])
    armings: list[Arming] = field(default_factory=list[Arming])

    @property
    def plan(self) -> GraspPlan | None:
        """The one that was carried out; where none was, the newest. Further attempts may never be armed."""
        return self._planned[0]

    @property
    def plan_ns(self) -> int | None:
        """When that was published."""
        return self._planned[1]

    @property
    def plan_before(self) -> bool:
        """Whether that was before the recording began."""
        return self._planned[2]

    @property
    def _planned(self) -> tuple[GraspPlan | None, int | None, bool]:
        armed = self.plans.get(self.deciding.plan_id) if self.armings else None
        return armed or next(reversed(self.plans.values()), (None, None, False))

    @property
    def ended(self) -> str:
        """How it ended in one sentence."""
        if self.answer.outcome is Outcome.REFUSED:
            return f"goal refused ({self.answer.code}): {self.answer.reason}"
        no_plan = f"no plan: {self.plan.reason}" if self.plan is not None and self.plan.reason else ""
        if self.armings:
            # of a planner that ran anew the plan may be none, though one was carried out
            return "; ".join(filter(None, (no_plan, arming_ended(self.deciding))))
        return no_plan or ("planned, never armed" if self.plan else "no plan followed")

    @property
    def outcome(self) -> str:
        """How it ended in a word or two, for counting."""
        if self.answer.outcome is Outcome.REFUSED:
            return "goal refused"
        if not self.armings:
            return "no plan" if self.plan is not None and self.plan.reason else "not armed"
        last = self.deciding
        if last.judgement is not None:
            return last.judgement.verdict.name.lower()
        if last.answer.outcome is Outcome.REFUSED:
            return "arming refused"
        return f"execution {last.events[-1].kind.name.lower()}" if last.events else "never moved"

    @property
    def deciding(self) -> Arming:
        """The last arming that was not refused; where all were, the last."""
        taken = [one for one in self.armings if one.answer.outcome is not Outcome.REFUSED]
        return (taken or self.armings)[-1]


def arming_ended(arming: Arming) -> str:
    """How what was armed ended in one sentence."""
    if arming.judgement is not None:
        return arming.judgement.sentence
    if arming.answer.outcome is Outcome.REFUSED:
        return f"arming refused ({arming.answer.code}): {arming.answer.reason}"
    if not arming.events:
        return "armed, and nothing more"
    last = arming.events[-1]
    if last.code:
        return f"{last.kind.name.lower()} ({last.code}): {last.reason}"
    return "finished, not judged" if last.kind.name == "FINISHED" else f"unfinished after {event_name(last)}"


def event_name(event: ExecutionEvent) -> str:
    """An event in a word or two."""
    name = event.phase.name if event.phase is not None and not event.code else event.kind.name
    return name.lower() + (f" ({event.code})" if event.code else "")


@dataclass(frozen=True)
class OtherCommand:
    """A hold or a prompt, with its answer."""

    at_ns: int
    topic: str
    command: Any
    answer: CommandAnswer


class GraspCollector:
    """Puts together, message by message, what belongs to one goal to grasp."""

    topics: tuple[Topic, ...] = (COMMANDS, PLAN, EXECUTION, JUDGEMENT)

    def __init__(self) -> None:
        self.grasps: list[Grasp] = []
        self.others: list[OtherCommand] = []
        self._of_goal: dict[str, Grasp] = {}
        self._of_plan: dict[str, Grasp] = {}
        self._armings: dict[str, Arming] = {}

    def add(self, published_ns: int, message: Any, before: bool = False) -> None:
        """Take one message of these topics; `before`: one that the recording repeats from before its beginning.

        Raises:
            MessageError: where the command within a command's record cannot be read.
        """
        match message:
            case CommandRecord():
                self._command(message)
            case GraspPlan():
                self._plan(published_ns, message, before)
            case ExecutionEvent():
                arming = self._arming(message.arming_id, message.plan_id, message.at_ns)
                arming.events.append(message)
            case GraspJudgement():
                grasp = self._grasp_of_plan(message.plan_id, message.at_ns)
                if not grasp.armings:
                    grasp.armings.append(Arming("", None, UNKNOWN, message.plan_id))
                grasp.deciding.judgement = message
            case _:
                raise MessageError(f"{type(message).__name__} is no part of a grasp")

    def _command(self, record: CommandRecord) -> None:
        if record.topic not in COMMAND_TYPES:
            return
        command = decode(COMMAND_TYPES[record.topic], record.payload)
        match command:
            case GraspGoal():
                grasp = self._of_goal.get(command.header.id)
                if grasp is None:
                    grasp = self._new(record.received_ns, command, record.answer)
                    self._of_goal[command.header.id] = grasp
                grasp.at_ns, grasp.goal, grasp.answer = record.received_ns, command, record.answer
            case Arm():
                arming = self._arming(command.header.id, command.plan_id, record.received_ns)
                arming.at_ns, arming.answer = record.received_ns, record.answer
            case Hold() | Prompt():
                self.others.append(OtherCommand(record.received_ns, record.topic, command, record.answer))
            case _:
                raise MessageError(f"{record.topic} is no command")

    def _plan(self, published_ns: int, plan: GraspPlan, before: bool) -> None:
        grasp = self._of_goal.get(plan.goal_id) or self._of_plan.get(plan.plan_id)
        if grasp is None:
            grasp = self._new(published_ns, None, UNKNOWN)
        # one that is told again is the newest
        grasp.plans.pop(plan.plan_id, None)
        grasp.plans[plan.plan_id] = plan, published_ns, before
        self._of_goal[plan.goal_id] = self._of_plan[plan.plan_id] = grasp

    def _arming(self, arming_id: str, plan_id: str, at_ns: int) -> Arming:
        name = f"{arming_id} {plan_id}"
        arming = self._armings.get(name)
        if arming is None:
            arming = self._armings[name] = Arming(arming_id, None, UNKNOWN, plan_id)
            self._grasp_of_plan(plan_id, at_ns).armings.append(arming)
        return arming

    def _grasp_of_plan(self, plan_id: str, at_ns: int) -> Grasp:
        if plan_id not in self._of_plan:
            self._of_plan[plan_id] = self._new(at_ns, None, UNKNOWN)
        return self._of_plan[plan_id]

    def _new(self, at_ns: int, goal: GraspGoal | None, answer: CommandAnswer) -> Grasp:
        grasp = Grasp(at_ns, goal, answer)
        self.grasps.append(grasp)
        return grasp
