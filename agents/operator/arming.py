"""What follows from the state of control: arming, heartbeats and holds, each written down.

Holds on their way: each goes out at once, and none waits for the answer to another.

Commands of the page on their way; holds go theirs, so that none ever waits behind a goal.
"""

import asyncio
import functools
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict
from itertools import count
from typing import Any, TypeVar

import numpy as np

from agents.operator.control import ArmNow, BeatNow, Control, Effect, HoldNow, Noted
from agents.operator.operator import PLAN_ARRIVES_S, SEGMENTS, UNKNOWN_PLAN, prompt
from agents.operator.words import Voice
from schemas.messages import (
    Arm,
    CommandAnswer,
    GraspGoal,
    Heartbeat,
    Hold,
    Outcome,
    Policy,
    PullBounds,
    PullGoal,
)
from schemas.topics import ARM, GOAL, HEARTBEAT, HOLD, PULL_GOAL
from shared.clock import monotonic_s, now_ns
from shared.runtime.commands import new_header
from shared.runtime.connection import Connection

TRIED = 3
EVERY_S = 0.1
"""What one page says within so long of its last hold goes out as one more, at the end of it."""
MOST_AWAITED = 1000
"""More holds of one arm than all pages can say while the first is still waited for; each waits in a thread."""


class Holds:
    """Has arms hold; where no answer comes a hold is said again, unless a newer one was said meanwhile."""

    def __init__(self, connection: Connection, sender: str) -> None:
        self._connection, self._sender = connection, sender
        self._threads: dict[str, ThreadPoolExecutor] = {}
        self._newest: dict[str, int] = {}
        self._numbers = count()

    def say(self, arm: str) -> "asyncio.Future[CommandAnswer]":
        """Send one now; its answer."""
        if arm not in self._threads:
            self._threads[arm] = ThreadPoolExecutor(MOST_AWAITED, f"holding {arm}")
        number = self._newest[arm] = next(self._numbers)
        return asyncio.get_running_loop().run_in_executor(self._threads[arm], self._said, arm, number)

    def close(self) -> None:
        """Wait for what was said."""
        for threads in self._threads.values():
            threads.shutdown(wait=True)

    def _said(self, arm: str, number: int) -> CommandAnswer:
        for turn in range(TRIED):
            answer = self._connection.command(HOLD, Hold(new_header(self._sender), arm), arm)
            if answer.outcome is not Outcome.UNKNOWN or turn == TRIED - 1 or self._newest[arm] != number:
                return answer
        raise AssertionError


class Throttle:
    """Does what is asked for at once, and what is asked for again soon after once more at the end of EVERY_S."""

    def __init__(self, later: Callable[[float, Callable[[], None]], Any]) -> None:
        """`later` has something done after so many seconds."""
        self._later = later
        self._again: dict[str, Callable[[], None] | None] = {}

    def do(self, who: str, what: Callable[[], None]) -> None:
        """Do it for one of those who ask, each by itself."""
        if who in self._again:
            self._again[who] = what
            return
        self._again[who] = None
        self._later(EVERY_S, lambda: self._over(who))
        what()

    def _over(self, who: str) -> None:
        if (again := self._again.pop(who)) is not None:
            self.do(who, again)


SENDER = "operator page"
AGAIN_S = 0.1
MM_PER_METRE = 1e3
POLICIES = {"robust": Policy.CAPTURE_SLIDE_GRASP, "direct": Policy.DIRECT}

Result = TypeVar("Result")


