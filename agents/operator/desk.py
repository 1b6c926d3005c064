"""The desk behind all pages: what they say, what follows from it, and what they are shown."""

import asyncio
import contextlib
import json
import logging
from collections.abc import Coroutine
from typing import Any

import numpy as np

from agents.operator.carrying_out import Commands
from agents.operator.control import ArmNow, BeatNow, Control, Effect, HoldNow, Noted
from agents.operator.field_seen import FieldSeen
from agents.operator.heard import Heard
from agents.operator.screen import Screen
from agents.operator.showing import Showing
from agents.operator.snapping import Snapped, at_place, snapped
from agents.operator.surroundings import Surroundings
from agents.operator.wire import (
    Beat,
    Click,
    Give,
    GoOn,
    HoldAll,
    Judged,
    Look,
    Place,
    Press,
    PromptAt,
    Record,
    Release,
    Said,
    Shown,
    Take,
)
from agents.operator.words import event_words, sentence
from schemas.messages import ExecutionEvent, ExecutionKind, GraspJudgement, GraspPlan, LogLevel, LogRecord, Outcome
from schemas.topics import Topic
from shared.clock import monotonic_s, now_ns
from shared.runtime.connection import Connection

TURN_S, STATE_S, ASIDE_S = 0.01, 0.2, 0.5
LINES_KEPT = 40
POLICIES = ("robust", "direct")
ENDS = (ExecutionKind.FINISHED, ExecutionKind.HELD, ExecutionKind.REFUSED)
_log = logging.getLogger("suturegrasp.operator")


