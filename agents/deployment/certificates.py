"""A small authority of the lab's own, and a short-lived certificate for each process of a rig.

Elliptic keys on P-256. The authority's key stays in the folder where certificates are made, and goes to no host. A
certificate is made anew when a third of its time is left, or five days, or when it does not suit its host any more.
"""

import datetime
import ipaddress
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.types import PublicKeyTypes
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from agents.deployment.layout import ANSWERING, Layout
from agents.deployment.places import AUTHORITY_FOLDER
from shared.runtime.identity import AUTHORITY_FILE

AUTHORITY_KEY = "authority.key"
CERTIFICATES = "certificates"
CLOCKS_APART = datetime.timedelta(minutes=10)
"""Certificates hold from so long before they are made, for hosts whose clocks are behind."""
RENEWED_WITH_LEFT = 1 / 3
RENEWED_WITHIN = datetime.timedelta(days=5)
"""When `doctor` and `status` ask for it, of however short a time this is a share."""
_USAGES = ("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement")
_USAGES_OF_AUTHORITIES = ("key_cert_sign", "crl_sign")


class AuthorityError(RuntimeError):
    """The lab's authority cannot sign; the text names the remedy."""


@dataclass(frozen=True)
class Signer:
    """An authority's certificate and its key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


@dataclass(frozen=True)
class Issued:
    """A certificate of a host's process, and why it was made; `reason` is empty where the old one stays."""

    host: str
    common_name: str
    valid_until: datetime.datetime
    reason: str = ""


def issue(layout: Layout, folder: Path, at: datetime.datetime, all_anew: bool = False) -> list[Issued]:
    """Make the authority if there is none, and what certificates are missing or about to expire.

    Files, below `folder`: `authority/` with the authority's own, and `{host}/certificates/` with what goes to a host.

    Raises:
        AuthorityError: where the authority has expired or cannot be read.
        OSError: where a file cannot be written.
    """
    signer = _authority(layout, folder / AUTHORITY_FOLDER, at)
    issued: list[Issued] = []
    for host in layout.hosts:
        home = folder / host.name / CERTIFICATES
        home.mkdir(parents=True, exist_ok=True, mode=0o700)
        _write(home / AUTHORITY_FILE, _pem(signer.certificate))
        for process in host.processes:
            address = host.address if process.kind in ANSWERING else ""
            issued.append(_leaf(layout, signer, home, process.common_name, address, at, host.name, all_anew))
        _remove_others(home, {process.common_name for process in host.processes})
    return issued


def _authority(layout: Layout, folder: Path, at: datetime.datetime) -> Signer:
    key_file, certificate_file = folder / AUTHORITY_KEY, folder / AUTHORITY_FILE
    if not key_file.exists() and not certificate_file.exists():
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        made = _new_authority(layout, at)
        _write(key_file, _private(made.key))
        _write(certificate_file, _pem(made.certificate))
        return made
    try:
        key = serialization.load_pem_private_key(key_file.read_bytes(), None)
        certificate = x509.load_pem_x509_certificate(certificate_file.read_bytes())
    except (OSError, ValueError, TypeError) as error:
        raise AuthorityError(f"the authority in {folder} cannot be read ({error}); put its two files back") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise AuthorityError(f"{key_file} is no key on an elliptic curve, as this program makes them")
    if at + datetime.timedelta(days=layout.leaf_days) > certificate.not_valid_after_utc:
        ends = f"ends on {certificate.not_valid_after_utc:%Y-%m-%d}, before a new certificate would"
        raise AuthorityError(f"the authority {ends}; move {folder} away to make a new one, then install on every host")
    return Signer(certificate, key)


def _new_authority(layout: Layout, at: datetime.datetime) -> Signer:
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"SutureGrasp rig {layout.rig}")
    builder = _builder(name, name, key.public_key(), at, layout.authority_days)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_usage(_USAGES_OF_AUTHORITIES), critical=True)
    identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    return Signer(builder.add_extension(identifier, critical=False).sign(key, hashes.SHA256()), key)


