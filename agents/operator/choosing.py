"""Goals: from a click, a place or an experiment's list to a plan, and which thread is meant.

A click becomes a place on the thread: the nearest one, and any other strand that is about as near.
"""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from agents.operator.arming import POLICIES, Commands
from agents.operator.drawn import DrawnThread
from agents.operator.field_state import FieldState
from agents.operator.wire import Click, PullThrough
from agents.operator.words import Voice
from schemas.messages import CommandAnswer, Outcome
from shared.clock import monotonic_s
from shared.runtime.commands import refused

WITHIN_PX = 60.0
"""Of an image 960 pixels wide; a click farther off names nothing."""
ALSO_PX = 14.0
"""Strands so much farther than the nearest are told too."""
APART = 0.03
"""Share of the length that lies between two strands; nearer places are one."""
IMAGE_WIDTH = 960.0


@dataclass(frozen=True)
class Snapped:
    """A place on the thread.

    Fields:
        off_px: how far from the click it is; off_mm: the same at the thread's depth, None where the unit is unknown.
        along_mm: from the thread's beginning.
    """

    s: float
    px: tuple[float, float]
    off_px: float
    off_mm: float | None
    along_mm: float
    confidence: float | None
    unseen: bool

    def document(self) -> dict[str, Any]:
        """For the page."""
        return {
            "s": round(self.s, 4),
            "px": [round(v, 1) for v in self.px],
            "off_px": round(self.off_px, 1),
            "off_mm": None if self.off_mm is None else round(self.off_mm, 2),
            "along_mm": round(self.along_mm, 1),
            "confidence": None if self.confidence is None else round(self.confidence, 3),
            "unseen": self.unseen,
        }


def snapped(thread: DrawnThread, pixel: tuple[float, float]) -> list[Snapped]:
    """The places of the thread that a click may mean, the nearest first; none where it is far from all of it.

    Each is nearer than what lies beside it on its strand.
    """
    scale = thread.camera.image_width / IMAGE_WIDTH
    place, off_px = _feet(thread.px, np.array(pixel))
    beside = np.pad(off_px, 1, constant_values=np.inf)
    strands = np.flatnonzero((off_px <= beside[:-2]) & (off_px <= beside[2:]))
    order = strands[np.argsort(off_px[strands])]
    nearest = float(off_px[order[0]])
    if not nearest <= WITHIN_PX * scale:
        return []
    found: list[Snapped] = []
    for i in order.tolist():
        if off_px[i] > nearest + ALSO_PX * scale:
            break
        s = float(place[i]) / (len(thread.along) - 1)
        if all(abs(s - other.s) > APART for other in found):
            found.append(_at(thread, float(place[i]), float(off_px[i])))
    return found


def at_place(thread: DrawnThread, s: float) -> Snapped:
    """A place that was named by s."""
    return _at(thread, s * (len(thread.along) - 1), 0.0)


def _at(thread: DrawnThread, place: float, off_px: float) -> Snapped:
    indices = np.arange(len(thread.along))
    s = float(np.interp(place, indices, thread.along))
    u, v = (float(np.interp(place, indices, thread.px[:, k])) for k in (0, 1))
    depth_mm = float(np.interp(place, indices, thread.points_mm[:, 2]))
    confidence = float(np.interp(place, indices, thread.confidence))
    return Snapped(
        s=s,
        px=(u, v),
        off_px=off_px,
        off_mm=None if thread.to_mm is None else off_px * depth_mm / thread.camera.fx_px,
        along_mm=s * thread.length_mm,
        confidence=confidence if np.isfinite(confidence) else None,
        unseen=bool(thread.unseen[round(place)]),
    )


