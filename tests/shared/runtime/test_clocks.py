"""Clocks of other hosts, asked over a real router."""

import contextlib
import socket
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import encode
from schemas.messages import ClockReading
from shared.clock import now_ns
from shared.runtime.agent import Output
from shared.runtime.clocks import CLOCK, ClockOffset, by_host, clock_offset, offset_of
from shared.runtime.connection import connected

MS = 1_000_000


class Idle:
    kind, instance, inputs, outputs, commands, tick_hz = "planner", "main", (), (), (), None

    def step(self, _arrived) -> list[Output]:
        return []


@pytest.fixture
def host_elsewhere(session):
    """An agent of a host of which the clock is ahead by so much, or that answers something else."""
    with contextlib.ExitStack() as stack:

        def run(host, ahead_ms=0.0, payload=None):
            def answer(query):
                reading = ClockReading(host, now_ns() + round(ahead_ms * MS))
                query.reply(query.key_expr, encode(reading) if payload is None else payload)
                query.drop()

            declared = session.declare_queryable(f"suturegrasp/test/{host}/main/{CLOCK}", answer)
            alive = session.liveliness().declare_token(f"suturegrasp/test/{host}/main")
            stack.callback(declared.undeclare)
            stack.callback(alive.undeclare)

        yield run


@given(
    ahead_ns=st.integers(-(10**15), 10**15),
    there_ns=st.integers(0, 10**9),
    back_ns=st.integers(0, 10**9),
    asked_ns=st.integers(10**18, 2 * 10**18),
)
def test_the_true_offset_is_within_the_bound_whatever_the_ways_take(ahead_ns, there_ns, back_ns, asked_ns):
    reading = ClockReading("h", asked_ns + there_ns + ahead_ns)
    found = offset_of(reading, asked_ns, (there_ns + back_ns) * 1e-9)
    assert found.host == "h"
    assert abs(found.ahead_ms - ahead_ns * 1e-6) <= found.within_ms + 1e-3
    assert found.within_ms == pytest.approx((there_ns + back_ns) / 2e6)


@pytest.mark.parametrize("ahead_ms", [0.0, 340.0, -90_000.0])
def test_a_host_is_asked_and_its_clock_is_known_within_the_round_trip(ahead_ms, session, host_elsewhere, until):
    host_elsewhere("far", ahead_ms)
    found = until(lambda: clock_offset(session, "test", "far", "main"))
    assert abs(found.ahead_ms - ahead_ms) <= found.within_ms


def test_a_pause_between_the_two_readings_of_the_own_clocks_is_within_the_bound(
    session, host_elsewhere, monkeypatch, until
):
    def now_and_a_pause():
        read = now_ns()
        threading.Event().wait(0.05)
        return read

    monkeypatch.setattr("shared.runtime.clocks.now_ns", now_and_a_pause)
    host_elsewhere("far", 340.0)
    found = until(lambda: clock_offset(session, "test", "far", "main"))
    assert abs(found.ahead_ms - 340.0) <= found.within_ms


def test_every_agent_answers_for_its_host(settings, running, until):
    running(Idle())
    with connected(settings, 60.0) as connection:
        found = until(lambda: connection.clocks().get("planner/main"))
    assert found.host == socket.gethostname()
    assert abs(found.ahead_ms) <= found.within_ms


def test_who_gives_no_answer_or_one_that_is_none_is_unknown(session, settings, host_elsewhere, until):
    alive = session.liveliness().declare_token("suturegrasp/test/silent/main")
    host_elsewhere("babbling", payload=b"\xff")
    with connected(settings, 60.0) as connection:
        until(lambda: len(connection.present()) == 2)
        assert connection.clocks() == {"babbling/main": None, "silent/main": None}
    alive.undeclare()


def test_of_each_host_the_worst_reading_counts_and_of_like_ones_the_most_exact():
    readings = [
        ClockOffset("a", 3.0, 5.0),
        ClockOffset("a", 1.0, 2.0),
        ClockOffset("b", -400.0, 1.0),
        ClockOffset("b", 0.0, 0.1),
    ]
    assert by_host(readings) == [readings[1], readings[2]]
