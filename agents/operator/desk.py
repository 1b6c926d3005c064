"""The desk behind all pages: what they say, what follows from it, and what they are told."""

import asyncio
import contextlib
from typing import Any

from agents.operator.arming import Commands, StandingBy, Throttle
from agents.operator.choosing import Choosing
from agents.operator.control import Control, HoldNow
from agents.operator.event_handler import EventHandler
from agents.operator.field_state import FieldState
from agents.operator.load import LoadMonitor
from agents.operator.rig_panels import RigPanels
from agents.operator.screen import Screen
from agents.operator.showing import Showing
from agents.operator.subscriptions import Subscriptions
from agents.operator.surroundings import Surroundings
from agents.operator.wire import (
    Beat,
    Click,
    Give,
    GoOn,
    HoldAll,
    Judged,
    LetGo,
    Look,
    Place,
    Press,
    PromptAt,
    PullThrough,
    Record,
    Release,
    Said,
    Shown,
    Take,
    compact,
    joined,
)
from agents.operator.words import Voice, sentence
from schemas.topics import ROBOT_STATE, Topic
from shared.clock import monotonic_s
from shared.runtime.connection import Connection


async def until(event: asyncio.Event, within_s: float) -> None:
    """Wait for an event, so long at most."""
    # `asyncio.wait_for` of Python 3.11 forgets a cancellation that comes with the event, and the server would not end
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(within_s):
            await event.wait()


TURN_S, STATE_S, ENDS_S, SEEN_S = 0.01, 0.1, 2.0, 0.5
ALONE_S = 1.0
"""Between two turns without a page. What is shown is listened to for as long again after the last has gone."""


