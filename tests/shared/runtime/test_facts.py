"""Where agents run and what lies between here and there, asked over a real router."""

import os
import socket
import threading
from types import SimpleNamespace
from typing import Any

import pytest

import schemas
from schemas.messages import Consumed
from schemas.topics import HEALTH
from shared.clock import processor_s
from shared.runtime import facts
from shared.runtime.connection import connected
from tests.shared.runtime.conftest import Idle

DEADLINE_S, LATENCY_S = 60.0, 0.002
NOTHING_KNOWN = facts.Surroundings()


class Hanging(Idle):
    """Is in a step for as long as the test wants."""

    tick_hz = 10.0

    def __init__(self):
        self.inside, self.ended = threading.Event(), threading.Event()

    def step(self, arrived):
        assert arrived
        self.inside.set()
        self.ended.wait(DEADLINE_S)
        return []


def test_an_agent_tells_where_it_runs_even_from_within_a_long_step(running, settings, session, heard, until):
    healths, hanging = heard(HEALTH), Hanging()
    running(hanging)
    assert hanging.inside.wait(DEADLINE_S)
    with connected(settings, DEADLINE_S) as connection:
        told = until(lambda: connection.facts().get("planner/main"))
        link = until(lambda: connection.link("planner"))
        assert connection.link("nobody") is None
    assert (told.agent, told.instance, told.host) == ("planner", "main", socket.gethostname())
    assert (told.version, told.schemas_hash) == (schemas.__version__, facts.schemas_hash())
    assert 0 < told.processor_s <= processor_s()
    assert told.resident_bytes > 1 << 20
    assert (told.realtime_asked, told.realtime_granted, told.realtime_reason) == (None, None, "")
    assert told.shared_memory_reason != ""
    assert (told.writes_to, told.disk_free_bytes, told.calibrated_ns) == ("", None, None)
    assert 0 < link.latency_ms <= link.latency_ms_p99
    assert min(link.bytes_per_s, link.bytes_per_s_there) > 0

    def came(asked):
        replies = session.get(f"suturegrasp/test/planner/main/{facts.LINK}?{facts.BYTES}={asked}", timeout=10.0)
        return next((len(reply.ok.payload) for reply in replies if reply.ok is not None), None)

    # as many bytes as were asked for, up to a bound
    for asked in (0, 1000, facts.MOST_BYTES, facts.MOST_BYTES + 1, 10**10):
        assert came(asked) == min(asked, facts.MOST_BYTES)
    for no_number in ("", "x", "-1", "1.5", "\u0663", "9" * 5000):
        assert came(no_number) == 0
    hanging.ended.set()
    health = until(lambda: healths)[-1]
    assert (health.resident_bytes or 0) > 1 << 20
    assert 0 <= health.processor_share <= (os.cpu_count() or 1) + 1


def test_a_realtime_priority_is_had_by_the_thread_that_asked_or_the_reason_is_told():
    found = []
    thread = threading.Thread(target=lambda: found.append((facts.ask_for_realtime(5), facts.realtime_priority())))
    thread.start()
    thread.join(DEADLINE_S)
    ((refused, granted),) = found
    assert granted == (None if refused else 5)
    assert facts.realtime_priority() is None


def facts_at(own="tcp/127.0.0.1:4", routers="tcp/127.0.0.1:7447", around=NOTHING_KNOWN, granted=None):
    """The facts of a process between whose ends of the link to the router no memory is shared."""
    links = [SimpleNamespace(src=own, dst=routers)]
    info = SimpleNamespace(transports=lambda: [SimpleNamespace(is_shm=False)], links=lambda: links)
    session: Any = SimpleNamespace(info=info)
    return facts.facts_of(session, "planner", "main", "c0ffee", around, granted)


def test_what_the_process_knows_of_its_host_and_of_its_router_is_told_too(tmp_path):
    around = facts.Surroundings(tmp_path / "not there yet", 123, 456, 50, "Operation not permitted")
    told = facts_at(around=around)
    assert (told.disk_free_bytes or 0) > 0
    assert (told.writes_to, told.config_hash) == (str(around.writes_to), "c0ffee")
    assert (told.calibrated_ns, told.certificate_expires_ns) == (123, 456)
    assert (told.realtime_asked, told.realtime_granted) == (50, None)
    assert told.realtime_reason == "Operation not permitted"
    assert facts_at(around=around, granted=50).realtime_reason == ""
    assert facts_at(granted=50).realtime_reason == "given by whoever started it"
    here = "the router is on this host, and does not share /dev/shm"
    for own, routers, why in (
        ("tcp/127.0.0.1:40000", "tcp/127.0.0.1:7447", here),
        ("tls/[fd00::1]:40000", "tls/[fd00::1]:7447", here),
        ("tls/10.0.0.12:40000", "tls/10.0.0.11:7447", "the router is on another host"),
    ):
        told = facts_at(own, routers)
        assert not told.shared_memory
        assert told.shared_memory_reason.startswith(why)


@pytest.mark.parametrize("rate", [1e4, 1e5, 1e6, 1e9])
def test_the_rate_of_a_link_comes_out_and_no_trip_holds_it_up_for_longer_than_is_needed_to_tell(rate):
    asked, waited_s, held_up = [], [], iter([0.1 * (rate > 1e6)])

    def trip_s(count):
        asked.append(count)
        waited_s.append(min(count / rate, facts.LINK_WAIT_S))
        # one trip that was held up changes nothing
        return LATENCY_S + count / rate + next(held_up, 0.0) if count / rate < facts.LINK_WAIT_S else None

    # what is waited for in vain bounds the rate
    slow = facts.LEAST_BYTES / facts.LINK_WAIT_S
    assert facts.throughput(trip_s, LATENCY_S) == pytest.approx(max(rate, slow))
    assert max(asked) <= max(facts.LEAST_BYTES, 0.1 * rate)
    assert sum(waited_s) <= 2 * facts.MEASURED_S
    # a fast one is measured with a whole frame
    assert (max(asked) == facts.FRAME_BYTES) == (rate == 1e9)


def test_how_far_a_consumer_has_got_never_goes_back_though_several_threads_note_it():
    handled = facts.Handled()
    for epoch, sequence, newest in ((1, 5, 5), (1, 4, 5), (1, 6, 6), (2, 0, 0)):
        handled.note("key", epoch, sequence)
        assert handled.listed() == (Consumed("key", epoch, newest),)
