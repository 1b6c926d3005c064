"""What follows from the state of control: arming, heartbeats and holds, each written down."""

import asyncio
import functools
from collections.abc import Callable, Coroutine
from typing import Any

from agents.operator.carrying_out import Commands
from agents.operator.control import ArmNow, BeatNow, Control, Effect, HoldNow, Noted
from agents.operator.voice import Voice
from schemas.messages import CommandAnswer, Outcome
from shared.clock import monotonic_s


class StandingBy:
    """Carries out the effects of one `Control`.

    Fields:
        armed_s: when each arming was accepted, by its id.
        holds: why each arm was told to hold last.
    """

    def __init__(
        self, control: Control, commands: Commands, voice: Voice, newest_challenge: Callable[[str], int]
    ) -> None:
        """`newest_challenge` is that of an arm's bridge which was heard."""
        self._control, self._commands, self._voice = control, commands, voice
        self._newest_challenge = newest_challenge
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
            answer = await self._commands.arm(screen, arm, plan_id, begins, newest)
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