class Desk:
    """Everything but HTTP; lives in one event loop."""

    def __init__(self, connection: Connection, around: Surroundings) -> None:
        """Listen from now on; `run` does the rest."""
        self._around, self._loop = around, asyncio.get_running_loop()
        self.screens: dict[str, Screen] = {}
        self.control = Control()
        self._commands = Commands(connection, around.audit)
        self._heard = Heard(connection, self._wake)
        self.field = FieldSeen(self._heard, around)
        self.showing = Showing(self.field, self.screens, self._commands.aside)
        self._goals: dict[str, dict[str, Any]] = {}
        self._asked: dict[str, str] = {}
        self._lines: list[str] = []
        self._wellbeing: dict[str, Any] = {}
        self._recording: dict[str, Any] = {}
        self._trials: dict[str, Any] = {}
        self._verdicts: dict[str, str] = {}
        self._finished: dict[str, tuple[str, float | None]] = {}
        self._armed_s: dict[str, float] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._dirty = asyncio.Event()

    async def run(self) -> None:
        """Until cancelled."""
        try:
            async with asyncio.TaskGroup() as group:
                for work in (self._turns(), self._states(), self._aside(), self.showing.run()):
                    group.create_task(work)
        finally:
            for screen in list(self.screens):
                self._follow(self.control.leave(screen, "the page's server ends"))
            if self._tasks:
                await asyncio.wait(self._tasks, timeout=2.0)
            self._commands.close()

    def join(self, screen: Screen) -> None:
        """A page has come."""
        self.screens[screen.name] = screen
        for arm in self.field.arms():
            self._commands.prepare(arm)
        self._follow(self.control.join(screen.name))
        self.showing.ready()

    def leave(self, name: str) -> None:
        """A page is gone."""
        self.screens.pop(name, None)
        self._follow(self.control.leave(name))

    def take(self, name: str, said: Said) -> None:
        """What a page says."""
        now_s, screen = monotonic_s(), self.screens[name]
        match said:
            case Beat(challenge):
                self._follow(self.control.beat(name, challenge, now_s))
            case Shown():
                self.showing.shown(screen, said)
            case Release(why):
                self._follow(self.control.release(name, why))
            case HoldAll():
                self._hold_all(name)
            case Look():
                screen.look = said
            case Take():
                self._follow(self.control.take(name, now_s))
            case Give(yes):
                self._follow(self.control.give(name, yes))
            case Press(arm, plan_id):
                self._press(name, arm, plan_id, now_s)
            case _:
                self._if_in_control(name, said)

    def _if_in_control(self, name: str, said: Said) -> None:
        if name != self.control.controller:
            self._refuse(name, f"{self.control.controller or 'nobody'} controls; ask for control first")
            return
        match said:
            case Click():
                self._clicked(name, said)
            case Place(s, arm, policy):
                if self.field.thread is not None and 0 <= s <= 1:
                    self._choose(name, arm, policy, [at_place(self.field.thread, s)])
            case PromptAt(pixel):
                self._start(self._prompt(name, pixel))
            case Record(on):
                self._start(self._record(name, on))
            case GoOn(arm):
                self._start(self._go_on(name, arm))
            case Judged(held, cause, note):
                self._start(self._judge(name, held, cause, note))
            case _:
                pass

    def _press(self, name: str, arm: str, plan_id: str, now_s: float) -> None:
        plan = self.field.plans.get(arm)
        if plan is None or not plan["ok"] or plan["id"] != plan_id:
            self._refuse(name, f"that is not the newest plan for {arm}; look at the new one first")
        elif self._written(name, "press", arm=arm, plan_id=plan_id):
            self._follow(self.control.begin(name, arm, plan_id, now_s))

    def _hold_all(self, name: str) -> None:
        """Stopping needs no control, and no log that can be written."""
        self._follow(self.control.release(self.control.press.screen, "hold") if self.control.press else [])
        for arm in self.field.arms():
            self._follow([HoldNow(name, arm, f"{name} said hold")])

    def _clicked(self, name: str, said: Click) -> None:
        thread = self.field.threads.get(said.frame) or self.field.thread
        found = [] if thread is None else snapped(thread, said.pixel)
        if found:
            self._choose(name, said.arm, said.policy, found)
        else:
            self._refuse(name, "no thread is near that place; click on the thread")

    def _choose(self, name: str, arm: str, policy: str, found: list[Snapped]) -> None:
        if arm not in self.field.arms() or policy not in POLICIES:
            self._refuse(name, "there is no such arm or policy")
        elif self.control.press is not None:
            self._refuse(name, "no other goal is chosen while the button is pressed")
        else:
            others = [each.document() for each in found[1:]]
            self._goals[arm] = {"at": found[0].document(), "others": others, "policy": policy, "text": "asking ..."}
            self._changed()
            self._start(self._plan(name, arm, policy, found[0].s))

    async def _plan(self, name: str, arm: str, policy: str, s: float) -> None:
        if not self._written(name, "goal", arm=arm, s=round(s, 4), policy=policy):
            return
        goal_id, answer = await self._commands.goal(arm, policy, s)
        refused = answer.outcome is not Outcome.ACCEPTED
        self._asked[arm] = goal_id
        if arm in self._goals:
            self._goals[arm]["text"] = f"not planned: {answer.reason}" if refused else ""
        if refused:
            self._say(f"The planner refused: {answer.reason}")
        self._changed()

    async def _prompt(self, name: str, pixel: tuple[float, float] | None) -> None:
        if not self._written(name, "prompt", pixel=pixel):
            return
        self._say(
            "Telling perception which thread is meant." if pixel else "Telling perception that any thread will do."
        )
        answer = await self._commands.prompt(None if pixel is None else np.array(pixel))
        accepted = answer.outcome is Outcome.ACCEPTED
        self._say("Perception knows which thread is meant." if accepted else f"Perception refused: {answer.reason}")

    async def _record(self, name: str, on: bool) -> None:
        recording = self._around.recording
        if recording is None or not self._written(name, "recording", on=on):
            return
        why = await self._commands.aside(lambda: recording.set(on))
        self._say(why or ("A recording has begun." if on else "The recording has ended."))

    async def _go_on(self, name: str, arm: str) -> None:
        trials, thread = self._around.trials, self.field.thread
        if trials is None or thread is None:
            return
        try:
            s, policy = await self._commands.aside(trials.begin)
        except RuntimeError as error:
            self._refuse(name, str(error))
            return
        self._finished.pop(arm, None)
        self._choose(name, arm, policy, [at_place(thread, s)])

    async def _judge(self, name: str, held: bool, cause: str, note: str) -> None:
        trials = self._around.trials
        arm, (plan_id, took_s) = next(iter(self._finished.items()), ("", ("", None)))
        plan = self.field.plans.get(arm)
        if trials is None or plan is None or plan["id"] != plan_id:
            self._refuse(name, "nothing has finished that could be judged")
        elif self._written(name, "verdict", plan_id=plan_id, held=held, cause=cause, note=note):
            try:
                self._say(await self._commands.aside(lambda: trials.judged(plan, held, cause, note, took_s)))
                self._finished.pop(arm, None)
            except RuntimeError as error:
                self._refuse(name, str(error))

    def _follow(self, effects: list[Effect]) -> None:
        for effect in effects:
            match effect:
                case BeatNow(arm, plan_id, arming_id):
                    self._commands.beat(arm, plan_id, arming_id)
                case HoldNow():
                    self._start(self._hold(effect))
                case ArmNow():
                    self._start(self._arm(effect))
                case Noted(screen, what, text):
                    self._note(screen, what, text)

    def _note(self, screen: str, what: str, text: str) -> None:
        if what == "refused":
            self._refuse(screen, text)
        else:
            # what releases or passes on is so whether or not it can be written down
            self._written(screen, what, text=text)
            self._say(f"{text}.")
        self._changed()

    async def _arm(self, effect: ArmNow) -> None:
        screen, arm, plan_id, sent = effect.screen, effect.arm, effect.plan_id, [""]

        def begins(arming_id: str) -> bool:
            sent[0] = arming_id
            return self.control.arming(plan_id, arming_id)

        try:
            answer = await self._commands.arm(screen, arm, plan_id, begins)
        except RuntimeError as error:
            self._refuse(screen, str(error))
            self._follow(self.control.release(screen, "it could not be written down"))
            return
        if answer is None:
            return
        accepted, unknown = answer.outcome is Outcome.ACCEPTED, answer.outcome is Outcome.UNKNOWN
        if accepted:
            self._armed_s[sent[0]] = monotonic_s()
        self._written(screen, "answer", id=sent[0], outcome=answer.outcome.name.lower(), reason=answer.reason)
        self._follow(self.control.armed(screen, arm, sent[0], accepted))
        if not accepted:
            self._say(f"{arm} was not armed: {answer.reason}")
        if unknown:
            self._follow([HoldNow(screen, arm, "whether it was armed is not known")])
        self._changed()

    async def _hold(self, effect: HoldNow) -> None:
        answer = self._commands.hold(effect.arm)
        task = asyncio.ensure_future(answer)
        await asyncio.sleep(0)
        self._written(effect.screen, "hold", arm=effect.arm, why=effect.why)
        said = await task
        self._written(effect.screen, "answer", id=said.id, outcome=said.outcome.name.lower(), reason=said.reason)
        held = said.outcome is Outcome.ACCEPTED
        self._say(f"{effect.arm} holds: {effect.why}." if held else f"{effect.arm} gave no answer: {said.reason}")

    async def _turns(self) -> None:
        while True:
            now_s = monotonic_s()
            self._follow(self.control.turn(now_s))
            if (due := self.control.challenge(now_s)) is not None and due[0] in self.screens:
                self.screens[due[0]].say({"kind": "challenge", "challenge": due[1]})
            await asyncio.sleep(TURN_S)

    async def _aside(self) -> None:
        """What is asked from time to time, in threads."""
        while True:
            around = self._around
            with contextlib.suppress(RuntimeError):
                self._wellbeing = await self._commands.aside(around.wellbeing)
                if around.recording is not None:
                    self._recording = await self._commands.aside(around.recording.told)
                if around.trials is not None:
                    self._trials = await self._commands.aside(around.trials.told)
            if not any(screen.look.observations for screen in self.screens.values()):
                await self._commands.aside(self.field.take_observations)
            self._changed()
            await asyncio.sleep(ASIDE_S)

    async def _states(self) -> None:
        while True:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._dirty.wait(), STATE_S)
            self._dirty.clear()
            self.field.take_states()
            shared = self._shared()
            for screen in list(self.screens.values()):
                screen.tell_state(json.dumps(shared | self._own(screen), separators=(",", ":")))
                for arm, plan in self.field.plans.items():
                    if screen.plans.get(arm) != plan["id"]:
                        screen.plans[arm] = plan["id"]
                        screen.say({"kind": "plan", "plan": plan})
            await asyncio.sleep(0.5 * STATE_S)

    def _shared(self) -> dict[str, Any]:
        press, field = self.control.press, self.field
        thread = field.thread
        return {
            "kind": "state",
            "rig": self._around.rig,
            "now_ms": now_ns() * 1e-6,
            "controller": self.control.controller,
            "asking": self.control.asking,
            "screens": list(self.screens),
            "arms": [{"arm": arm, "mode": field.mode(arm)} for arm in field.arms()],
            "press": None
            if press is None
            else {"screen": press.screen, "arm": press.arm, "plan_id": press.plan_id, "stage": press.stage.value},
            "goals": self._goals,
            "plan_ids": {arm: plan["id"] for arm, plan in field.plans.items()},
            "thread": None
            if thread is None
            else {"length_mm": round(thread.length_mm, 1), "mean_confidence": field.mean_confidence()},
            "judgements": field.judgements,
            "wellbeing": self._wellbeing,
            "recording": self._recording,
            "trials": self._trials,
            "to_judge": bool(self._finished) and self._around.trials is not None,
            "verdicts": self._verdicts,
            "lines": self._lines[-12:],
        }

    def _own(self, screen: Screen) -> dict[str, Any]:
        arms = self.field.arms()
        words = {arm: sentence(screen.name, self.control, arm, self.field.seen(arm)) for arm in arms}
        behind = None if screen.behind_ms is None else round(screen.behind_ms)
        return {"you": screen.name, "words": words, "behind_ms": behind, "level": screen.pace.level}

    def _wake(self, topic: Topic) -> None:
        """From Zenoh's threads."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._woken, topic)

    def _woken(self, topic: Topic) -> None:
        self.showing.woken(topic)
        for _, message in self._heard.events():
            self._event(message)

    def _event(self, message: Any) -> None:
        match message:
            case GraspPlan() if self.field.note_plan(message):
                self._finished.pop(message.arm, None)
            case ExecutionEvent() if (now_ns() - message.at_ns) * 1e-9 < ASIDE_S * 20:
                self._say(event_words(message))
                self._execution(message)
            case GraspJudgement() if (now_ns() - message.at_ns) * 1e-9 < ASIDE_S * 20:
                self._verdicts[message.arm] = message.sentence or message.verdict.name.lower()
                self._say(f"Verdict: {self._verdicts[message.arm]}")
            case LogRecord(level=LogLevel.ERROR) if (now_ns() - message.at_ns) * 1e-9 < ASIDE_S * 20:
                self._say(f"{message.agent}: {message.text.splitlines()[0]}")
            case _:
                pass
        self._changed()

    def _execution(self, event: ExecutionEvent) -> None:
        if event.kind in ENDS:
            self.control.ended(event.arming_id)
        if event.kind is ExecutionKind.FINISHED:
            began_s = self._armed_s.get(event.arming_id)
            self._finished[event.arm] = event.plan_id, None if began_s is None else monotonic_s() - began_s
        if event.kind is ExecutionKind.ACCEPTED:
            self._verdicts.pop(event.arm, None)

    def _written(self, screen: str, what: str, **told: Any) -> bool:
        """Whether a press could be written down; where not, nothing but stopping follows from it."""
        try:
            self._around.audit(what, screen=screen, **told)
        except RuntimeError as error:
            _log.error("%s", error)
            self._refuse(screen, str(error))
            return False
        return True

    def _refuse(self, screen: str, text: str) -> None:
        if screen in self.screens:
            self.screens[screen].say({"kind": "refused", "text": text})

    def _say(self, line: str) -> None:
        self._lines = [*self._lines, line][-LINES_KEPT:]
        self._changed()

    def _changed(self) -> None:
        self._dirty.set()

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._done)

    def _done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("a command of the page failed", exc_info=error)
            self._say(f"Something failed: {error}")
