"""What the page is doing, in words that a screen reader can read out.

What the desk says: lines for every page, refusals for one, and what is written down for good.
"""

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from agents.operator.control import ASKED_S, Control, Stage
from agents.operator.screen import Screen
from schemas.messages import ExecutionEvent, RobotMode, RobotState, ToolCorrection, ToolStatus
from shared.execution_words import event_told

STALE_S = 1.0
OLD_PLAN_S = 25.0
"""The bridge refuses plans from frames older than 30 s."""

MODES = {
    RobotMode.DISABLED.name.lower(): "is disabled",
    RobotMode.IDLE.name.lower(): "is ready",
    RobotMode.MOVING.name.lower(): "carries out its plan",
    RobotMode.HOLDING.name.lower(): "holds",
    RobotMode.FAULT.name.lower(): "has a fault",
}
OUT_OF_ORDER = (RobotMode.FAULT.name.lower(), RobotMode.DISABLED.name.lower())


@dataclass(frozen=True)
class Seen:
    """What a sentence is made of, for the arm that a page looks at.

    Fields:
        frame_age_s, thread_age_s: since the newest came; None where none did.
        plan: as drawn; plan_age_s: since its frame.
        why: the last reason for which the arm was refused or held; empty where there was none.
        done: the plan has been carried out; refused: arming it was, last.
    """

    frame_age_s: float | None
    thread_age_s: float | None
    mode: str
    plan: dict[str, Any] | None
    plan_age_s: float | None
    said: str
    why: str = ""
    done: bool = False
    refused: bool = False


def sentence(screen: str, control: Control, arm: str, seen: Seen) -> str:
    """What is going on, and what can be done next."""
    press = control.press
    if press is not None:
        if press.stage is Stage.ARMED:
            whose = "while you keep the button pressed" if press.screen == screen else f"while {press.screen} presses"
            pulls = seen.plan is not None and seen.plan["arm"] == press.arm and seen.plan["pull"]
            does = f"pulls ({_in_short(pulls)})" if pulls else "carries out its plan"
            return f"{press.arm} {does} {whose}. Let go and it holds."
        if press.stage is Stage.ARMING:
            return f"{press.arm} is being armed."
        return "Keep the button pressed to arm." if press.screen == screen else f"{press.screen} presses to arm."
    if seen.frame_age_s is None or seen.frame_age_s > STALE_S:
        return "No image comes." if seen.frame_age_s is None else f"The image is {seen.frame_age_s:.0f} s old."
    if control.asking and screen == control.controller:
        asks = f"{control.asking} asks for control. Hand it over, or keep it"
        return f"{asks}; without an answer within {ASKED_S:.0f} s it passes on."
    if seen.mode in OUT_OF_ORDER:
        last = f" ({seen.why})" if seen.why else ""
        return (
            f"{arm} {MODES[seen.mode]} and cannot be armed{last}. See to it at its console, or with suturegrasp state."
        )
    if screen != control.controller:
        asked = f"You asked {control.controller} for control" if control.asking == screen else "You watch"
        return f"{asked}; {control.controller or 'nobody'} controls. Hold works for everybody."
    if seen.done:
        pulled = f": {_in_short(seen.plan['pull'])}" if seen.plan is not None and seen.plan["pull"] else ""
        return f"{arm} has carried out its plan{pulled}. Click the thread for the next goal."
    if seen.plan is not None and seen.plan["ok"]:
        if seen.plan_age_s is not None and seen.plan_age_s > OLD_PLAN_S:
            return "The plan is too old to be armed. Plan again."
        why = f"{arm} holds: {seen.why}. " if seen.mode == "holding" and seen.why else ""
        if seen.plan["continues"]:
            first = "Let go of the thread, then name a goal again." if seen.plan["pull"] else "Name a goal again."
            return f"{why}What was under way has ended. {first}"
        if seen.refused and seen.why:
            why = f"{arm} was not armed: {seen.why}. "
        return f"{why}{plan_words(seen.plan)} Look at it, then press and hold to arm {arm}."
    if seen.thread_age_s is None or seen.thread_age_s > STALE_S:
        if seen.said or seen.thread_age_s is None:
            return f"No thread is seen: {seen.said}." if seen.said else "No thread has been seen yet."
        return f"The thread was seen {seen.thread_age_s:.0f} s ago; frames wait for perception."
    if seen.plan is not None:
        what = "pull" if seen.plan["id"].startswith("pull-") else "grasp"
        return f"No {what} is planned: {seen.plan['reason']}. Click another place."
    return f"{arm} is {seen.mode or 'silent'}. Click the thread where it is to be grasped."


