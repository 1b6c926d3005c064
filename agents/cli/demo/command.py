"""`suturegrasp demo`: a simulated grasp from image to judgement, with every agent a process of its own."""

import contextlib
import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agents.cli.demo.report import report
from agents.cli.live.attempts import Attempts, attempts_on, awaited
from agents.cli.live.command import percent, plan_sentence
from agents.cli.live.options import Demo
from agents.cli.live.up import FIRST_CONTACT_S, start_all, write_config
from agents.configuration.rig import PlannerSection, RigConfig, RouterSection, SimulatorSection, simulated_rig
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE, on_stop
from agents.launch.session_folder import SessionFolder, new_session_folder
from agents.launch.supervisor import Role, Supervisor, last_line, supervised
from agents.operator.operator import Events, Stood, arm_and_stand_by, ask_for_grasp, events_of
from schemas.messages import (
    ExecutionKind,
    GraspJudgement,
    GraspPlan,
    Outcome,
    Policy,
    Status,
    ThreadReconstruction,
)
from schemas.topics import JUDGEMENT, THREAD
from shared.clock import monotonic_s
from shared.execution_words import event_told
from shared.runtime.connection import Connection, NoRouterError, connected
from shared.runtime.session import free_local_endpoint
from shared.terminal import complain, say, show

PLACES = 100
FROM_END = 0.1
"""The ends of the thread are left out: little thread is left there to slide along."""
APART = 0.1


def goals_of(threads: Sequence[ThreadReconstruction], count: int, enough: float) -> list[tuple[float, float]]:
    """Up to so many places with the mean confidence there over some frames, those to be asked for first in front.

    First come places that every frame holds for at least `enough` likely, the least confident first, then all others,
    the most confident first. No two of them are near each other. There is none where no thread states its confidence.
    """
    s = np.linspace(FROM_END, 1.0 - FROM_END, PLACES)
    stated = [np.interp(s, thread.confidence_s, thread.confidence) for thread in threads if len(thread.confidence_s)]
    if not stated:
        return []
    confidence, least = np.mean(stated, axis=0), np.min(stated, axis=0)
    turn = np.where(least >= enough, confidence, 2.0 - confidence)
    free, found = np.ones(PLACES, bool), list[tuple[float, float]]()
    while len(found) < count and free.any():
        next_one = np.flatnonzero(free)[np.argmin(turn[free])]
        found.append((float(s[next_one]), float(confidence[next_one])))
        free &= np.abs(s - s[next_one]) >= APART
    return found


EXIT_NO_GRASP, EXIT_INTERRUPTED = 1, 130
SCENE, DISTANCE_MM = "hard", 85.0
"""A thread with stretches along the rows of the images, of which stereo knows little."""
LONGEST_S = 50.0
"""When the demo gives up, whatever it waits for."""
FIRST_THREAD_S = 30.0
STEADY_THREADS = 5
"""Threads that must have come before a goal is named: the first frames may find agents still starting."""
LEAST_PROBABILITY = 0.6
GOALS, GOAL_ROUNDS, PLANS_S = 6, 4, 15.0
ARMINGS = 5
"""At most, heartbeats that came late and further attempts included."""
HEARTBEAT_LOST = "heartbeat_lost"
WORTH_SHOWING_M = 0.003
"""A plan with a shorter slide is kept for the case that no place needs a longer one."""
VERDICT_S = 5.0
LOOK_S, AT_ONCE_S = 0.2, 1e-3
ARM = "psm1"


class DemoError(RuntimeError):
    """What broke, so that the demo came to no grasp."""


class NothingToGraspError(RuntimeError):
    """The planner was asked, and would rather not: an honest answer, and no failure."""


@dataclass
class Story:
    """What the demo has to do with, and what has come of it.

    Fields:
        stopped: set by Ctrl-C, or when the demo has taken too long.
    """

    connection: Connection
    supervisor: Supervisor
    stopped: threading.Event
    threads: Events
    verdicts: Events

    def check(self) -> None:
        """Raise DemoError where a process that the grasp needs has ended, or the demo is to stop."""
        for change in self.supervisor.watch():
            if change.child.role is not Role.VIEWER:
                raise DemoError(change.sentence)
            say(f"there is no viewer, and the demo goes on without it: {change.sentence}")
        if self.stopped.is_set():
            raise DemoError(f"it was stopped, or took longer than {LONGEST_S:.0f} s")


def demo(options: Demo) -> int:
    """Run it; exit status 0 where a grasp was judged, whatever the verdict, or where the planner rather had none."""
    interrupted, stopped = threading.Event(), threading.Event()

    def interrupt() -> None:
        interrupted.set()
        stopped.set()

    on_stop(interrupt)
    rig = demo_rig(options)
    try:
        folder = new_session_folder(options.sessions)
    except OSError as error:
        return complain(f"no session can be kept in {options.sessions}: {error.strerror}", EXIT_UNUSABLE)
    came_of_it, failure = _run(rig, folder, options.view, options.attempts, stopped)
    if interrupted.is_set():
        return complain("interrupted; every process was stopped", EXIT_INTERRUPTED)
    for line in report(folder, came_of_it, last_line(folder.log("recorder")), options.seed):
        show(line)
    return complain(failure, EXIT_NO_GRASP) if failure else EXIT_OK


def demo_rig(options: Demo) -> RigConfig:
    """The simulated rig, on a port of its own, so that it never meets another one."""
    sections = {
        "router": RouterSection(endpoint=free_local_endpoint()),
        "planner": PlannerSection(least_probability=LEAST_PROBABILITY),
        "simulator": SimulatorSection(seed=options.seed, config=SCENE, distance_mm=DISTANCE_MM),
    }
    return simulated_rig().model_copy(update=sections)


