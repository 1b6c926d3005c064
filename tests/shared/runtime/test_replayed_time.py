"""An agent's time while a recording is replayed on its rig."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import encode
from schemas.messages import LogRecord, ReplayClock
from schemas.topics import LOG, REPLAY_CLOCK, key
from shared.clock import now_ns
from shared.runtime.agent import Agent, Tick
from shared.runtime.attachment import Attachment, pack
from shared.runtime.clocks import JITTER_NS, SILENCE_S, ReplayedTime
from shared.runtime.delivery import declare_publisher

SECOND = 10**9
THEN_NS = 1_500_000_000 * SECOND


class Ticking(Agent):
    """Notes the time."""

    kind, instance, inputs, outputs, commands, tick_hz = "camera", "main", (), (), (), 100.0

    def __init__(self):
        self.times = []

    def step(self, arrived):
        assert isinstance(arrived, Tick)
        self.times.append(arrived.now_ns)
        return ()


class Real(Ticking):
    """Moves something real."""

    instance, accepts_replayed_time = "psm1", False


@given(st.integers(0, 2**62), st.floats(0, 10), st.floats(0, SILENCE_S))
def test_between_two_words_time_goes_on_at_the_rate_that_was_said(said_ns, rate, gone_s):
    time = ReplayedTime()
    time.hear(ReplayClock(said_ns, rate), 100.0)
    now = time.now_ns(100.0 + gone_s)
    assert now is None or now == pytest.approx(said_ns + gone_s * rate * SECOND, abs=2048)


def test_a_replay_that_says_nothing_is_over():
    time = ReplayedTime()
    assert time.now_ns(0.0) is None
    time.hear(ReplayClock(THEN_NS, 1.0), 10.0)
    assert time.now_ns(10.0 + SILENCE_S) == THEN_NS + SILENCE_S * SECOND
    assert time.now_ns(10.1 + SILENCE_S) is None


@given(st.lists(st.integers(-JITTER_NS + 1, JITTER_NS - 1), max_size=20))
def test_words_that_travelled_differently_long_never_turn_time_back(offsets_ns):
    time, last_ns = ReplayedTime(), 0
    for count, offset_ns in enumerate(offsets_ns):
        time.hear(ReplayClock(THEN_NS + count * SECOND // 20 + offset_ns // 2, 1.0), 0.05 * count)
        now = time.now_ns(0.05 * count)
        assert now is not None
        assert now >= last_ns
        last_ns = now


def test_a_replay_that_begins_again_takes_time_back_with_it():
    time = ReplayedTime()
    time.hear(ReplayClock(THEN_NS + 10 * SECOND, 1.0), 0.0)
    time.now_ns(0.0)
    time.hear(ReplayClock(THEN_NS, 1.0), 0.1)
    assert time.now_ns(0.1) == THEN_NS


@given(st.integers(-(2**63), 2**63 - 1), st.sampled_from((0.0, 1.0, 1e300)), st.floats(0, 1))
def test_whatever_is_said_is_a_time(said_ns, rate, gone_s):
    time = ReplayedTime()
    time.hear(ReplayClock(said_ns, rate), 0.0)
    now = time.now_ns(gone_s)
    assert now is not None
    assert -(2**63) <= now < 2**63


def test_an_agent_lives_in_a_replays_time_and_says_so_and_one_that_moves_something_real_does_not(
    running, session, heard, until
):
    lines: list[LogRecord] = heard(LOG)
    simulated, real = Ticking(), Real()
    running(simulated)
    running(real)
    publisher = declare_publisher(session, key("test", REPLAY_CLOCK), REPLAY_CLOCK)

    def said_and_followed():
        beside = pack(Attachment(1, len(simulated.times), now_ns(), 0.0))
        publisher.put(b"\xff no time", attachment=beside)
        publisher.put(encode(ReplayClock(THEN_NS, 0.0)), attachment=beside)
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
    publisher.undeclare()
