"""Where agents run and what lies between here and there, asked over a real router."""

import os
import socket
import threading
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import schemas
from schemas.codec import decode
from schemas.messages import AgentHealth
from schemas.topics import HEALTH
from shared.clock import processor_s
from shared.runtime.agent import Output
from shared.runtime.connection import connected
from shared.runtime.facts import Surroundings, ask_for_realtime, facts_of, realtime_priority, schemas_hash
from shared.runtime.link import BYTES, LINK, MOST_BYTES
from shared.runtime.runner import Runner
from shared.runtime.session import SessionSettings, open_session
from shared.runtime.taps import tap
from shared.runtime.usage import ProcessorShare, resident_bytes

DEADLINE_S = 60.0


class Idle:
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


def test_what_the_process_knows_of_its_host_is_told_too(settings, connection, tmp_path, until):
    around = Surroundings(tmp_path / "not there yet", 123, 456, 50, "Operation not permitted")
    with open_session(settings) as session:
        runner = Runner(Idle(), session, "test", "c0ffee", around)
        thread = threading.Thread(target=runner.run, daemon=True)
        thread.start()
        facts = until(lambda: connection.facts().get("planner/main"))
        runner.stop()
        thread.join(DEADLINE_S)
    assert facts.disk_free_bytes is not None
    assert facts.disk_free_bytes > 0
    assert facts.writes_to == str(around.writes_to)
    assert (facts.calibrated_ns, facts.certificate_expires_ns) == (123, 456)
    assert (facts.realtime_asked, facts.realtime_granted) == (50, None)
    assert facts.realtime_reason == "Operation not permitted"
    assert facts.config_hash == "c0ffee"


def test_a_realtime_priority_is_had_by_the_thread_that_asked_or_the_reason_is_told():
    found = []

    def ask():
        found.append((ask_for_realtime(5), realtime_priority()))

    thread = threading.Thread(target=ask)
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


@pytest.fixture(scope="module")
def answered(router, in_threads, until):
    """How many bytes come upon a request."""
    with router() as endpoint:
        settings = SessionSettings("test", endpoint)
        with in_threads(settings, Idle()), open_session(settings) as session:

            def ask(parameters):
                replies = session.get(f"suturegrasp/test/planner/main/{LINK}?{parameters}", timeout=10.0)
                return next((len(reply.ok.payload) for reply in replies if reply.ok is not None), None)

            until(lambda: ask(f"{BYTES}=1") == 1)
            yield ask


@pytest.mark.parametrize("asked", [0, 1, 1000, 1_500_000, MOST_BYTES, MOST_BYTES + 1, 10**10])
def test_as_many_bytes_come_as_were_asked_for_up_to_a_bound(answered, asked):
    assert answered(f"{BYTES}={asked}") == min(asked, MOST_BYTES)


@given(asked=st.text(st.characters(exclude_characters="#?&;=$*/", exclude_categories=["Cs", "Cc"]), max_size=8))
def test_a_request_that_is_no_number_gets_an_empty_answer(answered, asked):
    if not (asked.isascii() and asked.isdigit()):
        assert answered(f"{BYTES}={asked}") == 0


def test_health_tells_what_the_process_uses(running, session, until):
    heard = []
    kept = tap(session, "test", (HEALTH,), heard.append, lambda *_: None)
    running(Idle())
    health = decode(AgentHealth, until(lambda: len(heard) > 1 and heard)[-1].payload)
    for declared in kept:
        declared.undeclare()
    assert health.resident_bytes is not None
    assert health.resident_bytes > 1 << 20
    assert health.processor_share is not None
    assert 0 <= health.processor_share <= (os.cpu_count() or 1) + 1


def test_a_process_that_works_uses_more_than_one_that_waits():
    share = ProcessorShare()
    threading.Event().wait(0.2)
    waiting = share.since_last()
    begun_s = processor_s()
    while processor_s() < begun_s + 0.2:
        sum(range(1000))
    assert share.since_last() > waiting
    assert resident_bytes() > 1 << 20


@pytest.mark.parametrize(
    ("own", "routers", "told"),
    [
        ("tls/10.0.0.11:40000", "tls/10.0.0.11:7447", "the router is on this host, and does not share /dev/shm"),
        ("tcp/127.0.0.1:40000", "tcp/127.0.0.1:7447", "the router is on this host, and does not share /dev/shm"),
        ("tls/[fd00::1]:40000", "tls/[fd00::1]:7447", "the router is on this host, and does not share /dev/shm"),
        ("tls/10.0.0.12:40000", "tls/10.0.0.11:7447", "the router is on another host"),
    ],
)
def test_a_router_on_this_host_is_told_from_one_elsewhere_where_no_memory_is_shared(own, routers, told):
    info = SimpleNamespace(
        transports=lambda: [SimpleNamespace(is_shm=False)], links=lambda: [SimpleNamespace(src=own, dst=routers)]
    )
    session: Any = SimpleNamespace(info=info)
    facts = facts_of(session, "planner", "main", "c", Surroundings(), None)
    assert not facts.shared_memory
    assert facts.shared_memory_reason.startswith(told)