class Commands:
    """Sends commands and heartbeats; closes with its connection."""

    def __init__(self, connection: Connection, audit: Callable[..., None]) -> None:
        self._connection, self._audit = connection, audit
        self._asking = ThreadPoolExecutor(6, "asking")
        self._holds = Holds(connection, SENDER)
        self._publishing = ExitStack()
        self._beats: dict[str, Callable[[Any, int], None]] = {}

    def close(self) -> None:
        """End the threads."""
        self._asking.shutdown(wait=False, cancel_futures=True)
        self._holds.close()
        self._publishing.close()

    async def aside(self, work: Callable[[], Result]) -> Result:
        """Do what takes a while in a thread."""
        return await asyncio.get_running_loop().run_in_executor(self._asking, work)

    def prepare(self, arm: str) -> None:
        """Have the way of an arm's heartbeats open before the first one."""
        if arm not in self._beats:
            self._beats[arm] = self._publishing.enter_context(self._connection.publishing(HEARTBEAT, arm))

    def beat(self, beat: BeatNow) -> None:
        """One heartbeat, of a person who presses."""
        self.prepare(beat.arm)
        at_ns = now_ns()
        answered = beat.challenge_ns, beat.guard_challenge
        message = Heartbeat(beat.arm, beat.plan_id, at_ns, beat.arming_id, *answered, pressed=True)
        self._beats[beat.arm](message, at_ns)

    async def goal(self, arm: str, policy: str, s: float) -> tuple[str, CommandAnswer]:
        """Ask for a grasp at s; the goal's id and the planner's answer, upon which a plan follows as an event."""
        goal = GraspGoal(new_header(SENDER), arm, POLICIES[policy], s, None, None)
        answer = await self.aside(lambda: self._connection.command(GOAL, goal))
        return goal.header.id, answer

    async def pull(
        self, arm: str, tail_mm: float | None, exit_pixel: tuple[float, float] | None
    ) -> tuple[str, CommandAnswer]:
        """Ask for a pull until the tail is so long, or without a length for jaws that let go; likewise."""
        tail_m, pixel = tail_mm and tail_mm / MM_PER_METRE, None if exit_pixel is None else np.array(exit_pixel)
        goal = PullGoal(new_header(SENDER), arm, tail_m, pixel)
        answer = await self.aside(lambda: self._connection.command(PULL_GOAL, goal))
        return goal.header.id, answer

    async def prompt(self, pixel: Any) -> CommandAnswer:
        """Say which thread is meant."""
        return await self.aside(lambda: prompt(self._connection, pixel))

    async def arm(
        self,
        screen: str,
        arm: str,
        plan_id: str,
        begins: Callable[[str], bool],
        challenge_ns: Callable[[], int],
        pull: PullBounds | None = None,
    ) -> CommandAnswer | None:
        """Arm a plan; `begins` is told the id before it is sent, and says whether that is still wanted.

        A plan that its bridge does not know may still be on its way there, and is asked for again for a while.
        `challenge_ns` tells the newest challenge of the bridge that was heard; `pull` within which bounds all segments
        of a pull are armed.

        Raises:
            RuntimeError: where it cannot be written down.
        """
        self.prepare(arm)
        deadline_s = monotonic_s() + PLAN_ARRIVES_S
        while True:
            header = new_header(SENDER)
            if not begins(header.id):
                return None
            stated = {} if pull is None else {"pull": asdict(pull)}
            self._audit("arm", screen=screen, arm=arm, plan_id=plan_id, id=header.id, **stated)
            message = Arm(header, arm, plan_id, challenge_ns(), pressed=True, segments=SEGMENTS, pull=pull)
            answer = await self.aside(lambda message=message: self._connection.command(ARM, message, arm))
            if answer.code != UNKNOWN_PLAN or monotonic_s() > deadline_s:
                return answer
            await asyncio.sleep(AGAIN_S)

    def hold(self, arm: str) -> "asyncio.Future[CommandAnswer]":
        """Have an arm hold, from now on; its answer."""
        return self._holds.say(arm)


