"""A thread through a bite of tissue, 80 mm before the camera, in millimetres; pulled by geometry alone."""

import dataclasses
from typing import Any

import numpy as np

from agents.planner.agent import Planner
from agents.planner.pulling.way import jaw_of
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.codec import decode
from schemas.messages import (
    Arm,
    ChallengeEcho,
    CommandHeader,
    ExecutionKind,
    FrameNotice,
    FrameStamp,
    Heartbeat,
    Outcome,
    PullGoal,
    RobotMode,
)
from schemas.topics import (
    ARM,
    EXECUTION,
    FRAME_NOTICE,
    HEARTBEAT,
    PLAN,
    PULL_GOAL,
    ROBOT_STATE,
    TAIL,
    THREAD,
    topic_of,
)
from shared.rigid_transforms import compose
from shared.runtime.agent import Output
from shared.runtime.replay import Lockstep
from tests.agents.planner import bench

BITE_MM, ENTRY_MM, LOOSE_MM = 6.0, np.array([3.0, 0.0, 80.0]), 45.0


def path(corners, count):
    """Evenly spaced points along a polyline."""
    corners = np.asarray(corners, float)
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    at = np.linspace(0.0, along[-1], count)
    return np.column_stack([np.interp(at, along, one) for one in corners.T]), float(along[-1])


def threaded(
    tail_mm=30.0,
    jaw_mm=None,
    held_mm=0.0,
    deviations_mm=(0.1, 0.1, 0.3),
    loose_mm=LOOSE_MM,
    at_ns=bench.CAPTURED_NS,
    parted=False,
    **changes,
):
    """A straight tail to the left of the bite, and to its right the standing strand.

    Args:
        parted: each strand is a curve of its own, the standing one that which is meant.
        jaw_mm: where jaws hold it, `held_mm` of it from the entry; it is straight up to there, and hangs down beyond.
    """
    exit_mm = ENTRY_MM - (BITE_MM, 0, 0)
    free = exit_mm - tail_mm * np.array((0.8, 0.6, 0.0))
    standing = [ENTRY_MM, ENTRY_MM + loose_mm * np.array((1.0, 0.2, 0.0))]
    if jaw_mm is not None:
        jaw = np.asarray(jaw_mm, float)
        left = loose_mm - held_mm
        standing = [ENTRY_MM, jaw, jaw + left * np.array((0.9, 0.43, 0.0))]
    stamp = FrameStamp(7, at_ns, at_ns, "bench")
    if parted:
        tail, made = (bench.polyline(*path(corners, 60)[0]) for corners in ([free, exit_mm], standing))
        tail, made = bench.known(tail, *deviations_mm), bench.known(made, *deviations_mm)
        return dataclasses.replace(made, strands=(made.as_strand, tail.as_strand), stamp=stamp, **changes)
    points, long_mm = path([free, exit_mm, *standing], 120)
    start, end = tail_mm / long_mm, (tail_mm + BITE_MM) / long_mm
    made = bench.polyline(*points, unseen=[(start, end)], **changes)
    made = bench.known(made, *deviations_mm)
    return dataclasses.replace(made, stamp=stamp)


