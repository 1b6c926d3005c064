"""Connections that must not come about: without certificate, of another authority, out of date, and no TLS at all."""

import contextlib
import re
import socket
import ssl
from collections.abc import Callable

from tests.rigs.intruder.rig import DESK, Rig, Row, certificates

WAIT_S = 5.0
TOLD = re.compile(r"a link was refused: (?P<reason>.*) \((?P<count>\d+) so far\)")
NAME = "camera.main"


def refused_connections(rig: Rig, count: int) -> list[Row]:
    """A row for each kind; the router tells of the first refused link of a reason and of each hundredth after it."""
    kinds = {
        "no certificate": "",
        "certificate of another authority": "foreign",
        "certificate out of date": "expired",
        "no TLS at all": None,
    }
    return [_tried(rig, name, lambda kind=kind: _gets_in(rig, kind), count) for name, kind in kinds.items()]


def _tried(rig: Rig, name: str, attempt: Callable[[], bool], count: int) -> Row:
    before = sum(_counted(rig).values())
    within = sum(attempt() for _ in range(count))
    # the hundreds alone are told
    told = 100 * ((count - 1) // 100) + 1
    with contextlib.suppress(TimeoutError):
        rig.until(lambda: sum(_counted(rig).values()) - before >= told, "the router to tell", WAIT_S)
    refused = sum(_counted(rig).values()) - before
    return Row(f"link: {name}", count, within, count if refused == told else refused, barred=True)


def _counted(rig: Rig) -> dict[str, int]:
    """By reason, how many links the router has told of."""
    counts: dict[str, int] = {}
    for kind, text in list(rig.heard.logged):
        if kind == "router" and (found := TOLD.search(text)):
            counts[found["reason"]] = max(counts.get(found["reason"], 0), int(found["count"]))
    return counts


def _gets_in(rig: Rig, kind: str | None) -> bool:
    """Whether the router lets us speak with such certificates, or without TLS.

    What it refuses it closes, once it has seen the certificate.
    """
    address = rig.config.hosts[DESK].address
    with contextlib.suppress(OSError), socket.create_connection((address, rig.config.router.port), WAIT_S) as plain:
        if kind is None:
            plain.sendall(b"no handshake at all" * 20)
            # an alert of TLS is all that comes
            return plain.recv(64)[:1] not in (b"", b"\x15")
        context = ssl.create_default_context(cafile=certificates(rig.folder) / "authority.pem")
        if kind:
            own = certificates(rig.folder, kind)
            context.load_cert_chain(own / f"{NAME}.pem", own / f"{NAME}.key")
        try:
            with context.wrap_socket(plain, server_hostname=address) as link:
                link.settimeout(WAIT_S)
                return link.recv(1) != b""
        except TimeoutError:
            # it waits for us to speak
            return True
    return False
