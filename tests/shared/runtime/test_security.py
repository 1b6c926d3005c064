"""Off loopback nothing starts without mutual TLS, and what is missing of a certificate is named before it is tried."""

import datetime

import pytest

from agents.deployment.certificates import issue
from agents.deployment.layout import Host, Layout, Process
from shared.clock import now_ns
from shared.runtime.identity import IdentityError, check_identity, identity_in
from shared.runtime.session import SessionSettings, check_security, open_router, open_session


def issued(tmp_path, days_ago=0):
    """The identity of a camera whose certificate holds for 30 days."""
    at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC) - datetime.timedelta(days=days_ago)
    host = Host("desk", "127.0.0.1", (Process("camera"),))
    issue(Layout("lab", "tls/127.0.0.1:7447", (host,), 30, 3650), tmp_path, at)
    return identity_in(tmp_path / "desk" / "certificates", "camera.main")


@pytest.mark.parametrize(
    "endpoint", ["tcp/192.0.2.1:7447", "tcp/[::]:7447", "udp/host:1", "quic/192.0.2.1:7447", "ws/lab:7447"]
)
def test_what_leaves_this_machine_without_tls_is_refused_certificate_or_not(tmp_path, endpoint):
    for shown in (issued(tmp_path), None):
        with pytest.raises(IdentityError, match="mutual TLS"):
            check_security(endpoint, shown)
        with pytest.raises(IdentityError, match="mutual TLS"):
            open_session(SessionSettings("lab", endpoint, shown))
        with pytest.raises(IdentityError, match="mutual TLS"):
            open_router(endpoint, shown)


def test_tls_needs_a_certificate_of_ones_own_too(tmp_path):
    check_security("tls/192.0.2.1:7447", issued(tmp_path))
    with pytest.raises(IdentityError, match="needs certificates on both sides"):
        check_security("tls/192.0.2.1:7447", None)
    check_security("tcp/127.0.0.1:7447", None)


@pytest.mark.parametrize("part", ["authority", "certificate", "key"])
def test_a_part_of_an_identity_that_is_missing_is_named(tmp_path, part):
    identity = issued(tmp_path)
    check_identity(identity)
    path = getattr(identity, part)
    path.unlink()
    with pytest.raises(IdentityError, match=f"{path.name}: No such file or directory; suturegrasp deploy"):
        check_identity(identity)


def test_an_expired_certificate_is_told_by_name(tmp_path):
    with pytest.raises(IdentityError, match=r"camera\.main\.pem has expired; renew it"):
        open_session(SessionSettings("lab", "tls/127.0.0.1:1", issued(tmp_path, days_ago=31)))