def _leaf(
    layout: Layout, signer: Signer, home: Path, name: str, address: str, at: datetime.datetime, host: str, anew: bool
) -> Issued:
    certificate_file, key_file = home / f"{name}.pem", home / f"{name}.key"
    reason = "all are made anew" if anew else _why_anew(certificate_file, key_file, signer, address, at)
    if not reason:
        kept = x509.load_pem_x509_certificate(certificate_file.read_bytes())
        return Issued(host, name, kept.not_valid_after_utc)
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _builder(_name(name), signer.certificate.subject, key.public_key(), at, layout.leaf_days)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(_usage(("digital_signature",)), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage(_roles(address)), critical=False)
    authority = x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.key.public_key())
    builder = builder.add_extension(authority, critical=False)
    if address:
        builder = builder.add_extension(x509.SubjectAlternativeName([_alternative(address)]), critical=False)
    made = builder.sign(signer.key, hashes.SHA256())
    _write(key_file, _private(key))
    _write(certificate_file, _pem(made))
    return Issued(host, name, made.not_valid_after_utc, reason)


def _why_anew(certificate_file: Path, key_file: Path, signer: Signer, address: str, at: datetime.datetime) -> str:
    try:
        old = x509.load_pem_x509_certificate(certificate_file.read_bytes())
        key = serialization.load_pem_private_key(key_file.read_bytes(), None)
    except FileNotFoundError:
        return "it was missing"
    except (OSError, ValueError, TypeError):
        return "it could not be read"
    if _spki(old.public_key()) != _spki(key.public_key()):
        return "its key was another one's"
    try:
        old.verify_directly_issued_by(signer.certificate)
    except Exception:  # whatever is wrong with its signature
        return "it was another authority's"
    if address and _addresses(old) != [_alternative(address)]:
        return "its host's address has changed"
    if old.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value != x509.ExtendedKeyUsage(_roles(address)):
        return "it did not allow what it is needed for"
    left, whole = old.not_valid_after_utc - at, old.not_valid_after_utc - old.not_valid_before_utc
    if left <= datetime.timedelta():
        return "it had expired"
    return "little of its time was left" if left < max(RENEWED_WITH_LEFT * whole, RENEWED_WITHIN) else ""


def _roles(address: str) -> list[x509.ObjectIdentifier]:
    """All but routers and the operator's page only call; they call too."""
    server = [ExtendedKeyUsageOID.SERVER_AUTH] if address else []
    return [*server, ExtendedKeyUsageOID.CLIENT_AUTH]


def _addresses(certificate: x509.Certificate) -> list[x509.GeneralName]:
    try:
        return list(certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value)
    except x509.ExtensionNotFound:
        return []


def _remove_others(home: Path, names: Iterable[str]) -> None:
    """What runs elsewhere now has no business here."""
    kept = {AUTHORITY_FILE} | {f"{name}.{ending}" for name in names for ending in ("pem", "key")}
    for path in home.iterdir():
        if path.name not in kept and path.suffix in (".pem", ".key"):
            path.unlink()


def _builder(
    subject: x509.Name, issuer: x509.Name, public: ec.EllipticCurvePublicKey, at: datetime.datetime, days: int
) -> x509.CertificateBuilder:
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(issuer).public_key(public)
    builder = builder.serial_number(x509.random_serial_number())
    return builder.not_valid_before(at - CLOCKS_APART).not_valid_after(at + datetime.timedelta(days=days))


def _usage(granted: Iterable[str]) -> x509.KeyUsage:
    rights = {name: name in granted for name in (*_USAGES, *_USAGES_OF_AUTHORITIES)}
    return x509.KeyUsage(**rights, encipher_only=False, decipher_only=False)


def _alternative(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(address))
    except ValueError:
        return x509.DNSName(address)


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _spki(key: PublicKeyTypes) -> bytes:
    return key.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _private(key: ec.EllipticCurvePrivateKey) -> bytes:
    encoding, encryption = serialization.Encoding.PEM, serialization.NoEncryption()
    return key.private_bytes(encoding, serialization.PrivateFormat.PKCS8, encryption)


def _write(path: Path, content: bytes) -> None:
    """Whole or not at all, and a key for its owner alone from its first byte on."""
    beside = path.with_name(f".{path.name}")
    beside.unlink(missing_ok=True)
    beside.touch(mode=0o600 if path.suffix == ".key" else 0o644)
    beside.write_bytes(content)
    beside.replace(path)
