"""What the page says: of what goes on, of each arm and its tool, and what becomes of a miss."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents.operator.control import Control
from agents.operator.drawn import BETTER_ELSEWHERE
from agents.operator.field_state import FieldState
from agents.operator.rig_panels import Finished, left_to_judge
from agents.operator.surroundings import Surroundings
from agents.operator.words import Seen, arm_words, event_words, sentence, tool_words
from agents.planner import policy
from agents.robot_bridge.plans import Code
from schemas.messages import ExecutionEvent, ExecutionKind, FrameStamp, RobotMode, RobotState, ToolStatus
from schemas.topics import FRAMES, ROBOT_STATE
from tests.agents.operator.by_hand import followed

PLAN = {
    "id": "plan-1",
    "goal_id": "goal-1",
    "arm": "psm1",
    "ok": True,
    "s_goal": 0.4,
    "s_capture": 0.2,
    "slide_mm": 12.0,
    "pull": "",
    "bounds": "",
    "continues": "",
    "probability": 0.93,
    "attempt": 1,
    "attempts": 3,
}
SEEN = Seen(0.1, 0.2, "idle", PLAN, 1.0, "")


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({}, "Planned: capture at 20%, slide 12 mm, grasp at 40%; success 93%. Look at it, then press and hold"),
        ({"why": "the guard is silent", "refused": True}, "psm1 was not armed: the guard is silent. Planned: capture"),
        ({"mode": "holding", "why": "it was let go of"}, "psm1 holds: it was let go of. Planned: capture"),
        (
            {"mode": "fault", "why": "joint 3 is stuck"},
            "psm1 has a fault and cannot be armed (joint 3 is stuck). See to it at its console",
        ),
        ({"mode": "disabled"}, "psm1 is disabled and cannot be armed."),
        ({"done": True}, "psm1 has carried out its plan. Click the thread for the next goal."),
        ({"plan": PLAN | {"attempt": 2}}, "Attempt 2 of 3: capture at 20%"),
        ({"plan": PLAN | {"ok": False, "reason": "no way there"}}, "No grasp is planned: no way there."),
        ({"plan": PLAN | {"pull": "the jaws let go, as asked"}}, "Planned: the jaws let go, as asked. Look at it"),
        ({"plan": None}, "psm1 is idle. Click the thread"),
        ({"frame_age_s": 4.0}, "The image is 4 s old."),
    ],
)
def test_what_goes_on_is_one_sentence(told, words):
    control = Control(screens=["screen 1"], controller="screen 1")
    assert sentence("screen 1", control, "psm1", replace(SEEN, **told)).startswith(words)


def test_who_controls_is_told_first_that_control_is_asked_for():
    control = Control(screens=["screen 1", "screen 2"], controller="screen 1", asking="screen 2")
    assert sentence("screen 1", control, "psm1", SEEN).startswith("screen 2 asks for control. Hand it over, or keep")
    assert sentence("screen 2", control, "psm1", SEEN).startswith("You asked screen 1 for control;")


def test_an_arm_says_why_it_stopped_and_how_its_tool_stands():
    state = RobotState("psm1", 1, RobotMode.HOLDING, np.eye(4), np.zeros(6), 0.0, np.eye(4), "")
    told = arm_words("holding", "the button was released", state, followed(off_m=0.0042))
    assert told.startswith("holds: the button was released; by the images its tool is 4.2 mm off its registration")
    assert told.endswith("give or take 0.3, which is not corrected")
    assert arm_words("", "", None, None) == "has not been heard lately"
    sought = replace(followed(), status=ToolStatus.CONVERGING, reason="10% of an outline", T_correction=None)
    assert "10% of an outline" in tool_words(sought, corrected=True)


@pytest.mark.parametrize("kind", [ExecutionKind.REFUSED, ExecutionKind.HELD])
def test_what_the_bridge_says_of_why_it_stops_is_passed_on(kind):
    event = ExecutionEvent("plan-1", "psm1", 1, kind, None, Code.NO_PRESENCE.value, "what is wrong: what to do")
    assert "what is wrong: what to do." in event_words(event)


def test_a_miss_is_judged_though_the_same_goal_was_planned_for_again():
    finished: Finished = {"psm1": (PLAN, 4.0), "psm2": (PLAN, None)}
    assert left_to_judge(finished, "psm1", "goal-1") == finished
    assert set(left_to_judge(finished, "psm1", "goal-2")) == {"psm2"}


def test_the_planner_and_the_page_mean_the_same_by_a_capture_that_would_do():
    assert BETTER_ELSEWHERE == policy.BETTER_ELSEWHERE


class Subscriptions:
    """What has come, each once."""

    def __init__(self, **come):
        self.come = {FRAMES: come.pop("frames"), ROBOT_STATE: come.pop("states")}

    def newest(self, topic):
        return self.come.pop(topic, [])


def test_a_clock_that_is_set_back_makes_no_dead_bridge_ready_and_no_old_image_young(monkeypatch):
    wall_ns, now_s = [10**18], [100.0]
    monkeypatch.setattr("agents.operator.field_state.now_ns", lambda: wall_ns[0])
    monkeypatch.setattr("agents.operator.field_state.monotonic_s", lambda: now_s[0])
    stamp = FrameStamp(1, wall_ns[0], wall_ns[0], "hand")
    state = RobotState("psm1", 1, RobotMode.IDLE, np.eye(4), np.zeros(6), 0.0, np.eye(4), "")
    heard: Any = Subscriptions(frames=[SimpleNamespace(stamp=stamp)], states=[state])
    field = FieldState(heard, Surroundings("test", ("psm1",), lambda *_, **__: None))
    field.take_frame()
    field.take_states()
    assert (field.mode("psm1"), field.seen("psm1").frame_age_s) == ("idle", 0.0)
    wall_ns[0] -= 3600 * 10**9
    now_s[0] += 5.0
    assert (field.mode("psm1"), field.seen("psm1").frame_age_s) == ("", 5.0)
    # an image that was long on its way is as old as its stamp says
    wall_ns[0] += 3609 * 10**9
    assert field.seen("psm1").frame_age_s == 9.0
