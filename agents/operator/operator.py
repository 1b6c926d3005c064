"""What an operator does: say which thread is meant, name a goal, arm a plan and stand by it with a heartbeat, hold."""

import queue
import threading
from collections.abc import Callable
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
    StateWord,
)
from schemas.topics import ARM, CHANGE_STATE, EXECUTION, GOAL, HEARTBEAT, HOLD, PLAN, PROMPT, ROBOT_STATE, Topic
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
UNKNOWN_PLAN = "unknown_plan"
BUSY_S = 120.0
"""A network of the user's own may need so long for a frame on a small machine."""
UNHEARD = "unknown_id", "late"
"""What a command comes to that its receiver has not taken up in time."""
SILENCE_S = 2.0
"""An arm that reports a hundred times a second and has not for so long is not there any more."""
END = (ExecutionKind.FINISHED, ExecutionKind.HELD)


class Events:
    """Messages of one event topic in the order in which they came."""

    def __init__(self, connection: Connection, topic: Topic) -> None:
        self._topic = topic
        self._queue: queue.Queue[Tapped] = queue.Queue()
        connection.listen((topic,), self._queue.put)

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


def ask_for_grasp(
    connection: Connection,
    arm: str,
    policy: Policy,
    *,
    s: float | None = None,
    pixel: Float64[np.ndarray, "2"] | None = None,
    point_camera: Float64[np.ndarray, "3"] | None = None,
    attempts: int | None = None,
) -> tuple[CommandAnswer, GraspPlan | None]:
    """Send a goal; its answer and, where it was accepted, the plan or rejection that followed (None: none came)."""
    plans = Events(connection, PLAN)
    goal = GraspGoal(new_header(SENDER), arm, policy, s, pixel, point_camera, attempts)
    answer = connection.command(GOAL, goal)
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
    """

    answer: CommandAnswer
    end: ExecutionEvent | None = None
    left: str = ""


class _Silence:
    """How long an arm has not reported."""

    def __init__(self, connection: Connection, arm: str) -> None:
        self._arm, self._heard_s = arm, monotonic_s()
        connection.listen((ROBOT_STATE,), self._take)

    def _take(self, tapped: Tapped) -> None:
        if f"/{self._arm}/" in tapped.key:
            self._heard_s = monotonic_s()

    def seconds(self) -> float:
        return monotonic_s() - self._heard_s


def arm_and_stand_by(
    connection: Connection,
    arm: str,
    plan_id: str,
    stopped: threading.Event,
    told: Callable[[ExecutionEvent], None],
) -> Stood:
    """Arm a plan and keep its heartbeat until it ends, the arm falls silent, or `stopped` is set, which disarms."""
    events, silence = Events(connection, EXECUTION), _Silence(connection, arm)
    arming_id, awake_until_s = [""], [monotonic_s() + ARMING_S]

    def beat(at_ns: int) -> Heartbeat | None:
        """While whoever stands by can still react: a thread of its own would beat on behind a blocked terminal."""
        if stopped.is_set() or not arming_id[0] or monotonic_s() > awake_until_s[0]:
            return None
        return Heartbeat(arm, plan_id, at_ns, arming_id[0])

    with connection.repeating(HEARTBEAT, arm, HEARTBEAT_HZ, beat):
        answer = _armed(connection, arm, plan_id, arming_id)
        if answer.outcome is not Outcome.ACCEPTED:
            return Stood(answer)
        while not stopped.is_set():
            awake_until_s[0] = monotonic_s() + AWAKE_S
            event = events.next(LOOK_S)
            if isinstance(event, ExecutionEvent) and (event.arm, event.arming_id) == (arm, arming_id[0]):
                told(event)
                if event.kind in END:
                    return Stood(answer, event)
            if silence.seconds() > SILENCE_S:
                return Stood(answer, left=f"{arm} has not reported for {SILENCE_S:.0f} s; look at its bridge")
    return Stood(answer, left="disarmed: the heartbeat has ended, and the arm holds")


def _armed(connection: Connection, arm: str, plan_id: str, arming_id: list[str]) -> CommandAnswer:
    """The answer to arming, whose id is noted; a plan that its bridge does not know may still be on its way there."""
    deadline_s, turn = monotonic_s() + PLAN_ARRIVES_S, threading.Event()
    while True:
        header = new_header(SENDER)
        arming_id[0] = header.id
        answer = connection.command(ARM, Arm(header, arm, plan_id), arm)
        if answer.code != UNKNOWN_PLAN or monotonic_s() > deadline_s:
            return answer
        turn.wait(LOOK_S)


def hold(connection: Connection, arm: str) -> CommandAnswer:
    """Have an arm stop where it is, disarmed."""
    return connection.command(HOLD, Hold(new_header(SENDER), arm), arm)


def change_state(connection: Connection, arm: str, word: StateWord) -> CommandAnswer:
    """Have the console of a real arm that is disarmed change its state; homing moves the arm."""
    return connection.command(CHANGE_STATE, ChangeState(new_header(SENDER), arm, word), arm)


def prompt(connection: Connection, pixel: Float64[np.ndarray, "2"] | None) -> CommandAnswer:
    """Tell perception which thread is meant, by a pixel of the rectified left image; None for any again.

    It is told again, under another id, while perception is there and too busy with a frame to hear it in time.
    """
    deadline_s = monotonic_s() + BUSY_S
    while True:
        answer = connection.command(PROMPT, Prompt(new_header(SENDER), pixel))
        if answer.code not in UNHEARD or monotonic_s() > deadline_s:
            return answer
