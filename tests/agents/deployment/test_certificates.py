"""The lab's authority: what its certificates may be used for, who may read their keys, and when they are made anew."""

import dataclasses
import datetime
import shutil

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from agents.deployment.certificates import AuthorityError, issue
from agents.deployment.layout import ROUTER, Host, Layout, Process
from agents.diagnostics.status.judgement import EXPIRES_SOON_S

NOW = datetime.datetime(2026, 11, 22, 12, tzinfo=datetime.UTC)
VIDEO = Host("video", "10.0.0.1", (Process(ROUTER), Process("camera"), Process("recorder", "video")))
ROBOT = Host("robot", "robot.lab", (Process("robot_bridge", "psm1"),))
DESK = Host("desk", "10.0.0.3", (Process("operator", "desk"),))
LAYOUT = Layout("lab", "tls/10.0.0.1:7447", (VIDEO, ROBOT, DESK), leaf_days=30, authority_days=3650)


def read(path):
    return x509.load_pem_x509_certificate(path.read_bytes())


def after(**time):
    return NOW + datetime.timedelta(**time)


def reasons(folder, at=NOW, layout=LAYOUT, **options):
    """Why certificates were made, each once; empty for those that stay."""
    return {made.reason for made in issue(layout, folder, at, **options)}


def test_who_is_called_is_named_with_its_address_and_processes_sign_nothing(tmp_path):
    issue(LAYOUT, tmp_path, NOW)
    calling, called = ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH
    for place, usages, address in (
        ("video/certificates/router.main", {calling, called}, "10.0.0.1"),
        ("desk/certificates/operator.desk", {calling, called}, "10.0.0.3"),
        ("robot/certificates/robot_bridge.psm1", {calling}, None),
    ):
        own = read(tmp_path / f"{place}.pem").extensions
        assert set(own.get_extension_for_class(x509.ExtendedKeyUsage).value) == usages
        names = [one.value for one in own if isinstance(one.value, x509.SubjectAlternativeName)]
        assert [str(name.value) for one in names for name in one] == ([address] if address else [])

    def may(path):
        own = read(path).extensions
        constraints = own.get_extension_for_class(x509.BasicConstraints)
        usage = own.get_extension_for_class(x509.KeyUsage)
        assert constraints.critical and usage.critical
        signs = usage.value.key_cert_sign or usage.value.crl_sign
        return constraints.value.ca, constraints.value.path_length, signs, usage.value.digital_signature

    assert may(tmp_path / "video/certificates/camera.main.pem") == (False, None, False, True)
    assert may(tmp_path / "authority/authority.pem") == (True, 0, True, False)


def test_certificates_are_short_lived_their_keys_are_their_owners_alone_and_they_are_made_anew_in_time(tmp_path):
    assert reasons(tmp_path) == {"it was missing"}
    keys = list(tmp_path.rglob("*.key"))
    assert {(key.parent.stat().st_mode & 0o777, key.stat().st_mode & 0o777) for key in keys} == {(0o700, 0o600)}
    for path in tmp_path.rglob("*.pem"):
        assert read(path).not_valid_before_utc == after(minutes=-10)
        assert read(path).not_valid_after_utc == after(days=3650 if path.name == "authority.pem" else 30)
    assert reasons(tmp_path, after(days=19)) == {""}
    assert reasons(tmp_path, after(days=21)) == {"little of its time was left"}
    assert reasons(tmp_path, after(days=90)) == {"it had expired"}
    assert reasons(tmp_path, all_anew=True) == {"all are made anew"}
    shutil.rmtree(tmp_path / "authority")
    assert reasons(tmp_path) == {"it was another authority's"}
    # what doctor asks to be renewed is, however short its time
    short = dataclasses.replace(LAYOUT, leaf_days=9)
    assert reasons(tmp_path, NOW, short, all_anew=True) == {"all are made anew"}
    assert reasons(tmp_path, after(days=9, seconds=1 - EXPIRES_SOON_S), short) == {"little of its time was left"}


def test_a_certificate_that_does_not_fit_any_more_is_made_anew(tmp_path):
    issue(LAYOUT, tmp_path, NOW)
    (tmp_path / "video/certificates/camera.main.key").write_text("nothing")
    shutil.copy(tmp_path / "desk/certificates/operator.desk.key", tmp_path / "robot/certificates/robot_bridge.psm1.key")
    moved = dataclasses.replace(LAYOUT, hosts=(dataclasses.replace(VIDEO, address="10.0.0.9"), ROBOT, DESK))
    assert {made.common_name: made.reason for made in issue(moved, tmp_path, NOW)} == {
        "router.main": "its host's address has changed",
        "camera.main": "it could not be read",
        "recorder.video": "",
        "robot_bridge.psm1": "its key was another one's",
        "operator.desk": "",
    }
    # what left a host leaves no key there
    issue(dataclasses.replace(LAYOUT, hosts=(dataclasses.replace(VIDEO, processes=(Process(ROUTER),)),)), tmp_path, NOW)
    assert [p.name for p in (tmp_path / "video" / "certificates").glob("*.key")] == ["router.main.key"]


def test_an_authority_that_cannot_sign_is_told(tmp_path):
    issue(LAYOUT, tmp_path, NOW)
    with pytest.raises(AuthorityError, match="before a new certificate would"):
        issue(LAYOUT, tmp_path, after(days=3640))
    (tmp_path / "authority" / "authority.key").unlink()
    with pytest.raises(AuthorityError, match="put its two files back"):
        issue(LAYOUT, tmp_path, NOW)
