"""Why a rig's router cannot be reached, where it cannot: Zenoh itself would only say that time ran out."""

import re
import socket
import ssl

from agents.configuration.rig import RigConfig
from agents.diagnostics.doctor.finding import Finding
from agents.launch.preflight import TCP, in_the_way
from shared.runtime.identity import Identity
from shared.runtime.session import SessionSettings

ANSWERS_WITHIN_S = 2.0
ANOTHER_AUTHORITY = "it refuses the certificate here, which is of another authority; take this host's folder anew"
ALERTS = {
    "CERTIFICATE_EXPIRED": "it says that the certificate here has expired; renew it, or set the clocks of both hosts",
    "UNKNOWN_CA": ANOTHER_AUTHORITY,
    # one of the same name, with another key
    "DECRYPT_ERROR": ANOTHER_AUTHORITY,
    "CERTIFICATE_REQUIRED": "it asks for a certificate, and was shown none",
    "CERTIFICATE": "it refuses the certificate here; make certificates anew with suturegrasp deploy certificates",
}
"""What the other side's alert means, by a part of its name (RFC 8446, section 6)."""


def no_router(rig: RigConfig, settings: SessionSettings) -> Finding:
    """What to do about a router that does not answer."""
    none = f"none answers on {settings.endpoint}"
    if why := why_not(settings):
        return Finding("router", none, why)
    if rig.runs_here("router"):
        start = "systemctl start suturegrasp-router, or suturegrasp up," if rig.hosts else "suturegrasp up"
        return Finding("router", f"{none} yet; {start} starts one", in_the_way(rig))
    return Finding("router", none, unreached(settings.endpoint))


def why_not(settings: SessionSettings) -> str:
    """Why a router refuses this certificate, or is refused by it; empty where nobody listens or nothing is wrong."""
    address = TCP.fullmatch(settings.endpoint)
    if address is None:
        return ""
    try:
        with _connected(address) as plain:
            return "" if settings.identity is None else _refusal(plain, address["host"].strip("[]"), settings.identity)
    except OSError:
        return ""


def unreached(endpoint: str) -> str:
    """What to do where nobody listens, by how that shows."""
    address = TCP.fullmatch(endpoint)
    start = "start it there: systemctl start suturegrasp-router, or suturegrasp router"
    try:
        if address is not None:
            _connected(address).close()
    except socket.gaierror:
        return "its host's name is not known here; write its IP address, or have the lab's name server tell it"
    except ConnectionRefusedError:
        return f"its host is there, and nobody listens; {start}"
    except OSError as error:
        gone = "did not answer" if isinstance(error, TimeoutError) else (error.strerror or str(error)).lower()
        return f"its host cannot be reached ({gone}): is it on, on this network, and is the port open in its firewall?"
    return start


def _connected(address: re.Match[str]) -> socket.socket:
    return socket.create_connection((address["host"].strip("[]"), int(address["port"])), timeout=ANSWERS_WITHIN_S)


def _refusal(plain: socket.socket, host: str, identity: Identity) -> str:
    try:
        context = ssl.create_default_context(cafile=identity.authority)
        context.load_cert_chain(identity.certificate, identity.key)
        with context.wrap_socket(plain, server_hostname=host) as secured:
            # the other side judges our certificate after the handshake, as we see it
            secured.recv(1)
    except ssl.SSLCertVerificationError as error:
        return (
            f"its own certificate is not good: {error.verify_message}; make certificates anew, and look at the clocks"
        )
    except ssl.SSLError as error:
        alert = (error.reason or "").upper()
        return next((told for name, told in ALERTS.items() if name in alert), f"it ends the handshake: {alert.lower()}")
    except OSError:
        # a router that accepted us waits for Zenoh's first words
        return ""
    return ""
