"""One trial of an experiment on a running rig: goal, plan, arming, motion, verdict."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

from agents.cli.experiment.terminal import Attendant, LeftError, Person
from agents.cli.live.attempts import awaited
from agents.cli.live.command import POLICIES, plan_sentence
from agents.experiment.journal import Attempt, Cause, Trial
from agents.operator.operator import Events, Stood, arm_and_stand_by, ask_for_grasp, events_of
from agents.robot_bridge.plans import AGAINST_PLAN
from schemas.messages import (
    CommandAnswer,
    ExecutionKind,
    GraspJudgement,
    GraspPlan,
    Outcome,
    Status,
    ThreadReconstruction,
    Verdict,
)
from schemas.topics import JUDGEMENT, MAIN, THREAD
from shared.clock import monotonic_s, now_ns
from shared.execution_words import event_told
from shared.runtime.connection import Connection
from shared.terminal import say

PATIENCE_S, VERDICT_S, LOOK_S = 60.0, 5.0, 0.2
MOST_REPEATS = 20
"""A trial that so often came to nothing in a row will not come to something by another try."""
SETTLED_THREADS = 4
"""Seen after a thread was laid; tracking may need a few to leave the one before."""
SENDER = "suturegrasp experiment"
CAUSE_OF: dict[Verdict, Cause] = {Verdict.MISSED: "missed", Verdict.LOST: "slipped", Verdict.FORCE_EXCEEDED: "tissue"}


class ExperimentError(RuntimeError):
    """Why the experiment cannot go on; the text names the remedy."""


@dataclass(frozen=True)
class Rig:
    """What trials are carried out on.

    Fields:
        simulated: the simulator lays the thread and gives the verdicts.
        check: raises an ExperimentError where something that is needed has ended.
    """

    connection: Connection
    arm: str
    attendant: Attendant
    simulated: bool
    stopped: threading.Event
    check: Callable[[], None]


def carried_out(trial: Trial, left: int, rig: Rig) -> Attempt:
    """What came of a trial.

    Raises:
        LeftError: where nobody wants to go on; the trial has come to nothing then.
        ExperimentError: where the rig does not do its part.
    """
    nothing = 0
    while True:
        rig.check()
        rig.attendant.lay(trial, left)
        if rig.simulated:
            _lay(rig)
        plan = _plan(trial, rig)
        if isinstance(plan, str):
            return Attempt(trial=trial, outcome="declined", note=plan, at_ns=now_ns())
        say(plan_sentence(plan))
        if not rig.attendant.arms(plan):
            continue
        attempt = _moved(trial, plan, rig)
        if isinstance(attempt, Attempt):
            return attempt
        nothing += 1
        if nothing == MOST_REPEATS:
            raise ExperimentError(f"{nothing} times in a row {plan.arm} did not carry a plan out: {attempt}")


def _moved(trial: Trial, plan: GraspPlan, rig: Rig) -> Attempt | str:
    """What came of a plan; why it came to nothing where it is to be tried again."""
    made = Attempt(
        trial=trial,
        outcome="held",
        plan_id=plan.plan_id,
        probability=plan.probability,
        slide_m=plan.slide_m,
        at_ns=now_ns(),
    )
    with events_of(rig.connection, JUDGEMENT) as verdicts:
        return _carried_out(made, plan, verdicts, rig)


def _carried_out(made: Attempt, plan: GraspPlan, verdicts: Events, rig: Rig) -> Attempt | str:
    began_s = monotonic_s()
    stood = arm_and_stand_by(rig.connection, rig.arm, plan.plan_id, rig.stopped, lambda e: say(event_told(e)))
    took_s = monotonic_s() - began_s
    if rig.stopped.is_set():
        raise LeftError("interrupted; the arm holds")
    if stood.answer.outcome is not Outcome.ACCEPTED:
        if declines(stood.answer):
            return made.model_copy(update={"outcome": "declined", "note": stood.answer.reason})
        rig.attendant.stuck(stood.answer.reason)
        return stood.answer.reason
    if stood.end is None:
        rig.attendant.stuck(stood.left)
        return stood.left
    if stood.end.kind is not ExecutionKind.FINISHED:
        return _stopped(made, stood, rig)
    held, cause, note = _verdict(plan, verdicts, rig)
    outcome = "held" if held else "failed"
    return made.model_copy(
        update={"outcome": outcome, "cause": cause or "", "note": note, "execution_s": round(took_s, 3)}
    )


def declines(answer: CommandAnswer) -> bool:
    """Whether a refusal to arm speaks against the plan, and not against the moment."""
    return answer.outcome is Outcome.REFUSED and answer.code in AGAINST_PLAN


def _stopped(made: Attempt, stood: Stood, rig: Rig) -> Attempt | str:
    assert stood.end is not None  # noqa: S101 - asked for only where there is one
    blamed = rig.attendant.held(stood.end)
    if blamed is None:
        return f"it held ({stood.end.code})"
    cause, note = blamed
    return made.model_copy(update={"outcome": "failed", "cause": cause, "note": note})


def _verdict(plan: GraspPlan, verdicts: Events, rig: Rig) -> tuple[bool, Cause | None, str]:
    if not rig.simulated:
        assert isinstance(rig.attendant, Person)  # noqa: S101 - only a person gives a verdict of a real grasp
        return rig.attendant.verdict()
    judged = awaited(verdicts, GraspJudgement, VERDICT_S, lambda judged: judged.plan_id == plan.plan_id)
    if judged is None:
        raise ExperimentError("the simulator gave no verdict; look at its log")
    return judged.verdict is Verdict.HELD, CAUSE_OF.get(judged.verdict), judged.sentence


def _lay(rig: Rig) -> None:
    """Have the simulator lay the thread as it was drawn."""
    deadline_s = monotonic_s() + PATIENCE_S
    while f"simulator/{MAIN}" not in rig.connection.present():
        rig.check()
        if rig.stopped.wait(LOOK_S):
            raise LeftError("interrupted")
        if monotonic_s() > deadline_s:
            raise ExperimentError("no simulator is there, which is to give the verdicts: run it, or give them yourself")
    answer = rig.connection.set_parameter("simulator", MAIN, "laid", now_ns() % 1_000_000, SENDER)
    if answer.outcome is not Outcome.ACCEPTED:
        raise ExperimentError(f"the simulator does not lay the thread again: {answer.reason}")


def _plan(trial: Trial, rig: Rig) -> GraspPlan | str:
    """A plan from a thread that was seen from now on, or why the planner would rather have none."""
    deadline_s, from_ns, why = monotonic_s() + PATIENCE_S, now_ns(), ""
    for _ in range(SETTLED_THREADS - 1):
        _wait_for_thread(rig, from_ns, deadline_s)
    while monotonic_s() < deadline_s:
        # a goal right after a thread has come is not refused for its age
        why = _wait_for_thread(rig, from_ns, deadline_s) or why
        answer, plan = ask_for_grasp(rig.connection, rig.arm, POLICIES[trial.policy], s=trial.s)
        if plan is not None:
            return plan if plan.status is Status.OK else plan.reason
        why = answer.reason or "the goal was accepted and no plan followed; look at the planner's log"
    raise ExperimentError(f"no plan was made within {PATIENCE_S:.0f} s: {why}")


def _wait_for_thread(rig: Rig, from_ns: int, deadline_s: float) -> str:
    """Wait for a thread seen later than that; why there was none, or nothing."""
    why = "no frame was reconstructed"
    with events_of(rig.connection, THREAD) as threads:
        while monotonic_s() < deadline_s:
            rig.check()
            if rig.stopped.is_set():
                raise LeftError("interrupted")
            thread = threads.next(LOOK_S)
            if not isinstance(thread, ThreadReconstruction):
                continue
            if min(thread.stamp.capture_left_ns, thread.stamp.capture_right_ns) < from_ns:
                continue
            if thread.status is Status.OK:
                return ""
            why = thread.reason
    return why