def _run(rig: RigConfig, folder: SessionFolder, view: str, attempts: int, stopped: threading.Event) -> tuple[str, str]:
    """What came of the grasp, and what broke, if anything did; every process has ended by then."""
    config = folder.path / "rig.json"
    write_config(config, rig)
    with contextlib.ExitStack() as stack:
        supervisor = stack.enter_context(supervised(restart=False))
        start_all(supervisor, rig, config, folder, view)
        say(f"started {len(supervisor.children)} processes")
        limit = threading.Timer(LONGEST_S, stopped.set)
        limit.start()
        stack.callback(limit.cancel)
        try:
            connection = stack.enter_context(connected(rig.session, FIRST_CONTACT_S, stopped))
            threads, verdicts = (stack.enter_context(events_of(connection, topic)) for topic in (THREAD, JUDGEMENT))
            return _grasp(Story(connection, supervisor, stopped, threads, verdicts), attempts).sentence, ""
        except NothingToGraspError as error:
            return str(error), ""
        except (DemoError, NoRouterError) as error:
            return "no grasp was judged", str(error)


def _grasp(story: Story, attempts: int) -> GraspJudgement:
    threads = _threads(story, STEADY_THREADS)
    mean = sum(float(thread.confidence.mean()) for thread in threads) / len(threads)
    say(f"the thread is seen, with a mean confidence of {mean:.2f}")
    goals = goals_of(threads, GOALS, LEAST_PROBABILITY)
    with attempts_on(story.connection) as grasps:
        return _carried_out(story, goals, grasps, attempts)


def _carried_out(story: Story, goals: list[tuple[float, float]], grasps: Attempts, attempts: int) -> GraspJudgement:
    plan = _plan(story, goals)
    for left in reversed(range(ARMINGS)):
        stood = arm_and_stand_by(
            story.connection, ARM, plan.plan_id, story.stopped, lambda event: say(event_told(event))
        )
        story.check()
        # on a busy machine a heartbeat may come late, and the arm holds, as it should
        if left and stood.end is not None and stood.end.code == HEARTBEAT_LOST:
            plan = _plan(story, goals)
            continue
        verdict = _verdict(story, plan.plan_id, stood)
        check = grasps.check_of(plan.plan_id)
        if check is not None:
            say(f"the planner's own check: {check.sentence}")
        attempts -= 1
        again = grasps.plan_after(check) if attempts > 0 and left else None
        if again is None:
            return verdict
        say(verdict.sentence)
        say(plan_sentence(again))
        plan = again
    raise DemoError("no plan was carried out")


def _threads(story: Story, count: int) -> list[ThreadReconstruction]:
    """The next few threads that are reconstructed."""
    deadline_s, why = monotonic_s() + FIRST_THREAD_S, "no frame was reconstructed"
    threads: list[ThreadReconstruction] = []
    while len(threads) < count:
        story.check()
        if monotonic_s() > deadline_s:
            raise DemoError(f"no thread was seen within {FIRST_THREAD_S:.0f} s: {why}")
        thread = story.threads.next(LOOK_S)
        if not isinstance(thread, ThreadReconstruction):
            continue
        if thread.status is Status.OK:
            threads.append(thread)
        else:
            why = thread.reason
    return threads


def _plan(story: Story, goals: list[tuple[float, float]]) -> GraspPlan:
    """The first plan with a slide worth showing, in the order of the goals; else any plan."""
    without_slide, reason = None, "the thread states no confidence"
    deadline_s = monotonic_s() + PLANS_S
    # what is known of a place changes from frame to frame, so where none had a plan each is asked for again
    for turn, (s, confidence) in enumerate(GOAL_ROUNDS * goals):
        if monotonic_s() > deadline_s or (without_slide is not None and turn >= len(goals)):
            break
        _newer_thread(story)
        where = f"a grasp at {percent(s)}, where confidence is {confidence:.2f}"
        answer, plan = ask_for_grasp(story.connection, ARM, Policy.CAPTURE_SLIDE_GRASP, s=s)
        if answer.outcome is not Outcome.ACCEPTED or plan is None or plan.status is not Status.OK:
            reason = answer.reason or (plan.reason if plan is not None else "no plan came")
            say(f"{where}: none, {reason}")
        elif plan.slide_m < WORTH_SHOWING_M:
            say(f"{where}: possible without a slide")
            without_slide = plan
        else:
            say(f"{where}:")
            say(plan_sentence(plan))
            return plan
    if without_slide is None:
        raise NothingToGraspError(f"no grasp was attempted: {reason}")
    say(plan_sentence(without_slide))
    return without_slide


def _newer_thread(story: Story) -> None:
    """Wait until another thread has come, so that the planner has a fresh one."""
    while story.threads.next(AT_ONCE_S) is not None:
        pass
    _threads(story, 1)


def _verdict(story: Story, plan_id: str, stood: Stood) -> GraspJudgement:
    if stood.answer.outcome is not Outcome.ACCEPTED:
        raise DemoError(f"the arm was not armed: {stood.answer.reason}")
    if stood.end is None or stood.end.kind is not ExecutionKind.FINISHED:
        raise DemoError(stood.left or (event_told(stood.end) if stood.end else "the grasp was not finished"))
    verdict = awaited(story.verdicts, GraspJudgement, VERDICT_S, lambda verdict: verdict.plan_id == plan_id)
    if verdict is None:
        raise DemoError("the simulator gave no verdict")
    return verdict
