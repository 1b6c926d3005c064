"""What goes on beside a grasp: how the rig fares, the recording, and the list of an experiment."""

import asyncio
import contextlib
from typing import Any

from agents.operator.arming import Commands
from agents.operator.choosing import Choosing
from agents.operator.field_state import FieldState
from agents.operator.surroundings import Surroundings
from agents.operator.words import Voice

EVERY_S = 0.5


Finished = dict[str, tuple[dict[str, Any], float | None]]


def left_to_judge(finished: Finished, arm: str, goal_id: str) -> Finished:
    """What is left once a plan for a goal has come: one for the same goal, after a miss, leaves that miss."""
    return {a: (plan, took_s) for a, (plan, took_s) in finished.items() if a != arm or plan["goal_id"] == goal_id}


class RigPanels:
    """Asks from time to time, and begins and ends what it is told to.

    Fields:
        told: for every page.
        finished: plan as drawn and duration of what each arm has carried out and nobody has judged yet.
    """

    def __init__(self, around: Surroundings, field: FieldState, commands: Commands, voice: Voice) -> None:
        self._around, self._field, self._commands, self._voice = around, field, commands, voice
        self.told: dict[str, Any] = {"wellbeing": {}, "recording": {}, "trials": {}}
        self.finished: Finished = {}

    async def run(self) -> None:
        """Until cancelled."""
        around = self._around
        asked = {"wellbeing": around.wellbeing}
        asked |= {} if around.recording is None else {"recording": around.recording.told}
        asked |= {} if around.trials is None else {"trials": around.trials.told}
        while True:
            for name, ask in asked.items():
                with contextlib.suppress(RuntimeError):
                    self.told[name] = await self._commands.aside(ask)
            await self._commands.aside(self._field.take_observations)
            self._voice.changed.set()
            await asyncio.sleep(EVERY_S)

    async def record(self, screen: str, on: bool) -> None:
        """Begin or end a recording."""
        recording = self._around.recording
        if recording is None or not self._voice.written(screen, "recording", on=on):
            return
        why = await self._commands.aside(lambda: recording.set(on))
        self._voice.say(why or ("A recording has begun." if on else "The recording has ended."))

    async def go_on(self, screen: str, arm: str, choosing: Choosing) -> None:
        """The next goal of the list."""
        trials = self._around.trials
        if trials is None:
            self._voice.refuse(screen, "there is no list: start the page with --experiment")
            return
        try:
            s, policy = await self._commands.aside(trials.begin)
        except RuntimeError as error:
            self._voice.refuse(screen, str(error))
            return
        self.finished.pop(arm, None)
        planning = choosing.placed(screen, arm, policy, s)
        if planning is not None:
            await planning

    async def judge(self, screen: str, held: bool, cause: str, note: str) -> None:
        """Whether the grasp that has finished held."""
        trials, voice = self._around.trials, self._voice
        arm, (plan, took_s) = next(iter(self.finished.items()), ("", ({}, None)))
        if trials is None or not plan:
            voice.refuse(screen, "nothing has finished that could be judged")
        elif voice.written(screen, "verdict", plan_id=plan["id"], held=held, cause=cause, note=note):
            try:
                voice.say(await self._commands.aside(lambda: trials.judged(plan, held, cause, note, took_s)))
                self.finished.pop(arm, None)
            except RuntimeError as error:
                voice.refuse(screen, str(error))
