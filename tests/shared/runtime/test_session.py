"""Links to the router: waited for, watched, refused without a certificate, and never off loopback without TLS."""

import contextlib
import datetime
import threading

import pytest

from agents.deployment.certificates import issue
from agents.deployment.layout import Host, Layout, Process
from schemas.codec import decode
from schemas.messages import Heartbeat
from schemas.topics import HEARTBEAT
from shared.clock import monotonic_s, now_ns
from shared.runtime.connection import NoRouterError, connected, open_when_there
from shared.runtime.identity import IdentityError, check_identity, identity_in
from shared.runtime.session import (
    RouterWatch,
    SessionSettings,
    check_security,
    free_local_endpoint,
    open_router,
    open_session,
)


def later(after_s, call):
    timer = threading.Timer(after_s, call)
    timer.daemon = True
    timer.start()
    return timer


def test_no_router_is_said_within_the_time_allowed_or_when_waiting_is_stopped():
    settings, stopped, began_s = SessionSettings("test", free_local_endpoint()), threading.Event(), monotonic_s()
    with pytest.raises(NoRouterError, match=settings.endpoint), connected(settings, within_s=0.3):
        pass
    assert monotonic_s() - began_s < 30.0
    later(0.2, stopped.set)
    with pytest.raises(NoRouterError):
        open_when_there(settings, stopped=stopped)
    assert stopped.is_set()


def test_a_router_that_comes_later_is_found():
    settings, routers = SessionSettings("test", free_local_endpoint()), []
    timer = later(0.3, lambda: routers.append(open_router(settings.endpoint)))
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


def test_a_router_that_was_away_is_told_once(router, until):
    said = []
    with contextlib.ExitStack() as stack:
        with router() as endpoint:
            session = stack.enter_context(open_session(SessionSettings("test", endpoint)))
            watch = RouterWatch(session, said.append)
            stack.callback(watch.undeclare)
            until(lambda: session.info.routers_zid(), "the link to be up")
        until(lambda: not session.info.routers_zid(), "the link to be down")
        assert not said
        stack.enter_context(open_router(endpoint))
        until(lambda: said, "the sentence")
        (sentence,) = said
        assert sentence.startswith("the link to the router broke")


def issued(tmp_path, days_ago=0):
    """The identity of a camera whose certificate holds for 30 days."""
    at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC) - datetime.timedelta(days=days_ago)
    host = Host("desk", "127.0.0.1", (Process("camera"),))
    issue(Layout("lab", "tls/127.0.0.1:7447", (host,), 30, 3650), tmp_path, at)
    return identity_in(tmp_path / "desk" / "certificates", "camera.main")


def test_what_leaves_this_machine_without_tls_and_a_certificate_of_ones_own_is_refused(tmp_path):
    own = issued(tmp_path)
    for endpoint in ("tcp/192.0.2.1:7447", "tcp/[::]:7447", "udp/host:1", "quic/192.0.2.1:7447", "ws/lab:7447"):
        for shown in (own, None):
            with pytest.raises(IdentityError, match="mutual TLS"):
                open_session(SessionSettings("lab", endpoint, shown))
            with pytest.raises(IdentityError, match="mutual TLS"):
                open_router(endpoint, shown)
    check_security("tls/192.0.2.1:7447", own)
    with pytest.raises(IdentityError, match="needs certificates on both sides"):
        check_security("tls/192.0.2.1:7447", None)
    check_security("tcp/127.0.0.1:7447", None)


def test_a_part_of_an_identity_that_is_missing_and_a_certificate_that_has_expired_are_told_by_name(tmp_path):
    for part in ("key", "certificate", "authority"):
        identity = issued(tmp_path / part)
        check_identity(identity)
        path = getattr(identity, part)
        path.unlink()
        with pytest.raises(IdentityError, match=f"{path.name}: No such file or directory; suturegrasp deploy"):
            check_identity(identity)
    with pytest.raises(IdentityError, match=r"camera\.main\.pem has expired; renew it"):
        open_session(SessionSettings("lab", "tls/127.0.0.1:1", issued(tmp_path, days_ago=31)))