class Desk:
    """Everything but HTTP; lives in one event loop."""

    def __init__(self, connection: Connection, around: Surroundings) -> None:
        """Listen from now on; `run` does the rest."""
        self._rig, self._loop = around.rig, asyncio.get_running_loop()
        self.screens: dict[str, Screen] = {}
        self.control = Control()
        self._voice = Voice(self.screens, around.audit)
        self._commands = Commands(connection, around.audit)
        self._subscriptions = Subscriptions(connection, self._wake)
        self.field = FieldState(self._subscriptions, around)
        self._load = LoadMonitor(around.processors)
        self._showing = Showing(self.field, self.screens, self._commands.aside, self._controls, self._load)
        self._choosing = Choosing(self.field, self._commands, self._voice)
        self._rig_panels = RigPanels(around, self.field, self._commands, self._voice)
        field = self.field
        self._standing_by = StandingBy(
            self.control, self._commands, self._voice, field.newest_challenge, field.pull_bounds
        )
        self._hold_throttle = Throttle(self._loop.call_later)
        self._events = EventHandler(
            self.field, self.control, self._choosing, self._rig_panels, self._standing_by, self._voice
        )
        self._turning = asyncio.Event()
        self._has_trials = around.trials is not None

    async def run(self) -> None:
        """Until cancelled; whoever presses then is let go of."""
        try:
            async with asyncio.TaskGroup() as group:
                for work in (
                    self._turns(),
                    self._states(),
                    self._rig_panels.run(),
                    self._showing.run(),
                    self._resting(),
                ):
                    group.create_task(work)
        finally:
            for screen in list(self.control.screens):
                self._standing_by.follow(self.control.leave(screen, "the page's server ends"))
            await self._standing_by.finish(ENDS_S)
            self._commands.close()
            self._subscriptions.rest(unless=lambda: False)

    def join(self, screen: Screen) -> None:
        """A page has come."""
        self.screens[screen.name] = screen
        self._subscriptions.attend()
        for arm in self.field.arms():
            self._commands.prepare(arm)
        self._standing_by.follow(self.control.join(screen.name))
        self._showing.ready()
        self._turning.set()
        self._voice.changed.set()

    def leave(self, name: str) -> None:
        """A page is gone."""
        self.screens.pop(name, None)
        self._standing_by.follow(self.control.leave(name))

    def take(self, name: str, said: Said) -> None:
        """What a page says; some of it needs no control."""
        now_s, screen, follow = monotonic_s(), self.screens[name], self._standing_by.follow
        match said:
            case Beat(challenge):
                follow(self.control.beat(name, challenge, now_s))
            case Shown():
                self._showing.shown(screen, said)
            case Release(why):
                follow(self.control.release(name, why))
            case HoldAll():
                self._hold_throttle.do(name, lambda: self._hold_all(name))
            case Look():
                screen.look = said
            case Take():
                follow(self.control.take(name, now_s))
            case Give(yes):
                follow(self.control.give(name, yes))
            case _ if name != self.control.controller:
                self._voice.refuse(name, f"{self.control.controller or 'nobody'} controls; ask for control first")
            case Press(arm, plan_id):
                self._press(name, arm, plan_id, now_s)
            case _:
                self._in_control(name, said)

    def _controls(self, name: str) -> bool:
        return name == self.control.controller

    def _in_control(self, name: str, said: Said) -> None:
        if self.control.press is not None and not isinstance(said, Record):
            self._voice.refuse(name, "let go of the button first")
            return
        start, choosing, panels = self._standing_by.start, self._choosing, self._rig_panels
        match said:
            case Click() if planning := choosing.clicked(name, said):
                start(planning)
            case Place(s, arm, policy) if planning := choosing.placed(name, arm, policy, s):
                start(planning)
            case PullThrough() if planning := choosing.pulled(name, said):
                start(planning)
            case LetGo(arm) if planning := choosing.let_go(name, arm):
                start(planning)
            case PromptAt(pixel):
                start(choosing.prompt(name, pixel))
            case Record(on):
                start(panels.record(name, on))
            case GoOn(arm):
                start(panels.go_on(name, arm, choosing))
            case Judged(held, cause, note):
                start(panels.judge(name, held, cause, note))
            case _:
                pass

    def _press(self, name: str, arm: str, plan_id: str, now_s: float) -> None:
        plan = self.field.plans.get(arm)
        if plan is None or not plan["ok"] or plan["id"] != plan_id:
            self._voice.refuse(name, f"that is not the newest plan for {arm}; look at the new one first")
        elif self.field.is_done(plan):
            self._voice.refuse(name, f"{arm} has carried out that plan; name a goal again")
        elif not self.field.newest_challenge(arm):
            unasked = f"the bridge of {arm} tells no challenges that a press could answer"
            self._voice.refuse(name, f"{unasked}: start it anew with this version")
        elif self._voice.written(name, "pressed", arm=arm, plan_id=plan_id):
            self._standing_by.follow(self.control.begin(name, arm, plan_id, now_s))
            self._turning.set()

    def _hold_all(self, name: str) -> None:
        """Stopping needs neither control nor a log that can be written."""
        press, why = self.control.press, f"{name} said hold"
        effects = self.control.release(press.screen, why) if press else []
        told = {effect.arm for effect in effects if isinstance(effect, HoldNow)}
        arms = [HoldNow(name, arm, why) for arm in self.field.arms() if arm not in told]
        self._standing_by.follow([*effects, *arms])

    def _turn(self) -> None:
        now_s, control = monotonic_s(), self.control
        self._standing_by.follow(control.turn(now_s))
        if control.press is None:
            return
        state, _ = self.field.states.get(control.press.arm, (None, 0))
        if state is not None:
            control.challenged(state.arm, state.challenge_ns, state.guard_challenge)
        due = control.challenge(now_s)
        if due is not None and due.screen in self.screens:
            sight = self.field.sight(control.press.arm, due.challenge_ns or None)
            asked = {"kind": "challenge", "challenge": due.text} | sight
            control.withdraw(self.screens[due.screen].ask(due.text, asked))

    async def _turns(self) -> None:
        while True:
            self._turn()
            if self.control.press is None:
                self._turning.clear()
                await until(self._turning, STATE_S if self.screens else ALONE_S)
            else:
                await asyncio.sleep(TURN_S)

    async def _states(self) -> None:
        while True:
            await until(self._voice.changed, 2 * STATE_S if self.screens else ALONE_S)
            self._voice.changed.clear()
            self.field.take_states()
            # where pictures go out, the thread is drawn for them
            self.field.take_thread(SEEN_S)
            shared = {key: compact(told) for key, told in self._shared().items()}
            for screen in list(self.screens.values()):
                screen.tell_state(joined(self._own(screen), shared))
                for arm, plan in self.field.plans.items():
                    if screen.plans.get(arm) != plan["id"]:
                        screen.plans[arm] = plan["id"]
                        screen.say({"kind": "plan", "plan": plan})
            await asyncio.sleep(STATE_S)

    async def _resting(self) -> None:
        """Nothing is listened to for pages that have gone; one that is loaded anew is back before."""
        while True:
            await asyncio.sleep(ALONE_S)
            if not self.screens:
                await asyncio.sleep(ALONE_S)
                await asyncio.to_thread(self._subscriptions.rest, lambda: bool(self.screens))

    def _shared(self) -> dict[str, Any]:
        control, press, field = self.control, self.control.press, self.field
        pressed = press and {"screen": press.screen, "arm": press.arm, "stage": press.stage.value}
        return {
            "rig": self._rig,
            "full": self._load.full,
            "controller": control.controller,
            "asking": control.asking,
            "screens": list(self.screens),
            "arms": field.arms_told(),
            "press": pressed,
            "goals": self._choosing.goals,
            "plan_ids": {arm: plan["id"] for arm, plan in field.plans.items()},
            "done": field.done,
            "judgements": field.judgements,
            "checks": field.checks,
            "to_judge": bool(self._rig_panels.finished) and self._has_trials,
            "lines": self._voice.lines,
            **self._rig_panels.told,
        }

    def _own(self, screen: Screen) -> dict[str, Any]:
        words = {a: sentence(screen.name, self.control, a, self.field.seen(a)) for a in self.field.arms()}
        behind = None if screen.behind_ms is None else round(screen.behind_ms)
        return {"kind": "state", "you": screen.name, "words": words, "behind_ms": behind, "level": screen.pace.level}

    def _wake(self, topic: Topic) -> None:
        """From Zenoh's threads."""
        if topic is ROBOT_STATE and self.control.press is None:
            # a state is looked at when it is shown; while somebody presses it is a challenge, which waits for nothing
            return
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._woken, topic)

    def _woken(self, topic: Topic) -> None:
        if topic is ROBOT_STATE:
            self.field.take_states()
            self._turn()
            return
        self._showing.woken(topic)
        for _, message in self._subscriptions.events():
            self._events.take(message)
            self._voice.changed.set()
