"""Where agents run and what lies between here and there, asked over a real router."""

import os
import socket
import threading
from types import SimpleNamespace
from typing import Any

import pytest

import schemas
from schemas.messages import AgentHealth
from schemas.topics import HEALTH
from shared.clock import processor_s
from shared.runtime.agent import Agent, Output
from shared.runtime.connection import connected
from shared.runtime.facts import (
    BYTES,
    LINK,
    MOST_BYTES,
    Surroundings,
    ask_for_realtime,
    facts_of,
    realtime_priority,
    schemas_hash,
)

DEADLINE_S = 60.0
NOTHING_KNOWN = Surroundings()


class Idle(Agent):
    kind, instance, inputs, outputs, commands, tick_hz = "planner", "main", (), (), (), None

    def step(self, arrived) -> list[Output]:
        assert arrived
        return []


class Hung(Idle):
    """Is in a step for as long as the test takes."""

    tick_hz = 10.0

    def __init__(self):
        self.inside, self.ended = threading.Event(), threading.Event()

    def step(self, arrived) -> list[Output]:
        assert arrived
        self.inside.set()
        self.ended.wait(DEADLINE_S)
        return []


@pytest.fixture
def connection(settings):
    with connected(settings, DEADLINE_S) as opened:
        yield opened


def test_an_agent_tells_where_it_runs_even_from_within_a_long_step(running, connection, until):
    hung = Hung()
    running(hung)
    assert hung.inside.wait(DEADLINE_S)
    facts = until(lambda: connection.facts().get("planner/main"))
    hung.ended.set()
    assert (facts.agent, facts.instance, facts.host) == ("planner", "main", socket.gethostname())
    assert (facts.version, facts.schemas_hash) == (schemas.__version__, schemas_hash())
    assert 0 < facts.processor_s <= processor_s()
    assert facts.resident_bytes > 1 << 20
    assert (facts.realtime_asked, facts.realtime_granted, facts.realtime_reason) == (None, None, "")
    assert facts.shared_memory_reason != ""
    assert (facts.writes_to, facts.disk_free_bytes, facts.calibrated_ns) == ("", None, None)
    assert facts.certificate_expires_ns is None


def test_a_realtime_priority_is_had_by_the_thread_that_asked_or_the_reason_is_told():
    found = []
    thread = threading.Thread(target=lambda: found.append((ask_for_realtime(5), realtime_priority())))
    thread.start()
    thread.join(DEADLINE_S)
    ((refused, granted),) = found
    assert granted == (None if refused else 5)
    assert realtime_priority() is None


def test_a_link_is_measured_to_who_answers_and_is_unknown_to_others(running, connection, until):
    running(Idle())
    link = until(lambda: connection.link("planner"))
    assert 0 < link.latency_ms <= link.latency_ms_p99
    assert min(link.bytes_per_s, link.bytes_per_s_there) > 0
    assert connection.link("nobody") is None


def test_as_many_bytes_come_as_were_asked_for_up_to_a_bound(running, session, until):
    running(Idle())

    def came(asked):
        replies = session.get(f"suturegrasp/test/planner/main/{LINK}?{BYTES}={asked}", timeout=10.0)
        return next((len(reply.ok.payload) for reply in replies if reply.ok is not None), None)

    until(lambda: came(1) == 1)
    for asked in (0, 1000, 1_500_000, MOST_BYTES, MOST_BYTES + 1, 10**10):
        assert came(asked) == min(asked, MOST_BYTES)
    for no_number in ("", "x", "-1", "1.5", "\u0663", "9" * 5000):
        assert came(no_number) == 0


def test_health_tells_what_the_process_uses(running, heard, until):
    healths: list[AgentHealth] = heard(HEALTH)
    running(Idle())
    health = until(lambda: healths)[-1]
    assert (health.resident_bytes or 0) > 1 << 20
    assert health.processor_share is not None
    assert 0 <= health.processor_share <= (os.cpu_count() or 1) + 1


def facts_at(own="tcp/127.0.0.1:4", routers="tcp/127.0.0.1:7447", around=NOTHING_KNOWN, granted=None):
    """The facts of a process between whose ends of the link to the router no memory is shared."""
    links = [SimpleNamespace(src=own, dst=routers)]
    info = SimpleNamespace(transports=lambda: [SimpleNamespace(is_shm=False)], links=lambda: links)
    session: Any = SimpleNamespace(info=info)
    return facts_of(session, "planner", "main", "c0ffee", around, granted)


def test_what_the_process_knows_of_its_host_is_told_too(tmp_path):
    around = Surroundings(tmp_path / "not there yet", 123, 456, 50, "Operation not permitted")
    facts = facts_at(around=around)
    assert (facts.disk_free_bytes or 0) > 0
    assert (facts.writes_to, facts.config_hash) == (str(around.writes_to), "c0ffee")
    assert (facts.calibrated_ns, facts.certificate_expires_ns) == (123, 456)
    told = facts.realtime_asked, facts.realtime_granted, facts.realtime_reason
    assert told == (50, None, "Operation not permitted")
    assert facts_at(around=around, granted=50).realtime_reason == ""
    assert facts_at(granted=50).realtime_reason == "given by whoever started it"


def test_a_router_on_this_host_is_told_from_one_elsewhere_where_no_memory_is_shared():
    here = "the router is on this host, and does not share /dev/shm"
    for own, routers, told in (
        ("tcp/127.0.0.1:40000", "tcp/127.0.0.1:7447", here),
        ("tls/[fd00::1]:40000", "tls/[fd00::1]:7447", here),
        ("tls/10.0.0.12:40000", "tls/10.0.0.11:7447", "the router is on another host"),
    ):
        facts = facts_at(own, routers)
        assert not facts.shared_memory
        assert facts.shared_memory_reason.startswith(told)
