"""A certificate of the lab's own authority, by which a process proves on every link which agent it is."""

from dataclasses import dataclass
from pathlib import Path

from shared.clock import now_ns
from shared.runtime.config import ConfigError

AUTHORITY_FILE = "authority.pem"
NS_PER_S = 1_000_000_000


class IdentityError(ConfigError):
    """A certificate that cannot be used; the text names the file and the remedy."""


@dataclass(frozen=True)
class Identity:
    """Where a process's certificate lies.

    Fields:
        authority: certificate of the lab's authority (PEM), which the other side's is checked against.
        certificate: its own (PEM).
        key: the private key of that.
    """

    authority: Path
    certificate: Path
    key: Path


def identity_in(folder: Path, name: str) -> Identity:
    """The identity of a common name, such as `camera.main`, in a folder of certificates."""
    return Identity(folder / AUTHORITY_FILE, folder / f"{name}.pem", folder / f"{name}.key")


def check_identity(identity: Identity) -> None:
    """Say what Zenoh would not: a link with a bad certificate merely times out.

    Raises:
        IdentityError: where a file is missing or cannot be read, or the certificate is not valid now.
    """
    for path in (identity.authority, identity.certificate, identity.key):
        try:
            path.open("rb").close()
        except OSError as error:
            reason = error.strerror or "cannot be read"
            made = "suturegrasp deploy certificates makes it, and deploy install puts it where an installed rig has it"
            raise IdentityError(f"{path}: {reason}; {made}") from None
    begins_ns, ends_ns = validity_ns(identity.certificate)
    at_ns = now_ns()
    if at_ns >= ends_ns:
        raise IdentityError(f"{identity.certificate} has expired; renew it with suturegrasp deploy certificates")
    if at_ns < begins_ns:
        raise IdentityError(f"{identity.certificate} is not valid yet; set this machine's clock")


def validity_ns(certificate: Path) -> tuple[int, int]:
    """When a certificate begins and ends to be valid, in nanoseconds of Unix time.

    Raises:
        IdentityError: where the file cannot be read or holds no certificate.
    """
    # loading it takes as long as an operator's whole command, and most rigs on one machine never need it
    from cryptography import x509

    try:
        read = x509.load_pem_x509_certificate(certificate.read_bytes())
    except (OSError, ValueError):
        raise IdentityError(f"{certificate} holds no certificate; suturegrasp deploy certificates makes one") from None
    begins, ends = read.not_valid_before_utc, read.not_valid_after_utc
    return round(begins.timestamp()) * NS_PER_S, round(ends.timestamp()) * NS_PER_S
