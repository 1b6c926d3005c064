"""Clocks of other hosts, asked over a real router."""

import contextlib
import socket
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import decode, encode
from schemas.messages import ClockReading, HostClocks
from schemas.topics import CLOCKS
from shared.clock import now_ns
from shared.runtime.agent import Input, Output, Received
from shared.runtime.clocks import CLOCK, ClockOffset, by_host, clock_offset, offset_of
from shared.runtime.connection import connected
from shared.runtime.taps import tap

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


class Watching(Idle):
    """Keeps what it is told of the clocks of cameras."""

    inputs, watches_clocks = (Input(CLOCKS, only_newest_counts=True),), ("camera",)

    def __init__(self):
        self.told = []

    def step(self, arrived):
        if isinstance(arrived, Received):
            self.told.append(arrived.message)
        return []


def test_who_watches_clocks_is_told_of_those_of_its_kinds_and_so_is_everybody(
    running, session, host_elsewhere, until, monkeypatch
):
    monkeypatch.setattr("shared.runtime.clock_watch.PERIOD_S", 0.1)
    heard = []
    kept = tap(session, "test", (CLOCKS,), heard.append, lambda *_: None)
    host_elsewhere("camera", ahead_ms=340.0)
    host_elsewhere("viewer", ahead_ms=-5.0)
    watching = Watching()
    running(watching)
    told = until(lambda: next((t for t in reversed(watching.told) if t.clocks), None))
    (clock,) = told.clocks
    assert (clock.agent, clock.instance, clock.host) == ("camera", "main", "camera")
    assert abs(clock.ahead_ms - 340.0) <= clock.within_ms
    until(lambda: told in [decode(HostClocks, t.payload) for t in list(heard)])
    for declared in kept:
        declared.undeclare()


def test_a_camera_that_does_not_tell_its_time_is_told_of_as_unknown(running, session, until):
    alive = session.liveliness().declare_token("suturegrasp/test/camera/main")
    watching = Watching()
    until(lambda: any(r.ok for r in session.liveliness().get("suturegrasp/test/*/*", timeout=1.0)))
    running(watching)
    (clock,) = until(lambda: watching.told)[0].clocks
    assert (clock.agent, clock.host, clock.ahead_ms, clock.within_ms) == ("camera", "", None, None)
    alive.undeclare()
