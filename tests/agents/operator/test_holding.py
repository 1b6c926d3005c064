"""Holds go out at once: behind no other, before anything is written down, and however often they are said."""

import asyncio
import itertools
import threading
from typing import Any

import pytest

from agents.operator.control import Control, Effect, HoldNow, Noted
from agents.operator.holding import EVERY_S, TRIED, Coalescing, Holds
from agents.operator.screen import Screen
from agents.operator.standing_by import StandingBy
from agents.operator.voice import Voice
from schemas.messages import CommandAnswer, Outcome

PATIENT_S = 30.0
MANY = 40
ACCEPTED = CommandAnswer("id", Outcome.ACCEPTED, "", "")
UNKNOWN = CommandAnswer("id", Outcome.UNKNOWN, "no_answer", "nobody is there")


class Arms:
    """In the place of a connection: the bridge of psm1 gives no answer until it is let, that of psm2 at once."""

    def __init__(self):
        self.sent, self.answers, self.came = [], threading.Event(), threading.Condition()

    def command(self, _topic, message, arm):
        with self.came:
            self.sent.append((arm, message.header.id))
            self.came.notify_all()
        if arm == "psm1":
            assert self.answers.wait(PATIENT_S)
            return UNKNOWN
        return ACCEPTED

    def reached(self, count):
        with self.came:
            assert self.came.wait_for(lambda: len(self.sent) >= count, PATIENT_S), (
                f"{len(self.sent)} of {count} went out"
            )


@pytest.fixture
def arms():
    return Arms()


def test_a_hold_goes_out_though_many_still_wait_for_their_answers(arms):
    async def say():
        holds = Holds(arms, "test")
        waiting = [holds.say("psm1") for _ in range(MANY)]
        await asyncio.to_thread(arms.reached, MANY)
        assert not any(each.done() for each in waiting)
        other = await asyncio.wait_for(holds.say("psm2"), PATIENT_S)
        assert other.outcome is Outcome.ACCEPTED
        again = holds.say("psm1")
        await asyncio.to_thread(arms.reached, MANY + 2)
        arms.answers.set()
        await asyncio.wait([*waiting, again], timeout=PATIENT_S)
        holds.close()

    asyncio.run(say())
    # where no answer came the newest alone is said again; all are commands of their own
    assert len(arms.sent) == MANY + 2 + TRIED - 1
    assert len({command_id for _, command_id in arms.sent}) == len(arms.sent)


class VirtualTime:
    """Does things later, when it is told that it is later."""

    def __init__(self):
        self.now_s, self._due = 0.0, []

    def later(self, seconds, then):
        self._due.append((self.now_s + seconds, then))

    def go_on(self, until_s):
        while self._due and min(self._due, key=lambda due: due[0])[0] <= until_s:
            due = min(self._due, key=lambda each: each[0])
            self._due.remove(due)
            self.now_s = due[0]
            due[1]()
        self.now_s = until_s


def test_of_a_flood_the_first_goes_out_at_once_the_last_is_not_lost_and_another_page_does_not_wait():
    time, done = VirtualTime(), []
    coalescing = Coalescing(time.later)
    for i in range(100):
        time.go_on(0.01 * i)
        coalescing.do("screen 1", lambda i=i: done.append((time.now_s, i)))
        assert done[0] == (0.0, 0)
    others = []
    coalescing.do("screen 2", lambda: others.append(time.now_s))
    assert others == [0.99]
    time.go_on(10.0)
    times = [at_s for at_s, _ in done]
    assert all(b - a >= EVERY_S - 1e-9 for a, b in itertools.pairwise(times))
    assert done[-1][1] == 99
    assert done[-1][0] <= 0.99 + EVERY_S
    # once it was quiet the next goes out at once again
    coalescing.do("screen 1", lambda: done.append((time.now_s, 100)))
    assert done[-1] == (10.0, 100)


class Ordered:
    """In the place of what sends commands: notes what came when."""

    def __init__(self, happened):
        self._happened = happened

    def hold(self, arm):
        self._happened.append(f"hold {arm}")
        answer = asyncio.get_running_loop().create_future()
        answer.set_result(ACCEPTED)
        return answer


@pytest.mark.parametrize("failure", [None, RuntimeError("no room on the disk"), OSError("the disk is gone")])
def test_a_hold_is_sent_before_anything_is_written_down_and_though_nothing_can_be(failure):
    happened = []

    def audit(what, **_told):
        happened.append(f"written {what}")
        if failure is not None:
            raise failure

    async def follow():
        screens: dict[str, Screen] = {}
        commands: Any = Ordered(happened)
        standing_by = StandingBy(Control(), commands, Voice(screens, audit), lambda _arm: 0)
        effects: list[Effect] = [
            Noted("a", "released", "a: let go"),
            HoldNow("a", "psm1", "let go"),
            HoldNow("a", "psm2", "let go"),
        ]
        try:
            standing_by.follow(effects)
        except OSError:
            assert failure is not None
        await standing_by.finish(PATIENT_S)

    asyncio.run(follow())
    assert happened[:2] == ["hold psm1", "hold psm2"]
