"""What an operator does: say which thread is meant, name a goal, arm a plan and stand by it with a heartbeat, hold."""

import contextlib
import queue
import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import (
    Arm,
    ChangeState,
    CommandAnswer,
    ExecutionEvent,
    ExecutionKind,
    GraspGoal,
    GraspPlan,
    Heartbeat,
    Hold,
    Outcome,
    Policy,
    Prompt,
    PullBounds,
    PullGoal,
    RobotState,
    StateWord,
)
from schemas.topics import (
    ARM,
    CHANGE_STATE,
    EXECUTION,
    GOAL,
    HEARTBEAT,
    HOLD,
    PLAN,
    PROMPT,
    PULL_GOAL,
    ROBOT_STATE,
    Topic,
)
from shared.clock import monotonic_s
from shared.runtime.commands import new_header
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

SENDER = "operator"
HEARTBEAT_HZ = 20.0
PLAN_WAIT_S = 5.0
"""How long a plan may take after its goal was accepted."""
LOOK_S = 0.1
AWAKE_S = 0.4
"""Longer than this the heartbeat does not go on by itself."""
ARMING_S = 5.0
"""The same while arming, whose answer may take as long."""
PLAN_ARRIVES_S = 1.0
CHALLENGED_S = 1.0
"""How long a first challenge of an arm's bridge is awaited; at rest it comes five times a second."""
SEGMENTS = 8
"""Into so many segments, each planned from a fresh image, a motion that lasts too long at once may be cut. The bridge
allows no more."""
UNKNOWN_PLAN = "unknown_plan"
BUSY_S = 120.0
"""A network of the user's own may need so long for a frame on a small machine."""
UNHEARD = "unknown_id", "late"
"""What a command comes to that its receiver has not taken up in time."""
SILENCE_S = 2.0
"""An arm that reports a hundred times a second and has not for so long is not there any more."""
INSTANCE = 3
"""Where in a key the arm stands."""
END = (ExecutionKind.FINISHED, ExecutionKind.HELD)


class Events:
    """Messages of one event topic in the order in which they came."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._queue: queue.Queue[Tapped] = queue.Queue()
        self.put = self._queue.put

    def next(self, timeout_s: float) -> object | None:
        """The next message that can be read; None where none came in time."""
        deadline_s = monotonic_s() + timeout_s
        while (left_s := deadline_s - monotonic_s()) > 0:
            try:
                return decode(self._topic.message, self._queue.get(timeout=left_s).payload)
            except MessageError:
                continue
            except queue.Empty:
                return None
        return None


@contextlib.contextmanager
def events_of(connection: Connection, topic: Topic) -> Generator[Events]:
    """The events of a topic from now on, for as long as they are listened to."""
    events = Events(topic)
    with connection.listening((topic,), events.put):
        yield events


def ask_for_grasp(
    connection: Connection,
    arm: str,
    policy: Policy,
    *,
    s: float | None = None,
    pixel: Float64[np.ndarray, "2"] | None = None,
    point_camera: Float64[np.ndarray, "3"] | None = None,
    attempts: int | None = None,
    from_swage_m: float | None = None,
) -> tuple[CommandAnswer, GraspPlan | None]:
    """Send a goal; its answer and, where it was accepted, the plan or rejection that followed (None: none came)."""
    goal = GraspGoal(new_header(SENDER), arm, policy, s, pixel, point_camera, attempts, from_swage_m)
    return _planned(connection, GOAL, goal)


def ask_for_pull(
    connection: Connection, arm: str, tail_m: float | None, exit_pixel: Float64[np.ndarray, "2"] | None = None
) -> tuple[CommandAnswer, GraspPlan | None]:
    """The same of a pull until the tail is so long; without a length, of jaws that let go where they are."""
    return _planned(connection, PULL_GOAL, PullGoal(new_header(SENDER), arm, tail_m, exit_pixel))


def _planned(
    connection: Connection, topic: Topic, goal: GraspGoal | PullGoal
) -> tuple[CommandAnswer, GraspPlan | None]:
    with events_of(connection, PLAN) as plans:
        answer = connection.command(topic, goal)
        if answer.outcome is not Outcome.ACCEPTED:
            return answer, None
        deadline_s = monotonic_s() + PLAN_WAIT_S
        while (left_s := deadline_s - monotonic_s()) > 0:
            plan = plans.next(left_s)
            if isinstance(plan, GraspPlan) and plan.goal_id == goal.header.id:
                return answer, plan
    return answer, None


@dataclass(frozen=True)
class Stood:
    """How standing by an armed plan ended.

    Fields:
        answer: to the arming.
        end: the event that ended the plan; None where the operator left before.
        left: why the operator left before.
        is_real: the arm moves something real, or nobody told that it does not.
    """

    answer: CommandAnswer
    end: ExecutionEvent | None = None
    left: str = ""
    is_real: bool = True


class _Told:
    """What an arm's bridge tells: its newest state, which is its challenge, and how long there was none."""

    def __init__(self, arm: str) -> None:
        self._arm, self._heard_s, self._came = arm, monotonic_s(), threading.Event()
        self._newest: Tapped | None = None
        self._answered_ns = 0

    def take(self, tapped: Tapped) -> None:
        if tapped.key.split("/")[INSTANCE] == self._arm:
            self._heard_s, self._newest = monotonic_s(), tapped
            self._came.set()

    def silent_s(self) -> float:
        """For how long it has told nothing."""
        return monotonic_s() - self._heard_s

    def first(self, within_s: float) -> None:
        """Wait for the first state, so long at most."""
        self._came.wait(within_s)

    def state(self) -> RobotState | None:
        """The newest; None where none came that can be read."""
        newest = self._newest
        if newest is None:
            return None
        try:
            state = decode(RobotState, newest.payload)
        except MessageError:
            return None
        return state if state.arm == self._arm else None

    def pass_over(self) -> None:
        """Leave what came until now unanswered: an arm at rest tells seldom, and its newest challenge may be old."""
        self.unanswered()

    def unanswered(self) -> RobotState | None:
        """The newest, where its challenge is newer than the last one that was answered; it counts as answered now."""
        state = self.state()
        if state is None or state.challenge_ns <= self._answered_ns:
            return None
        self._answered_ns = state.challenge_ns
        return state


