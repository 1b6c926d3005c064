"""The commands that work on a running rig: agents as processes, the recorder, the viewer, the operator's commands."""

import math
import shlex
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from agents.cli.live.attempts import attempts_on
from agents.cli.live.options import (
    ArmPlan,
    ChangeArmState,
    Goal,
    HoldArm,
    PromptThread,
)
from agents.cli.live.pull import EXIT_REFUSED, stand_by_pull
from agents.configuration.rig import RigConfig
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE, stopping
from agents.operator.operator import (
    Stood,
    arm_and_stand_by,
    ask_for_grasp,
    bridged_arms,
    change_state,
    events_of,
    hold,
    prompt,
)
from schemas.messages import (
    Checked,
    CommandAnswer,
    ExecutionEvent,
    ExecutionKind,
    GraspPlan,
    Outcome,
    Policy,
    StateWord,
    Status,
)
from schemas.topics import EXECUTION
from shared.clock import monotonic_s
from shared.execution_words import event_told
from shared.runtime.connection import connected
from shared.terminal import complain, say

LOOK_S, STATE_WITHIN_S = 0.2, 65.0
MOST_ARMS = 32
POLICIES = {"robust": Policy.CAPTURE_SLIDE_GRASP, "direct": Policy.DIRECT}


def goal(rig: RigConfig, options: Goal) -> int:
    """Ask for a grasp and print the plan, or why there is none."""
    named = (options.s, options.pixel, options.point, options.from_swage_mm)
    if sum(value is not None for value in named) != 1:
        return complain("give one of --s, --pixel, --point and --from-swage-mm", EXIT_UNUSABLE)
    if options.s is not None and not 0 <= options.s <= 1:
        return complain(f"--s {options.s:g} is not on the thread; s runs from 0 to 1", EXIT_UNUSABLE)
    if options.from_swage_mm is not None and not 0 <= options.from_swage_mm < math.inf:
        return complain(f"--from-swage-mm {options.from_swage_mm:g} is no length of thread", EXIT_UNUSABLE)
    with connected(rig.session) as connection:
        answer, plan = ask_for_grasp(
            connection,
            options.arm,
            POLICIES[options.policy],
            s=options.s,
            pixel=None if options.pixel is None else np.array(options.pixel),
            point_camera=None if options.point is None else np.array(options.point),
            attempts=options.attempts,
            from_swage_m=None if options.from_swage_mm is None else 1e-3 * options.from_swage_mm,
        )
    if answer.outcome is not Outcome.ACCEPTED:
        return complain(answer.reason, EXIT_REFUSED)
    if plan is None:
        return complain("the goal was accepted and no plan followed; look at the planner's log", EXIT_REFUSED)
    if plan.status is not Status.OK:
        return complain(plan.reason, EXIT_REFUSED)
    say(plan_sentence(plan))
    config = f" --config {shlex.quote(str(options.config))}" if options.config is not None else ""
    say(f"to carry it out: suturegrasp arm {plan.plan_id} --arm {plan.arm}{config}")
    return EXIT_OK


def plan_sentence(plan: GraspPlan) -> str:
    """A plan in one line."""
    how = f"capture at {percent(plan.s_capture)}, slide {plan.slide_m * 1e3:.0f} mm, grasp at {percent(plan.s_goal)}"
    if plan.slide_m == 0:
        how = f"grasp at {percent(plan.s_goal)} without a slide"
    tissue = "" if plan.tissue is None else f"; {plan.tissue.sentence}"
    thread = f"; {plan.thread.obstructed}" if plan.thread is not None and plan.thread.obstructed else ""
    which = f" (attempt {plan.attempt} of {plan.attempts})" if plan.attempt > 1 else ""
    return f"plan {plan.plan_id}{which}: {how}; success {plan.probability:.0%}{tissue}{thread}"


def percent(s: float | None) -> str:
    """A place along the thread as people say it."""
    return "?" if s is None else f"{s:.0%}"