def plan_words(plan: dict[str, Any]) -> str:
    """A plan in one sentence."""
    if plan["pull"]:
        # its figures, and what it is armed for, stand beside the button, which long sentences would move
        return f"Planned: {_in_short(plan['pull'])}."
    where = f"grasp at {_percent(plan['s_goal'])}"
    if plan["slide_mm"] > 0:
        where = f"capture at {_percent(plan['s_capture'])}, slide {plan['slide_mm']:.0f} mm, {where}"
    again = f"Attempt {plan['attempt']} of {plan['attempts']}" if plan["attempt"] > 1 else "Planned"
    return f"{again}: {where}; success {plan['probability']:.0%}."


def _in_short(sentence: str) -> str:
    """A sentence of a pull without what it was judged by."""
    return sentence.split(";")[0]


def arm_words(mode: str, why: str, state: RobotState | None, tool: ToolCorrection | None) -> str:
    """What an arm is doing, and how its tool stands to where registration has it."""
    if state is None or not mode:
        return "has not been heard lately"
    told = MODES[mode]
    if why and mode in ("holding", *OUT_OF_ORDER):
        told += f": {why}"
    return told if tool is None else f"{told}; {tool_words(tool, state.T_camera_base_registered is not None)}"


def tool_words(tool: ToolCorrection, corrected: bool) -> str:
    """Where the images have an arm's tool."""
    if tool.status is not ToolStatus.CONVERGED or tool.T_correction is None:
        doing = "lost" if tool.status is ToolStatus.LOST else "looked for"
        return f"its tool is {doing} in the images{f' ({tool.reason})' if tool.reason else ''}"
    off = f"{1e3 * tool.tip_off_m:.1f} mm off its registration, give or take {1e3 * tool.tip_deviation_m:.1f}"
    return f"by the images its tool is {off}, which is {'corrected' if corrected else 'not corrected'}"


def event_words(event: ExecutionEvent) -> str:
    """An event of an execution."""
    return f"{event_told(event)}."


def _percent(s: float | None) -> str:
    return "?" if s is None else f"{s:.0%}"


LINES_KEPT = 12
_log = logging.getLogger("suturegrasp.operator")


class Voice:
    """Says things, and notes that something has changed.

    Fields:
        lines: the newest, for every page.
        changed: set where pages are to be told anew.
    """

    def __init__(self, screens: dict[str, Screen], audit: Callable[..., None]) -> None:
        self._screens, self._audit = screens, audit
        self.lines: list[str] = []
        self.changed = asyncio.Event()

    def say(self, line: str) -> None:
        """To every page."""
        self.lines = [*self.lines, line][-LINES_KEPT:]
        self.changed.set()

    def refuse(self, screen: str, text: str) -> None:
        """To one page."""
        if screen in self._screens:
            self._screens[screen].say({"kind": "refused", "text": text})

    def written(self, screen: str, what: str, **told: Any) -> bool:
        """Whether it could be written down; where not, nothing but stopping follows from it."""
        try:
            self._audit(what, screen=screen, **told)
        except RuntimeError as error:
            _log.error("%s", error)
            self.refuse(screen, str(error))
            return False
        return True

    def failed(self, error: BaseException) -> None:
        """Something that should not happen."""
        _log.error("a command of the page failed", exc_info=error)
        self.say(f"Something failed: {error}")
