"""Which goals are asked for again without another look by a person: those of the thread that was looked at."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.operator.choosing import FOUND_ANEW, Choosing
from agents.operator.field_state import FieldState, is_followed
from agents.operator.surroundings import Surroundings
from agents.operator.wire import Click
from agents.operator.words import Voice
from schemas.messages import CommandAnswer, FrameStamp, Outcome, TrackStep
from schemas.topics import THREAD
from tests.agents.operator.by_hand import thread_at


def tracked(frame, step, frames) -> Any:
    """As much of a thread as is drawn, and as much of its track as tells whether it is followed."""
    told = vars(thread_at(FrameStamp(frame, 1, 1, "hand")))
    return SimpleNamespace(**told | {"track": SimpleNamespace(step=step, frames=frames)})


class Subscriptions:
    """The threads that a test has come."""

    def __init__(self):
        self.threads = [tracked(1, TrackStep.STARTED, 0)]

    def newest(self, topic):
        come, self.threads = (self.threads, []) if topic is THREAD else ([], self.threads)
        return come


class Planner:
    """Refuses a goal with these codes, one after the other, and takes it then."""

    def __init__(self, *codes):
        self.codes, self.asked, self.before_answer = list(codes), [], lambda: None

    async def goal(self, arm, policy, s):
        self.asked.append((arm, policy, s))
        self.before_answer()
        if self.codes:
            return "goal", CommandAnswer("goal", Outcome.REFUSED, self.codes.pop(0), "it cannot be planned")
        return "goal", CommandAnswer("goal", Outcome.ACCEPTED, "", "")


@pytest.fixture
def heard():
    return Subscriptions()


@pytest.fixture
def choosing(heard, monkeypatch):
    """What chooses goals on the thread that was heard, with a planner of the test's."""
    monkeypatch.setattr("agents.operator.choosing.AGAIN_S", 0.0)
    field = FieldState(heard, Surroundings("test", ("psm1",), lambda *_, **__: None))
    field.take_thread(0.0)
    return lambda planner: (Choosing(field, planner, Voice({}, lambda *_, **__: None)), field)


def placed(choosing, planner):
    """What became of a place that was named, by the goal's text."""
    chosen, _ = choosing(planner)
    planning = chosen.placed("screen 1", "psm1", "direct", 0.3)
    assert planning is not None
    asyncio.run(planning)
    return chosen.goals["psm1"]["text"]


@pytest.mark.parametrize(
    ("code", "text", "times"),
    [
        ("thread_restarted", "No plan:", 1),
        ("unknown_arm", "No plan:", 1),
        ("no_thread", "Planning", 3),
        ("thread_stale", "Planning", 3),
        ("arm_stale", "Planning", 3),
    ],
)
def test_only_what_speaks_against_the_moment_alone_is_asked_again_without_another_look(choosing, code, text, times):
    planner = Planner(code, code)
    assert placed(choosing, planner).startswith(text)
    assert planner.asked == [("psm1", "direct", 0.3)] * times


def test_nothing_is_asked_again_once_the_thread_was_found_anew(choosing, heard):
    planner = Planner("thread_stale", "thread_stale")
    # the frame in which it was found anew is missed: this one goes on from it
    planner.before_answer = lambda: setattr(heard, "threads", [tracked(4, TrackStep.CONTINUED, 1)])
    assert FOUND_ANEW in placed(choosing, planner)
    assert len(planner.asked) == 1


def test_a_click_on_a_thread_that_was_found_anew_since_names_nothing(choosing, heard, monkeypatch):
    refused = []
    monkeypatch.setattr(Voice, "refuse", lambda _self, _screen, text: refused.append(text))
    chosen, field = choosing(Planner())
    shown, heard.threads = field.thread, [tracked(3, TrackStep.RESTARTED, 0)]
    field.take_thread(0.0)
    assert chosen.clicked("screen 1", Click(shown.frame, tuple(shown.px[50]), "psm1", "direct")) is None
    assert refused == [FOUND_ANEW]
    assert chosen.goals == {}


@given(st.lists(st.booleans(), min_size=2, max_size=20), st.data())
def test_a_thread_that_was_found_anew_is_never_taken_for_the_one_before(restarts, data):
    # what perception tracks in each frame, of which the page takes some
    told, frames = [], 0
    for number, restarted in enumerate(restarts):
        frames = 0 if restarted or not number else frames + 1
        step = TrackStep.RESTARTED if restarted else TrackStep.CONTINUED
        told.append((number, step, frames))
    first, second = sorted(data.draw(st.lists(st.integers(0, len(told) - 1), min_size=2, max_size=2, unique=True)))
    before, after = (tracked(*told[i]) for i in (first, second))
    if any(restarts[first + 1 : second + 1]):
        assert not is_followed(before, after)
    elif second == first + 1:
        assert is_followed(before, after)