def arm(rig: RigConfig, options: ArmPlan) -> int:
    """Arm a plan and stay with it until it ends; Ctrl-C ends the heartbeat, and the arm holds.

    What the planner sees afterwards is told; unless that is held, its next plan is armed too, where so many attempts
    were asked for and the arm moves nothing real.
    """
    if not options.plan or options.attempts < 1:
        return complain("give the id of a plan, as goal prints it, and at least one attempt", EXIT_UNUSABLE)
    stopped, plan_id = stopping(), options.plan
    bounds = options.pull_mm, options.pull_seconds, options.pull_within_mm
    if any(bound is not None for bound in bounds):
        return stand_by_pull(rig, options, stopped)
    with connected(rig.session) as connection, attempts_on(connection) as attempts:
        for left in reversed(range(options.attempts)):
            stood = arm_and_stand_by(connection, options.arm, plan_id, stopped, lambda e: say(event_told(e)))
            outcome = _outcome(stood)
            if outcome != EXIT_OK:
                return outcome
            check = attempts.check_of(plan_id)
            if check is not None:
                say(f"{options.arm}: {check.sentence}")
            again = attempts.plan_after(check) if left and not stopped.is_set() else None
            if again is None:
                return EXIT_REFUSED if check is not None and check.verdict is Checked.MISSED else EXIT_OK
            say(plan_sentence(again))
            if stood.is_real:
                by_hand = f"suturegrasp arm {again.plan_id} --arm {options.arm}"
                return complain(f"{options.arm} is real, so that a person arms each attempt: {by_hand}", EXIT_REFUSED)
            plan_id = again.plan_id
    return EXIT_OK


def _outcome(stood: Stood) -> int:
    if stood.answer.outcome is not Outcome.ACCEPTED:
        return complain(stood.answer.reason, EXIT_REFUSED)
    if stood.end is None:
        return complain(stood.left, EXIT_REFUSED)
    return EXIT_OK if stood.end.kind is ExecutionKind.FINISHED else EXIT_REFUSED


def hold_arms(rig: RigConfig, options: HoldArm) -> int:
    """Have an arm hold, or all: none waits for the answer of another, and the exit status is the worst."""
    named = list(rig.robot) if options.arm is None else [options.arm]
    with connected(rig.session) as connection, ThreadPoolExecutor(MOST_ARMS, "holding") as threads:
        answers = {arm: threads.submit(hold, connection, arm) for arm in named}
        if options.arm is None:
            # one that this file does not name moves all the same
            beside = [arm for arm in bridged_arms(connection) if arm not in answers]
            answers |= {arm: threads.submit(hold, connection, arm) for arm in beside}
        statuses = [_held(arm, answer.result()) for arm, answer in answers.items()]
    nobody = "no arm is named by the rig's file, and none is there: name one with --arm"
    return max(statuses) if statuses else complain(nobody, EXIT_REFUSED)


def _held(arm: str, answer: CommandAnswer) -> int:
    """Say what became of a hold: one that is accepted for a reason did not reach the arm yet."""
    if answer.outcome is not Outcome.ACCEPTED:
        return complain(f"{arm}: {answer.reason}", EXIT_REFUSED)
    if answer.reason:
        return complain(f"{arm} was told to hold, but {answer.reason}", EXIT_REFUSED)
    say(f"{arm}: holds")
    return EXIT_OK


def change_arm_state(rig: RigConfig, options: ChangeArmState) -> int:
    """Have an arm's console change its state."""
    with connected(rig.session) as connection, events_of(connection, EXECUTION) as events:
        answer = change_state(connection, options.arm, StateWord[options.word.upper()])
        if answer.outcome is not Outcome.ACCEPTED:
            return complain(answer.reason, EXIT_REFUSED)
        say(f"{options.arm}: {options.word} was sent to its console")
        until_s = monotonic_s() + STATE_WITHIN_S
        while monotonic_s() < until_s:
            event = events.next(LOOK_S)
            if not isinstance(event, ExecutionEvent) or event.arming_id != answer.id:
                continue
            if event.kind is ExecutionKind.FINISHED:
                say(f"{options.arm}: {options.word} has come about, by its console")
                return EXIT_OK
            return complain(event.reason, EXIT_REFUSED)
    return complain(f"{options.arm} has not told what became of {options.word}; look at its bridge", EXIT_REFUSED)


def prompt_thread(rig: RigConfig, options: PromptThread) -> int:
    """Say which thread is meant."""
    pixel = options.pixel
    if pixel is not None and not all(map(math.isfinite, pixel)):
        return complain(f"--pixel {pixel[0]:g} {pixel[1]:g} is none; give two finite numbers", EXIT_UNUSABLE)
    with connected(rig.session) as connection:
        answer = prompt(connection, None if pixel is None else np.array(pixel))
    if answer.outcome is not Outcome.ACCEPTED:
        return complain(answer.reason, EXIT_REFUSED)
    say("perception chooses the thread" if pixel is None else "this thread is meant from the next frame on")
    return EXIT_OK
