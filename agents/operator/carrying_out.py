"""Commands of the page on their way; holds go theirs (holding.py), so that none ever waits behind a goal."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any, TypeVar

from agents.operator.control import BeatNow
from agents.operator.holding import Holds
from agents.operator.operator import PLAN_ARRIVES_S, SEGMENTS, UNKNOWN_PLAN, prompt
from schemas.messages import Arm, CommandAnswer, GraspGoal, Heartbeat, Policy
from schemas.topics import ARM, GOAL, HEARTBEAT
from shared.clock import monotonic_s, now_ns
from shared.runtime.commands import new_header
from shared.runtime.connection import Connection

SENDER = "operator page"
AGAIN_S = 0.1
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

    async def prompt(self, pixel: Any) -> CommandAnswer:
        """Say which thread is meant."""
        return await self.aside(lambda: prompt(self._connection, pixel))

    async def arm(
        self, screen: str, arm: str, plan_id: str, begins: Callable[[str], bool], challenge_ns: Callable[[], int]
    ) -> CommandAnswer | None:
        """Arm a plan; `begins` is told the id before it is sent, and says whether that is still wanted.

        A plan that its bridge does not know may still be on its way there, and is asked for again for a while.
        `challenge_ns` tells the newest challenge of the bridge that was heard.

        Raises:
            RuntimeError: where it cannot be written down.
        """
        self.prepare(arm)
        deadline_s = monotonic_s() + PLAN_ARRIVES_S
        while True:
            header = new_header(SENDER)
            if not begins(header.id):
                return None
            self._audit("arm", screen=screen, arm=arm, plan_id=plan_id, id=header.id)
            message = Arm(header, arm, plan_id, challenge_ns(), pressed=True, segments=SEGMENTS)
            answer = await self.aside(lambda message=message: self._connection.command(ARM, message, arm))
            if answer.code != UNKNOWN_PLAN or monotonic_s() > deadline_s:
                return answer
            await asyncio.sleep(AGAIN_S)

    def hold(self, arm: str) -> "asyncio.Future[CommandAnswer]":
        """Have an arm hold, from now on; its answer."""
        return self._holds.say(arm)
