"""What certificates may be used for."""

import datetime

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from agents.deployment.certificates import issue
from agents.deployment.layout import ROUTER, Host, Layout, Process
from shared.clock import now_ns


def test_the_router_is_called_and_calls_routers_of_other_sites_and_all_others_only_call(tmp_path):
    host = Host("desk", "127.0.0.1", (Process(ROUTER), Process("camera")))
    at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC)
    issue(Layout("lab", "tls/127.0.0.1:7447", (host,), 30, 3650), tmp_path, at)
    usages = {}
    for name in ("router.main", "camera.main"):
        made = x509.load_pem_x509_certificate((tmp_path / "desk" / "certificates" / f"{name}.pem").read_bytes())
        usages[name] = set(made.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
    calling, called = ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH
    assert usages == {"router.main": {calling, called}, "camera.main": {calling}}
