"""Off loopback nothing starts without mutual TLS, and what is missing of a certificate is named before it is tried."""

import datetime

import pytest

from agents.deployment.certificates import issue
from agents.deployment.layout import Host, Layout, Process
from shared.clock import now_ns
from shared.runtime.identity import IdentityError, check_identity, identity_in
from shared.runtime.session import SessionSettings, check_security, open_session


@pytest.fixture
def identity(tmp_path):
    at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC)
    host = Host("desk", "127.0.0.1", (Process("camera"),))
    issue(Layout("lab", "tls/127.0.0.1:7447", (host,), 30, 3650), tmp_path, at)
    return identity_in(tmp_path / "desk" / "certificates", "camera.main")


@pytest.mark.parametrize("endpoint", ["tcp/192.0.2.1:7447", "udp/192.0.2.1:7447", "quic/192.0.2.1:7447", "ws/lab:7447"])
def test_what_leaves_this_machine_without_tls_is_refused_certificate_or_not(identity, endpoint):
    for shown in (identity, None):
        with pytest.raises(IdentityError, match="needs certificates on both sides"):
            check_security(endpoint, shown)
        with pytest.raises(IdentityError, match="needs certificates on both sides"):
            open_session(SessionSettings("lab", endpoint, shown))


def test_tls_needs_a_certificate_of_ones_own_too(identity):
    check_security("tls/192.0.2.1:7447", identity)
    with pytest.raises(IdentityError, match="needs certificates on both sides"):
        check_security("tls/192.0.2.1:7447", None)
    check_security("tcp/127.0.0.1:7447", None)


@pytest.mark.parametrize("part", ["authority", "certificate", "key"])
def test_a_part_of_an_identity_that_is_missing_is_named(identity, part):
    check_identity(identity)
    path = getattr(identity, part)
    path.unlink()
    with pytest.raises(IdentityError, match=f"{path.name}: No such file or directory; suturegrasp deploy"):
        check_identity(identity)
