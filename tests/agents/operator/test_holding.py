"""Holds go out at once: behind no other, before anything is written down, and however often they are said."""

import asyncio
import threading
from typing import Any

import pytest

from agents.operator.arming import EVERY_S, TRIED, Holds, StandingBy, Throttle
from agents.operator.control import Control, Effect, HoldNow, Noted
from agents.operator.desk import until
from agents.operator.words import Voice
from schemas.messages import CommandAnswer, Outcome
from tests.conftest import wait_until

PATIENT_S = 30.0
MANY = 40
ACCEPTED = CommandAnswer("id", Outcome.ACCEPTED, "", "")
UNKNOWN = CommandAnswer("id", Outcome.UNKNOWN, "no_answer", "nobody is there")


class Arms:
    """In the place of a connection: the bridge of psm1 gives no answer until it is let, that of psm2 at once."""

    def __init__(self):
        self.sent, self.answers = [], threading.Event()

    def command(self, _topic, message, arm):
        self.sent.append(message.header.id)
        if arm == "psm1":
            assert self.answers.wait(PATIENT_S)
            return UNKNOWN
        return ACCEPTED

    async def reached(self, count):
        await asyncio.to_thread(wait_until, lambda: len(self.sent) >= count, f"{count} holds")


def test_a_hold_goes_out_though_many_still_wait_for_their_answers():
    arms: Any = Arms()

    async def say():
        holds = Holds(arms, "test")
        waiting = [holds.say("psm1") for _ in range(MANY)]
        await arms.reached(MANY)
        assert not any(each.done() for each in waiting)
        other = await asyncio.wait_for(holds.say("psm2"), PATIENT_S)
        assert other.outcome is Outcome.ACCEPTED
        again = holds.say("psm1")
        await arms.reached(MANY + 2)
        arms.answers.set()
        await asyncio.wait([*waiting, again], timeout=PATIENT_S)
        holds.close()

    asyncio.run(say())
    # where no answer came the newest alone is said again; all are commands of their own
    assert len(set(arms.sent)) == len(arms.sent) == MANY + 2 + TRIED - 1


def test_of_a_flood_the_first_goes_out_at_once_the_last_is_not_lost_and_another_page_does_not_wait():
    due, done = [], []
    coalescing = Throttle(lambda seconds, then: due.append((seconds, then)))
    for i in range(100):
        coalescing.do("screen 1", lambda i=i: done.append(i))
    coalescing.do("screen 2", lambda: done.append("other"))
    assert done == [0, "other"]
    for _ in range(3):
        seconds, then = due.pop(0)
        assert seconds == EVERY_S
        then()
    assert (done, due) == ([0, "other", 99], [])
    coalescing.do("screen 1", lambda: done.append("at once again"))
    assert done[-1] == "at once again"


class Ordered:
    """In the place of what sends commands and of what is written down: notes what came when, and may fail."""

    def __init__(self, failure):
        self.failure, self.happened = failure, []

    def hold(self, arm):
        self.happened.append(f"hold {arm}")
        answer = asyncio.get_running_loop().create_future()
        answer.set_result(ACCEPTED)
        return answer

    def audit(self, what, **_told):
        self.happened.append(f"written {what}")
        if self.failure is not None:
            raise self.failure


@pytest.mark.parametrize("failure", [None, RuntimeError("no room on the disk"), OSError("the disk is gone")])
def test_a_hold_is_sent_before_anything_is_written_down_and_though_nothing_can_be(failure):
    commands: Any = Ordered(failure)
    holds = [HoldNow("a", arm, "let go") for arm in ("psm1", "psm2")]
    effects: list[Effect] = [Noted("a", "released", "a: let go"), *holds]

    async def follow():
        standing_by = StandingBy(
            Control(), commands, Voice({}, commands.audit), lambda _arm: 0, lambda _arm, _plan_id: None
        )
        try:
            standing_by.follow(effects)
        except OSError:
            assert failure is not None
        await standing_by.finish(PATIENT_S)

    asyncio.run(follow())
    assert commands.happened[:2] == ["hold psm1", "hold psm2"]


@pytest.mark.parametrize("turns", range(4))
def test_who_is_cancelled_as_what_it_waits_for_comes_does_not_go_on(turns):
    async def run():
        event = asyncio.Event()

        async def work():
            await until(event, PATIENT_S)
            await asyncio.sleep(PATIENT_S)

        working = asyncio.ensure_future(work())
        await asyncio.sleep(0)
        event.set()
        for _ in range(turns):
            await asyncio.sleep(0)
        working.cancel()
        await asyncio.wait({working}, timeout=1.0)
        assert working.cancelled()

    asyncio.run(run())