class Field:
    """A planner and a bridge in step, before a camera that sees a thread which the simulated arm pulls.

    Fields:
        gives: how much of what the jaws take runs out of the tissue; what does not is taken from the jaws where it
            slips, and else from the tissue, which follows.
        slips: of the thread in the jaws.
        blind: no thread is found; hides_end: something lies on the free end.
        beats: somebody stands by.
        parted: as `threaded` has it.
    """

    def __init__(self, tail_mm=30.0, planner=None, config=None, parted=False):
        self.tail_mm, self.gives, self.slips, self.blind, self.hides_end, self.beats = (
            tail_mm,
            1.0,
            False,
            False,
            False,
            True,
        )
        self.films, self.parted = True, parted
        self.bridge = RobotBridge(config or RobotBridgeConfig(), SimulatedPsm())
        self.steps = Lockstep(planner or Planner(), self.bridge, rig="bench")
        self.held_mm, self.at_grasp_mm, self.arming = 0.0, None, None
        self.events, self.plans, self.tails = [], [], []
        self._told = 0
        self.run(0.3)

    @property
    def now_ns(self):
        return self.steps.now_ns

    def run(self, seconds, until=lambda: False):
        """Let time pass: frames 5 times a second, answers to challenges 20 times."""
        for turn in range(round(seconds * 20)):
            self.steps.run(0.05)
            state = self.steps.last[ROBOT_STATE]
            self._pull(state)
            if self.films:
                self._film(state, turn % 4 == 0)
            if self.arming is not None and self.beats:
                plan_id, arming_id = self.arming
                beat = Heartbeat("psm1", plan_id, self.now_ns, arming_id, state.challenge_ns)
                self.steps.tell([Output(HEARTBEAT, beat)], "psm1")
            self._hear()
            if until():
                break
        return self

    def _film(self, state, thread):
        stamp = FrameStamp(
            turn_of(self.now_ns), self.now_ns, self.now_ns, "bench", (ChallengeEcho("psm1", state.challenge_ns),)
        )
        self.steps.tell([Output(FRAME_NOTICE, FrameNotice(stamp))])
        if not thread:
            return
        jaw = self._jaw_mm(state) if self.at_grasp_mm is not None else None
        seen = bench.failed() if self.blind else threaded(self.tail_mm, jaw, self.held_mm, parted=self.parted)
        if self.hides_end and not self.blind:
            seen = dataclasses.replace(seen, ends_hidden=np.array([True, False]))
        self.steps.tell([Output(THREAD, dataclasses.replace(seen, stamp=stamp))])

    def _jaw_mm(self, state):
        T = compose(state.T_camera_base, state.T_base_tool)
        return 1e3 * jaw_of(T, self.plans[-1].depth_m or 0.002)

    def _pull(self, state):
        """The thread follows the jaws."""
        closed = state.jaw_rad < 0.05 and state.mode is RobotMode.MOVING and self.plans
        if not closed:
            self.at_grasp_mm = None if state.jaw_rad > 0.3 else self.at_grasp_mm
            return
        away_mm = float(np.linalg.norm(self._jaw_mm(state) - ENTRY_MM))
        if self.at_grasp_mm is None:
            self.at_grasp_mm = self.held_mm = away_mm
        over_mm = away_mm - self.held_mm
        if over_mm > 0:
            self.tail_mm -= self.gives * over_mm
            self.held_mm += over_mm

    def _hear(self):
        new, self._told = self.steps.entries[self._told :], len(self.steps.entries)
        kept = {PLAN: self.plans, TAIL: self.tails, EXECUTION: self.events}
        for entry in new:
            topic = topic_of(entry.key)
            if topic in kept:
                kept[topic].append(decode(topic.message, entry.payload))

    def ask(self, tail_m: Any = 0.02, pixel: Any = (442.0, 269.5), name="g1") -> Any:
        """The plan for a goal, and the answer to that."""
        header = CommandHeader(name, self.now_ns + 10**9, "bench")
        answer = self.steps.command(PULL_GOAL, PullGoal(header, "psm1", tail_m, pixel and np.array(pixel)))
        self._hear()
        return (self.plans[-1] if answer.outcome is Outcome.ACCEPTED else None), answer

    def arm(self, plan, bounds=None, name="a1"):
        """Arm a plan, by default within the bounds that it proposes."""
        header = CommandHeader(name, self.now_ns + 10**9, "bench")
        challenge_ns = self.steps.last[ROBOT_STATE].challenge_ns
        stated = bounds or plan.pull.bounds
        answer = self.steps.command(ARM, Arm(header, "psm1", plan.plan_id, challenge_ns, pull=stated))
        self._hear()
        if answer.outcome is Outcome.ACCEPTED:
            self.arming = plan.plan_id, name
        return answer

    @property
    def ended(self):
        return self.events[-1].kind, self.events[-1].code

    def to_the_end(self, seconds=120.0):
        """Until the arm has finished or holds."""
        over = (ExecutionKind.FINISHED, ExecutionKind.HELD)
        return self.run(seconds, lambda: bool(self.events) and self.events[-1].kind in over)


def turn_of(now_ns):
    return now_ns // 50_000_000 % 10**9
