"""Which goals are asked for again without another look by a person: those of the thread that was looked at."""

import asyncio
import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.operator.choosing import FOUND_ANEW, Choosing
from agents.operator.field_seen import FieldSeen, is_followed
from agents.operator.surroundings import Surroundings
from agents.operator.voice import Voice
from agents.operator.wire import Click
from schemas.messages import CommandAnswer, FrameStamp, Outcome, ThreadTrack, TrackStep
from schemas.topics import THREAD
from shared.runtime.agent import Tick

MOST = 20


def threads_of(hand_made_thread):
    """Threads by hand, one after the other."""
    source = hand_made_thread()
    while True:
        (output,) = source.step(Tick(1))
        yield output.message


def tracked(thread, step, frames):
    track = ThreadTrack(
        step=step,
        reason="another curve fits better" if step is TrackStep.RESTARTED else "",
        frames=frames,
        innovation=1.0,
        found_share=1.0,
        stamp=thread.stamp,
        knots=np.array([0.0, 0, 0, 0, 1, 1, 1, 1]),
        control_points_camera=np.zeros((4, 3)),
        covariance=np.zeros((4, 4, 3, 3)),
        smoothing=1.0,
        span_weight=np.ones(1),
        row_offset_px=0.0,
        length=0.04,
        material_s=np.array([0.0, 1.0]),
    )
    return replace(thread, track=track)


class Heard:
    """The threads that a test has come."""

    def __init__(self):
        self.threads = []

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
    return Heard()


@pytest.fixture
def field(heard, hand_made_thread):
    field = FieldSeen(heard, Surroundings("test", ("psm1",), lambda *_, **__: None))
    heard.threads = [tracked(next(threads_of(hand_made_thread)), TrackStep.STARTED, 0)]
    field.take_thread(0.0)
    return field


@pytest.fixture
def chosen(field, monkeypatch):
    """What became of a place that was named, by the goal's text."""
    monkeypatch.setattr("agents.operator.choosing.AGAIN_S", 0.0)

    def choose(planner):
        async def run():
            choosing = Choosing(field, planner, Voice({}, lambda *_, **__: None))
            planning = choosing.placed("screen 1", "psm1", "direct", 0.3)
            assert planning is not None
            await planning
            return choosing.goals["psm1"]["text"]

        return asyncio.run(run())

    return choose


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
def test_only_what_speaks_against_the_moment_alone_is_asked_again_without_another_look(chosen, code, text, times):
    planner = Planner(code, code)
    assert chosen(planner).startswith(text)
    assert planner.asked == [("psm1", "direct", 0.3)] * times


def test_nothing_is_asked_again_once_the_thread_was_found_anew(chosen, heard, hand_made_thread):
    # the frame in which it was found anew is missed: this one goes on from it
    *_, later = itertools.islice(threads_of(hand_made_thread), 4)
    planner = Planner("thread_stale", "thread_stale")
    planner.before_answer = lambda: setattr(heard, "threads", [tracked(later, TrackStep.CONTINUED, 1)])
    assert FOUND_ANEW in chosen(planner)
    assert len(planner.asked) == 1


def test_a_click_on_a_thread_that_was_found_anew_since_names_nothing(field, heard, hand_made_thread, monkeypatch):
    shown, refused = field.thread, []
    again = list(itertools.islice(threads_of(hand_made_thread), 3))[-1]
    heard.threads = [tracked(again, TrackStep.RESTARTED, 0)]
    field.take_thread(0.0)
    monkeypatch.setattr(Voice, "refuse", lambda _self, _screen, text: refused.append(text))
    planner: Any = Planner()
    choosing = Choosing(field, planner, Voice({}, lambda *_, **__: None))
    click = Click(shown.frame, tuple(shown.px[50]), "psm1", "direct")
    assert choosing.clicked("screen 1", click) is None
    assert refused == [FOUND_ANEW]
    assert choosing.goals == {}


@given(st.lists(st.booleans(), min_size=2, max_size=MOST), st.data())
def test_a_thread_that_was_found_anew_is_never_taken_for_the_one_before(restarts, data):
    # what perception tracks in each frame, of which the page takes some
    told, frames = [], 0
    for number, restarted in enumerate(restarts):
        frames = 0 if restarted or not number else frames + 1
        step = TrackStep.RESTARTED if restarted else TrackStep.CONTINUED
        told.append((number, step, frames))
    first, second = sorted(data.draw(st.lists(st.integers(0, len(told) - 1), min_size=2, max_size=2, unique=True)))
    before, after = (seen(*told[i]) for i in (first, second))
    if any(restarts[first + 1 : second + 1]):
        assert not is_followed(before, after)
    elif second == first + 1:
        assert is_followed(before, after)


def seen(number, step, frames) -> Any:
    """As much of a thread as tells whether it is followed."""
    return SimpleNamespace(stamp=FrameStamp(number, 1, 1, "x"), track=SimpleNamespace(step=step, frames=frames))
