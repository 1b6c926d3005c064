"""What certificates may be used for, and who may read their keys."""

import datetime

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from agents.deployment.certificates import issue
from agents.deployment.layout import ROUTER, Host, Layout, Process
from shared.clock import now_ns


@pytest.fixture(scope="module")
def issued(tmp_path_factory):
    folder = tmp_path_factory.mktemp("issued")
    host = Host("desk", "127.0.0.1", (Process(ROUTER), Process("camera")))
    at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC)
    issue(Layout("lab", "tls/127.0.0.1:7447", (host,), 30, 3650), folder, at)
    return folder


def extensions(path):
    return x509.load_pem_x509_certificate(path.read_bytes()).extensions


def test_the_router_is_called_and_calls_routers_of_other_sites_and_all_others_only_call(issued):
    usages = {}
    for name in ("router.main", "camera.main"):
        own = extensions(issued / "desk" / "certificates" / f"{name}.pem")
        usages[name] = set(own.get_extension_for_class(x509.ExtendedKeyUsage).value)
    calling, called = ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH
    assert usages == {"router.main": {calling, called}, "camera.main": {calling}}


def test_an_authority_signs_processes_and_no_other_authority_and_processes_sign_nothing(issued):
    def may(path):
        constraints = extensions(path).get_extension_for_class(x509.BasicConstraints)
        usage = extensions(path).get_extension_for_class(x509.KeyUsage)
        assert constraints.critical and usage.critical
        signs = usage.value.key_cert_sign or usage.value.crl_sign
        return constraints.value.ca, constraints.value.path_length, signs, usage.value.digital_signature

    assert may(issued / "desk/certificates/camera.main.pem") == (False, None, False, True)
    assert may(issued / "authority/authority.pem") == (True, 0, True, False)


def test_keys_and_the_folders_that_they_lie_in_are_their_owners_alone(issued):
    folders = (issued / "authority", issued / "desk" / "certificates")
    keys = (folders[0] / "authority.key", folders[1] / "camera.main.key")
    assert {path.stat().st_mode & 0o777 for path in folders} == {0o700}
    assert {path.stat().st_mode & 0o777 for path in keys} == {0o600}