class StandingBy:
    """Carries out the effects of one `Control`.

    Fields:
        armed_s: when each arming was accepted, by its id.
        holds: why each arm was told to hold last.
    """

    def __init__(
        self,
        control: Control,
        commands: Commands,
        voice: Voice,
        newest_challenge: Callable[[str], int],
        pull_bounds: Callable[[str, str], PullBounds | None],
    ) -> None:
        """`newest_challenge` is that of an arm's bridge which was heard, `pull_bounds` those of an arm's plan."""
        self._control, self._commands, self._voice = control, commands, voice
        self._newest_challenge, self._pull_bounds = newest_challenge, pull_bounds
        self._tasks: set[asyncio.Task[None]] = set()
        self.armed_s: dict[str, float] = {}
        self.holds: dict[str, str] = {}

    def follow(self, effects: list[Effect]) -> None:
        """Do at once what can be, and the rest in tasks of its own; holds before all else, which may fail or wait."""
        for effect in effects:
            if isinstance(effect, HoldNow):
                self.holds[effect.arm] = effect.why
                self.start(self._held(effect, self._commands.hold(effect.arm)))
        for effect in effects:
            match effect:
                case HoldNow():
                    pass
                case BeatNow():
                    self._commands.beat(effect)
                case ArmNow():
                    self.start(self._arm(effect))
                case Noted(screen, "refused", text):
                    self._voice.refuse(screen, text)
                case Noted(screen, what, text):
                    # what releases or passes on is so whether or not it can be written down
                    self._voice.written(screen, what, text=text)
                    self._voice.say(f"{text}.")
            self._voice.changed.set()

    def start(self, work: Coroutine[Any, Any, None]) -> None:
        """Something that takes a while."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._done)

    async def finish(self, within_s: float) -> None:
        """Wait for what is under way."""
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=within_s)

    def _done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._voice.failed(error)

    async def _arm(self, effect: ArmNow) -> None:
        screen, arm, plan_id = effect.screen, effect.arm, effect.plan_id
        sent, begins = self._begins(plan_id)
        try:
            newest = functools.partial(self._newest_challenge, arm)
            bounds = self._pull_bounds(arm, plan_id)
            answer = await self._commands.arm(screen, arm, plan_id, begins, newest, bounds)
        except RuntimeError as error:
            self._voice.refuse(screen, str(error))
            self.follow(self._control.release(screen, "it could not be written down"))
            return
        if answer is None:
            return
        accepted = answer.outcome is Outcome.ACCEPTED
        if accepted:
            self.armed_s[sent[-1]] = monotonic_s()
        self.follow(self._control.armed(screen, arm, sent[-1], accepted))
        if not accepted:
            self._voice.say(f"{arm} was not armed: {answer.reason}")
            self._voice.refuse(screen, f"{arm} was not armed: {answer.reason}")
        if answer.outcome is Outcome.UNKNOWN:
            self.follow([HoldNow(screen, arm, "whether it was armed is not known")])
        told = {"outcome": answer.outcome.name.lower(), "code": answer.code, "reason": answer.reason}
        self._voice.written(screen, "answer", id=sent[-1], **told)

    def _begins(self, plan_id: str) -> tuple[list[str], Callable[[str], bool]]:
        """The ids under which arming was tried, and what notes one, where it is still wanted."""
        sent: list[str] = []

        def begins(arming_id: str) -> bool:
            sent.append(arming_id)
            return self._control.arming(plan_id, arming_id)

        return sent, begins

    async def _held(self, effect: HoldNow, answered: "asyncio.Future[CommandAnswer]") -> None:
        """Write down a hold that is on its way, and what came of it."""
        self._voice.written(effect.screen, "hold", arm=effect.arm, why=effect.why)
        answer = await answered
        told = {"outcome": answer.outcome.name.lower(), "code": answer.code, "reason": answer.reason}
        self._voice.written(effect.screen, "answer", id=answer.id, **told)
        if answer.outcome is Outcome.ACCEPTED and answer.reason:
            self._voice.say(f"{effect.arm} was told to hold ({effect.why}), but {answer.reason}.")
        elif answer.outcome is Outcome.ACCEPTED:
            self._voice.say(f"{effect.arm} holds: {effect.why}.")
        else:
            self._voice.say(f"{effect.arm} gave no answer to hold: {answer.reason}")