def arm_and_stand_by(
    connection: Connection,
    arm: str,
    plan_id: str,
    stopped: threading.Event,
    told: Callable[[ExecutionEvent], None],
    pull: PullBounds | None = None,
) -> Stood:
    """Arm a plan and stand by it until it ends, the arm falls silent, or `stopped` is set, which disarms.

    `pull` says within which bounds a plan that pulls thread is armed, with all of its segments.

    A process that answers by itself proves nobody's presence: a real arm needs its console's pedal pressed beside it.
    """
    bridge = _Told(arm)
    arming_id, awake_until_s = [""], [monotonic_s() + ARMING_S]

    def beat(at_ns: int) -> Heartbeat | None:
        """While whoever stands by can still react: a thread of its own would beat on behind a blocked terminal."""
        if stopped.is_set() or not arming_id[0] or monotonic_s() > awake_until_s[0]:
            return None
        asked = bridge.unanswered()
        if asked is None:
            return None
        return Heartbeat(arm, plan_id, at_ns, arming_id[0], asked.challenge_ns, asked.guard_challenge, pressed=False)

    def stood(end: ExecutionEvent | None = None, left: str = "") -> Stood:
        state = bridge.state()
        return Stood(answer, end, left, is_real=state is None or state.is_real)

    with (
        events_of(connection, EXECUTION) as events,
        connection.listening((ROBOT_STATE,), bridge.take),
        connection.repeating(HEARTBEAT, arm, HEARTBEAT_HZ, beat),
    ):
        answer = _armed(connection, arm, plan_id, arming_id, bridge, pull)
        if answer.outcome is not Outcome.ACCEPTED:
            return stood()
        while not stopped.is_set():
            awake_until_s[0] = monotonic_s() + AWAKE_S
            event = events.next(LOOK_S)
            if isinstance(event, ExecutionEvent) and (event.arm, event.arming_id) == (arm, arming_id[0]):
                told(event)
                if event.kind in END:
                    return stood(event)
            if bridge.silent_s() > SILENCE_S:
                return stood(left=f"{arm} has not reported for {SILENCE_S:.0f} s; look at its bridge")
    return stood(left="disarmed: the heartbeat has ended, and the arm holds")


def _armed(
    connection: Connection,
    arm: str,
    plan_id: str,
    arming_id: list[str],
    bridge: _Told,
    pull: PullBounds | None,
) -> CommandAnswer:
    """The answer to arming, whose id is noted; a plan that its bridge does not know may still be on its way there."""
    bridge.first(CHALLENGED_S)
    deadline_s, turn = monotonic_s() + PLAN_ARRIVES_S, threading.Event()
    while True:
        header, state = new_header(SENDER), bridge.state()
        challenge_ns = 0 if state is None else state.challenge_ns
        message = Arm(header, arm, plan_id, challenge_ns, pressed=False, segments=SEGMENTS, pull=pull)
        answer = connection.command(ARM, message, arm)
        bridge.pass_over()
        arming_id[0] = header.id
        if answer.code != UNKNOWN_PLAN or monotonic_s() > deadline_s:
            return answer
        turn.wait(LOOK_S)


def hold(connection: Connection, arm: str) -> CommandAnswer:
    """Have an arm stop where it is, disarmed."""
    return connection.command(HOLD, Hold(new_header(SENDER), arm), arm)


def bridged_arms(connection: Connection) -> list[str]:
    """The arms whose bridges are there."""
    named = (name.split("/") for name in connection.present())
    return [arm for kind, arm in named if kind == ROBOT_STATE.agent]


def change_state(connection: Connection, arm: str, word: StateWord) -> CommandAnswer:
    """Have the console of a real arm that is disarmed change its state; homing moves the arm.

    A process proves nobody's presence: but to stop it, the console's pedal must be pressed beside it.
    """
    bridge = _Told(arm)
    with connection.listening((ROBOT_STATE,), bridge.take):
        bridge.first(CHALLENGED_S)
        state = bridge.state()
        challenge_ns = 0 if state is None else state.challenge_ns
        return connection.command(CHANGE_STATE, ChangeState(new_header(SENDER), arm, word, challenge_ns), arm)


def prompt(connection: Connection, pixel: Float64[np.ndarray, "2"] | None) -> CommandAnswer:
    """Tell perception which thread is meant, by a pixel of the rectified left image; None for any again.

    It is told again, under another id, while perception is there and too busy with a frame to hear it in time.
    """
    deadline_s = monotonic_s() + BUSY_S
    while True:
        answer = connection.command(PROMPT, Prompt(new_header(SENDER), pixel))
        if answer.code not in UNHEARD or monotonic_s() > deadline_s:
            return answer
