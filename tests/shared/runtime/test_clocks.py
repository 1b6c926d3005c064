"""Clocks of other hosts, asked over a real router, and an agent's time while a recording is replayed on its rig."""

import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import encode
from schemas.messages import ClockReading, ReplayClock
from schemas.topics import CLOCKS, LOG, REPLAY_CLOCK, key
from shared.clock import now_ns
from shared.runtime.agent import Input, Received, Tick
from shared.runtime.clocks import JITTER_NS, SILENCE_S, ClockOffset, ReplayedTime, by_host, offset_of
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher
from shared.runtime.facts import CLOCK
from tests.shared.runtime.conftest import Idle, beside

MS, SECOND = 10**6, 10**9
THEN_NS = 1_500_000_000 * SECOND


@pytest.fixture
def host_elsewhere(session, keep):
    """An agent of a host of which the clock is ahead by so much, or that answers something else, or nothing."""

    def run(agent, ahead_ms=0.0, payload=None, silent=False):
        def answer(query):
            reading = ClockReading(agent, now_ns() + round(ahead_ms * MS))
            query.reply(query.key_expr, encode(reading) if payload is None else payload)
            query.drop()

        keep(session.liveliness().declare_token(f"suturegrasp/test/{agent}"))
        if not silent:
            keep(session.declare_queryable(f"suturegrasp/test/{agent}/{CLOCK}", answer))

    return run


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


def test_of_each_host_the_worst_reading_counts_and_of_like_ones_the_most_exact():
    told = ("a", 3.0, 5.0), ("a", 1.0, 2.0), ("b", -400.0, 1.0), ("b", 0.0, 0.1)
    readings = [ClockOffset(*one) for one in told]
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


def test_clocks_are_known_or_unknown_and_who_watches_tells_everybody(
    settings, running, heard, host_elsewhere, until, monkeypatch
):
    monkeypatch.setattr("shared.runtime.clocks.PERIOD_S", 0.1)
    everybody, watching = heard(CLOCKS), Watching()
    host_elsewhere("camera/main", ahead_ms=340.0)
    host_elsewhere("camera/silent", silent=True)
    host_elsewhere("viewer/main", ahead_ms=-90_000.0)
    host_elsewhere("viewer/babbling", payload=b"\xff")
    running(watching)
    with connected(settings, 60.0) as connection:
        until(lambda: len(connection.present()) == 5)
        clocks = until(lambda: (c := connection.clocks()).get("planner/main") and c.get("viewer/main") and c)
    here, behind = clocks["planner/main"], clocks["viewer/main"]
    assert here.host == socket.gethostname()
    assert abs(here.ahead_ms) <= here.within_ms
    assert abs(behind.ahead_ms + 90_000.0) <= behind.within_ms
    assert (clocks["viewer/babbling"], clocks["camera/silent"]) == (None, None)
    told = until(lambda: next((t for t in watching.told if [c.host for c in t.clocks] == ["camera/main", ""]), None))
    known, unknown = told.clocks
    assert (known.agent, known.instance) == ("camera", "main")
    assert abs(known.ahead_ms - 340.0) <= known.within_ms
    assert (unknown.instance, unknown.ahead_ms, unknown.within_ms) == ("silent", None, None)
    until(lambda: told in everybody)


@given(st.integers(0, 2**62), st.floats(0, 10), st.floats(0, SILENCE_S))
def test_between_two_words_a_replays_time_goes_on_at_the_rate_that_was_said(said_ns, rate, gone_s):
    time = ReplayedTime()
    assert time.now_ns(0.0) is None
    time.hear(ReplayClock(said_ns, rate), 100.0)
    now = time.now_ns(100.0 + gone_s)
    assert now is None or now == pytest.approx(said_ns + gone_s * rate * SECOND, abs=2048)


def test_a_replay_that_says_nothing_is_over_and_one_that_begins_again_takes_time_back_with_it():
    time = ReplayedTime()
    time.hear(ReplayClock(THEN_NS, 1.0), 10.0)
    assert time.now_ns(10.0 + SILENCE_S) == THEN_NS + SILENCE_S * SECOND
    assert time.now_ns(10.1 + SILENCE_S) is None
    for said_ns in (THEN_NS + 10 * SECOND, THEN_NS):
        time.hear(ReplayClock(said_ns, 1.0), 20.0)
        assert time.now_ns(20.0) == said_ns


@given(st.lists(st.integers(-JITTER_NS + 1, JITTER_NS - 1), max_size=20))
def test_words_that_travelled_differently_long_never_turn_time_back(offsets_ns):
    time, last_ns = ReplayedTime(), 0
    for count, offset_ns in enumerate(offsets_ns):
        time.hear(ReplayClock(THEN_NS + count * SECOND // 20 + offset_ns // 2, 1.0), 0.05 * count)
        now = time.now_ns(0.05 * count)
        assert now is not None
        assert now >= last_ns
        last_ns = now


@given(st.integers(-(2**63), 2**63 - 1), st.sampled_from((0.0, 1.0, 1e300)), st.floats(0, 1))
def test_whatever_a_replay_says_is_a_time(said_ns, rate, gone_s):
    time = ReplayedTime()
    time.hear(ReplayClock(said_ns, rate), 0.0)
    now = time.now_ns(gone_s)
    assert now is not None
    assert -(2**63) <= now < 2**63


class Ticking(Idle):
    """Notes the time."""

    kind, tick_hz = "camera", 100.0

    def __init__(self, instance="main", accepts_replayed_time=True):
        self.instance, self.accepts_replayed_time, self.times = instance, accepts_replayed_time, []

    def step(self, arrived):
        assert isinstance(arrived, Tick)
        self.times.append(arrived.now_ns)
        return ()


def test_an_agent_lives_in_a_replays_time_but_none_that_moves_something_real(running, session, heard, keep, until):
    lines, simulated, real = heard(LOG), Ticking(), Ticking("psm1", accepts_replayed_time=False)
    running(simulated)
    running(real)
    publisher = keep(declare_publisher(session, key("test", REPLAY_CLOCK), REPLAY_CLOCK))

    def said_and_followed():
        for payload in (b"\xff no time", encode(ReplayClock(THEN_NS, 0.0))):
            publisher.put(payload, attachment=beside(len(simulated.times), published_ns=now_ns()))
        return simulated.times[-1:] == [THEN_NS]

    until(said_and_followed)
    count = len(real.times)
    until(lambda: len(real.times) > count + 5)
    assert THEN_NS not in real.times
    until(lambda: abs(simulated.times[-1] - now_ns()) < SECOND, "this machine's time")
    until(lambda: any("ended or died" in line.text for line in lines))
    followed = [line for line in lines if "a recording is replayed: its time holds" in line.text]
    assert {line.instance for line in followed} == {"main"}
    # what is said meanwhile carries the recording's time, so that a viewer shows it where it belongs
    assert THEN_NS in [line.at_ns for line in lines]
