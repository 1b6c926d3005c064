"""A person's connection: it finds the router or says in time that there is none, and heeds being stopped."""

import threading

import pytest

from schemas.codec import decode
from schemas.messages import Heartbeat
from schemas.topics import HEARTBEAT
from shared.clock import monotonic_s
from shared.runtime.connection import NoRouterError, connected, open_when_there
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router


def test_no_router_is_said_within_the_time_allowed():
    settings = SessionSettings("test", free_local_endpoint())
    began_s = monotonic_s()
    with pytest.raises(NoRouterError, match=settings.endpoint), connected(settings, within_s=0.3):
        pass
    assert monotonic_s() - began_s < 30.0


def test_waiting_ends_when_it_is_stopped():
    stopped = threading.Event()
    timer = threading.Timer(0.2, stopped.set)
    timer.daemon = True
    timer.start()
    with pytest.raises(NoRouterError):
        open_when_there(SessionSettings("test", free_local_endpoint()), stopped=stopped)
    assert stopped.is_set()


def test_a_router_that_comes_later_is_found():
    settings = SessionSettings("test", free_local_endpoint())
    routers = []
    timer = threading.Timer(0.3, lambda: routers.append(open_router(settings.endpoint)))
    timer.daemon = True
    timer.start()
    with connected(settings, within_s=60.0) as connection:
        assert connection.present() == []
    timer.join(60.0)
    routers[0].close()


def test_a_repeated_message_comes_in_order_until_it_ends(settings, until):
    heard = []
    with connected(settings, 60.0) as listener, connected(settings, 60.0) as sender:
        listener.listen((HEARTBEAT,), heard.append)
        with sender.repeating(HEARTBEAT, "psm1", 50.0, lambda at_ns: Heartbeat("psm1", "plan", at_ns, "arming")):
            until(lambda: len(heard) >= 5)
        assert "repeat operator/heartbeat" not in [thread.name for thread in threading.enumerate()]
    assert {tapped.key for tapped in heard} == {"suturegrasp/test/operator/psm1/heartbeat"}
    assert len({tapped.beside.epoch for tapped in heard}) == 1
    sent = [(tapped.beside.sequence, decode(Heartbeat, tapped.payload).at_ns) for tapped in heard]
    assert sent == sorted(set(sent))
