"""Connections that must not come about: without certificate, of another authority, out of date, and no TLS at all."""

import contextlib
import re
import socket
import ssl
from collections.abc import Callable

from tests.rigs.intruder.rig import DESK, Rig
from tests.rigs.intruder.rows import Row

WAIT_S = 5.0
TOLD = re.compile(r"a link was refused: (?P<reason>.*) \((?P<count>\d+) so far\)")
NAME = "camera.main"


def refused_connections(rig: Rig, count: int) -> list[Row]:
    """A row for each kind; the router tells of the first refused link of a reason and of each hundredth after it."""
    address, port = rig.config.hosts[DESK].address, rig.config.router.port

    def connect(folder: str) -> bool:
        return _gets_in(address, port, _context(rig, folder))

    kinds: dict[str, Callable[[], bool]] = {
        "no certificate": lambda: connect(""),
        "certificate of another authority": lambda: connect("foreign"),
        "certificate out of date": lambda: connect("expired"),
        "no TLS at all": lambda: _garbage_gets_in(address, port),
    }
    return [_tried(rig, name, attempt, count) for name, attempt in kinds.items()]


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


def _context(rig: Rig, folder: str) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=rig.certificates / "authority.pem")
    if folder:
        own = rig.folder / folder / DESK / "certificates"
        context.load_cert_chain(own / f"{NAME}.pem", own / f"{NAME}.key")
    return context


def _gets_in(address: str, port: int, context: ssl.SSLContext) -> bool:
    """Whether the router lets us speak: what it refuses it closes, once it has seen the certificate."""
    try:
        with (
            socket.create_connection((address, port), WAIT_S) as plain,
            context.wrap_socket(plain, server_hostname=address) as link,
        ):
            link.settimeout(WAIT_S)
            return link.recv(1) != b""
    except TimeoutError:
        # it waits for us to speak
        return True
    except OSError:
        return False


def _garbage_gets_in(address: str, port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection((address, port), WAIT_S) as plain:
        plain.sendall(b"no handshake at all" * 20)
        # an alert of TLS is all that comes
        return plain.recv(64)[:1] not in (b"", b"\x15")
    return False