def _feet(
    line_px: Float64[np.ndarray, "n 2"], pixel: Float64[np.ndarray, "2"]
) -> tuple[Float64[np.ndarray, "m"], Float64[np.ndarray, "m"]]:
    """On each piece of a line the place nearest to a pixel, counted in pieces, and how far it is."""
    start, step = line_px[:-1], np.diff(line_px, axis=0)
    squared = (step**2).sum(axis=1)
    share = np.clip(((pixel - start) * step).sum(axis=1) / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
    off_px = np.linalg.norm(start + share[:, None] * step - pixel, axis=1)
    return np.arange(len(step)) + share, off_px


PASSING = ("no_thread", "thread_stale", "arm_stale")
"""What speaks against the moment alone, while the thread is the one that a person looked at: then the same goal may be
asked for again. All else needs another look: where the thread was found anew, s may name another place."""
AGAIN_S, AGAIN_FOR_S = 0.15, 3.0
FOUND_ANEW = "the thread was found anew, so that s may name another place now: look again, then name the goal anew"

Awaiting = Coroutine[Any, Any, None] | None
Asking = Callable[[], Coroutine[Any, Any, tuple[str, CommandAnswer]]]


class Choosing:
    """The goal of each arm.

    Fields:
        goals: as pages show them, by arm; `text` says what is still awaited, or why there is no plan.
    """

    def __init__(self, field: FieldState, commands: Commands, voice: Voice) -> None:
        self._field, self._commands, self._voice = field, commands, voice
        self.goals: dict[str, dict[str, Any]] = {}

    def clicked(self, screen: str, said: Click) -> Awaiting:
        """A goal at the thread's place nearest to a click, on the thread that the page showed; what is then to do."""
        thread = self._field.threads.get(said.frame) or self._field.thread
        found = [] if thread is None else snapped(thread, said.pixel)
        if thread is not None and thread.found != self._field.found:
            self._voice.refuse(screen, FOUND_ANEW)
            return None
        if found:
            return self._choose(screen, said.arm, said.policy, found)
        self._voice.refuse(screen, "no thread is near that place; click on the thread")
        return None

    def placed(self, screen: str, arm: str, policy: str, s: float) -> Awaiting:
        """A goal at s; what is then to do."""
        if self._field.thread is not None and 0 <= s <= 1:
            return self._choose(screen, arm, policy, [at_place(self._field.thread, s)])
        self._voice.refuse(screen, "there is no such place on a thread that is seen now")
        return None

    def pulled(self, screen: str, said: PullThrough) -> Awaiting:
        """A goal that thread is pulled through, by the exit in the image that the page showed; what is then to do."""
        thread = self._field.threads.get(said.frame)
        if thread is not None and thread.found != self._field.found:
            self._voice.refuse(screen, FOUND_ANEW)
            return None
        return self._pull(screen, said.arm, said.tail_mm, said.exit_pixel)

    def let_go(self, screen: str, arm: str) -> Awaiting:
        """A goal that jaws let go of thread; what is then to do."""
        return self._pull(screen, arm, None, None)

    def _pull(self, screen: str, arm: str, tail_mm: float | None, exit_pixel: tuple[float, float] | None) -> Awaiting:
        voice = self._voice
        if arm not in self._field.arms():
            voice.refuse(screen, "there is no such arm")
            return None
        if not voice.written(screen, "pull", arm=arm, tail_mm=tail_mm, exit_pixel=exit_pixel):
            return None
        at = None if exit_pixel is None else {"px": exit_pixel}
        goal = {"at": None, "exit": at, "tail_mm": tail_mm, "others": [], "text": "Planning ...", "goal_id": ""}
        return self._begin(goal, arm, lambda: self._commands.pull(arm, tail_mm, exit_pixel))

    async def prompt(self, screen: str, pixel: tuple[float, float] | None) -> None:
        """Say which thread is meant."""
        voice = self._voice
        if not voice.written(screen, "prompt", pixel=pixel):
            return
        voice.say(
            "Telling perception which thread is meant." if pixel else "Telling perception that any thread will do."
        )
        answer = await self._commands.prompt(None if pixel is None else np.array(pixel))
        accepted = answer.outcome is Outcome.ACCEPTED
        voice.say("Perception has heard it." if accepted else f"Perception refused: {answer.reason}")

    def planned(self, arm: str, goal_id: str) -> None:
        """A plan, or a rejection, has come for a goal."""
        goal = self.goals.get(arm)
        if goal is not None and goal["goal_id"] in ("", goal_id):
            goal |= {"text": "", "goal_id": goal_id}

    def _choose(self, screen: str, arm: str, policy: str, found: list[Snapped]) -> Awaiting:
        voice = self._voice
        if arm not in self._field.arms() or policy not in POLICIES:
            voice.refuse(screen, "there is no such arm or policy")
            return None
        if not voice.written(screen, "goal", arm=arm, s=round(found[0].s, 4), policy=policy):
            return None
        others = [each.document() for each in found[1:]]
        goal = {"at": found[0].document(), "others": others, "policy": policy, "text": "Planning ...", "goal_id": ""}
        return self._begin(goal, arm, lambda: self._commands.goal(arm, policy, found[0].s))

    def _begin(self, goal: dict[str, Any], arm: str, ask: Asking) -> Awaiting:
        self.goals[arm] = goal
        # from now on nobody is to arm the plan of another goal
        self._field.plans.pop(arm, None)
        self._voice.changed.set()
        return self._plan(goal, arm, ask)

    async def _plan(self, goal: dict[str, Any], arm: str, ask: Asking) -> None:
        voice = self._voice
        goal_id, answer = await self._asked(goal, arm, ask)
        if self.goals[arm] is not goal:
            return
        if answer.outcome is not Outcome.ACCEPTED:
            goal["text"] = f"No plan: {answer.reason}"
            voice.say(f"The planner refused: {answer.reason}")
        elif not goal["goal_id"]:
            goal["goal_id"] = goal_id
        voice.changed.set()

    async def _asked(self, goal: dict[str, Any], arm: str, ask: Asking) -> tuple[str, CommandAnswer]:
        """The planner's answer; what only speaks against the moment is asked again for a while."""
        deadline_s, found = monotonic_s() + AGAIN_FOR_S, self._field.found
        while True:
            goal_id, answer = await ask()
            if answer.code not in PASSING or monotonic_s() > deadline_s or self.goals[arm] is not goal:
                return goal_id, answer
            goal["text"] = f"Planning ... ({answer.reason})"
            self._voice.changed.set()
            await asyncio.sleep(AGAIN_S)
            self._field.take_thread(0.0)
            if self._field.found != found:
                return goal_id, refused(goal_id, "thread_restarted", FOUND_ANEW)
