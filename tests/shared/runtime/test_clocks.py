"""Clocks of other hosts, asked over a real router."""

import contextlib
import socket
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import encode
from schemas.messages import ClockReading
from schemas.topics import CLOCKS
from shared.clock import now_ns
from shared.runtime.agent import Agent, Input, Received
from shared.runtime.clocks import CLOCK, ClockOffset, by_host, offset_of
from shared.runtime.connection import connected

MS = 1_000_000


class Idle(Agent):
    kind, instance, inputs, outputs, commands, tick_hz = "planner", "main", (), (), (), None

    def step(self, arrived: Any):
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


def test_each_agents_clock_is_known_within_the_round_trip_or_unknown_where_none_is_told(
    session, settings, running, host_elsewhere, until
):
    running(Idle())
    host_elsewhere("behind", ahead_ms=-90_000.0)
    host_elsewhere("babbling", payload=b"\xff")
    alive = session.liveliness().declare_token("suturegrasp/test/silent/main")
    with connected(settings, 60.0) as connection:
        until(lambda: len(connection.present()) == 4)
        clocks = until(lambda: (c := connection.clocks()).get("planner/main") and c.get("behind/main") and c)
    here, behind = clocks.pop("planner/main"), clocks.pop("behind/main")
    assert here.host == socket.gethostname()
    assert abs(here.ahead_ms) <= here.within_ms
    assert abs(behind.ahead_ms + 90_000.0) <= behind.within_ms
    assert clocks == {"babbling/main": None, "silent/main": None}
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


def test_who_watches_clocks_is_told_of_those_of_its_kinds_known_or_not_and_so_is_everybody(
    running, session, heard, host_elsewhere, until, monkeypatch
):
    monkeypatch.setattr("shared.runtime.clocks.PERIOD_S", 0.1)
    everybody = heard(CLOCKS)
    host_elsewhere("camera", ahead_ms=340.0)
    host_elsewhere("viewer", ahead_ms=-5.0)
    silent = session.liveliness().declare_token("suturegrasp/test/camera/silent")
    watching = Watching()
    running(watching)
    told = until(lambda: next((t for t in watching.told if [c.host for c in t.clocks] == ["camera", ""]), None))
    known, unknown = told.clocks
    assert (known.agent, known.instance) == ("camera", "main")
    assert abs(known.ahead_ms - 340.0) <= known.within_ms
    assert (unknown.instance, unknown.ahead_ms, unknown.within_ms) == ("silent", None, None)
    until(lambda: told in everybody)
    silent.undeclare()
