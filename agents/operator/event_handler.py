"""What has happened to goals and plans, and what follows from it for the pages."""

from dataclasses import replace
from typing import Any

from agents.operator.arming import SENDER, StandingBy
from agents.operator.choosing import Choosing
from agents.operator.control import Control
from agents.operator.field_state import FieldState
from agents.operator.rig_panels import RigPanels, left_to_judge
from agents.operator.words import Voice, event_words
from schemas.messages import (
    ExecutionEvent,
    ExecutionKind,
    GraspCheck,
    GraspJudgement,
    GraspPlan,
    LogLevel,
    LogRecord,
)
from schemas.topics import ROBOT_STATE
from shared.clock import monotonic_s, now_ns

NEWS_S = 10.0
"""Older events are history that came with the connection."""
ENDS = (ExecutionKind.FINISHED, ExecutionKind.HELD, ExecutionKind.REFUSED)


class EventHandler:
    """Takes events in the order in which they came."""

    def __init__(
        self,
        field: FieldState,
        control: Control,
        choosing: Choosing,
        panels: RigPanels,
        standing_by: StandingBy,
        voice: Voice,
    ) -> None:
        self._field, self._control, self._choosing = field, control, choosing
        self._panels, self._standing_by, self._voice = panels, standing_by, voice

    def take(self, message: Any) -> None:
        """One message of a topic of events."""
        match message:
            case GraspPlan():
                if self._field.note_plan(message):
                    panels = self._panels
                    # a pull is no attempt at a grasp, and leaves what is to be judged of one
                    if message.pull is None:
                        panels.finished = left_to_judge(panels.finished, message.arm, message.goal_id)
                    self._choosing.planned(message.arm, message.goal_id)
                    self._standing_by.follow(self._control.planned(message.arm, message.plan_id))
            case GraspCheck():
                if self._field.note_check(message):
                    self._voice.say(f"Check: {message.sentence}")
            case ExecutionEvent():
                self._execution(message)
            case GraspJudgement() if self._is_news(message.at_ns):
                self._voice.say(f"Verdict: {message.sentence or message.verdict.name.lower()}")
            case LogRecord(level=LogLevel.WARNING) if message.agent == ROBOT_STATE.agent:
                self._field.note_warning(message)
                self._voice.changed.set()
            case LogRecord() if message.level is LogLevel.ERROR and self._is_news(message.at_ns):
                self._voice.say(f"{message.agent}: {message.text.splitlines()[0]}")
            case _:
                pass

    def _is_news(self, at_ns: int) -> bool:
        return (now_ns() - at_ns) * 1e-9 <= NEWS_S

    def _execution(self, event: ExecutionEvent) -> None:
        # a hold of ours was said with its reason, which the bridge does not know
        ours = event.reason == f"{SENDER} said hold" and self._standing_by.holds.get(event.arm)
        self._field.note_execution(replace(event, reason=ours) if ours else event)
        # what ends a press asks no clock
        if event.kind in ENDS:
            self._control.ended(event.arming_id)
        if event.kind is ExecutionKind.HELD:
            self._standing_by.follow(self._control.held(event.arm, event.arming_id, event.reason))
        if not self._is_news(event.at_ns):
            return
        if not ours:
            self._voice.say(event_words(event))
        plan = self._field.plans.get(event.arm)
        is_grasp = plan is not None and plan["id"] == event.plan_id and not plan["pull"]
        if event.kind is ExecutionKind.FINISHED and plan is not None and is_grasp:
            began_s = self._standing_by.armed_s.pop(event.arming_id, None)
            self._panels.finished[event.arm] = plan, None if began_s is None else monotonic_s() - began_s
