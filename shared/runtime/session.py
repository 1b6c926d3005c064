"""A Zenoh session from a few settings, and the settings of a router.

Agents are clients of one router: they wait for one that is not up yet, and come back within a fraction of a second
when it restarts. Nothing is scouted for by multicast. Off loopback both sides of every link show a certificate.
"""

import ipaddress
import json
import logging
import os
import re
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from schemas.topics import Topic, key_root
from shared.clock import monotonic_s
from shared.runtime.identity import Identity, IdentityError, check_identity

LOCAL_ENDPOINT = "tcp/127.0.0.1:7447"
LEASE_MS = 2000
BATCHES_WAITING = 16
"""Of states and results, for a busy machine's turn to send: Zenoh's own 2 are full within 20 ms at 100 Hz, and what
finds no room for a millisecond is lost. Consumers take the newest of what comes late."""
RUNTIME_VARIABLE, ROUTER_RUNTIME = "ZENOH_RUNTIME", "(rx: (worker_threads: 32))"
"""Threads of a router that receive. Closing a link whose other end is gone holds one of them up for 10 s (SO_LINGER);
with Zenoh's own 2, one host cut off, with three agents on it, left the whole rig unheard. A zenohd needs it too."""
SHARED_FROM_BYTES = 1 << 14
"""What is smaller goes by network even on one host: a surface, say. Whoever is given shared memory has two threads more
that look after it thirty times a second, however seldom something comes."""
COMMON: dict[str, Any] = {
    "scouting/multicast/enabled": False,
    "transport/link/tx/lease": LEASE_MS,
    "transport/shared_memory/transport_optimization/message_size_threshold": SHARED_FROM_BYTES,
    "transport/link/tx/queue/size/real_time": BATCHES_WAITING,
    "transport/link/tx/queue/size/data_high": BATCHES_WAITING,
}
RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}

ENDPOINT = re.compile(r"(?P<protocol>[a-z-]+)/(?P<host>.+):(?P<port>\d{1,5})")

NO_SHARED_MEMORY = "shm"
"""In what Zenoh says where it can make no shared memory."""
REMEDY = "allow locked memory (LimitMEMLOCK=infinity in the unit, ulimit -l), and room in /dev/shm"

LOG = logging.getLogger("suturegrasp.session")

Session = zenoh.Session
"""For those who pass one on and know nothing of Zenoh."""


class RouterError(RuntimeError):
    """A router that cannot be started; the text names the remedy."""


@dataclass(frozen=True)
class SessionSettings:
    """How an agent reaches the dataflow.

    Fields:
        rig: name of the rig, the second part of every key.
        endpoint: of the router, as Zenoh writes it.
        identity: the certificate to show; None on loopback.
        otherwise: rows of the topic table as this rig has them, where it has them otherwise.
    """

    rig: str = "lab"
    endpoint: str = LOCAL_ENDPOINT
    identity: Identity | None = None
    otherwise: tuple[Topic, ...] = ()


def open_session(settings: SessionSettings) -> zenoh.Session:
    """A session of a client of the router; it waits for the router, and heeds no signal meanwhile.

    Raises:
        IdentityError: where the endpoint is off loopback and the certificate is missing or not valid.
    """
    return opened(client_settings(settings))


def client_settings(settings: SessionSettings) -> dict[str, Any]:
    """What a client of the router is told: keys of Zenoh's configuration, with `/` between their parts.

    Raises:
        IdentityError: as for `open_session`.
    """
    check_security(settings.endpoint, settings.identity)
    client = {
        "mode": "client",
        "connect/endpoints": [settings.endpoint],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": RETRY,
    }
    return COMMON | client | _tls(settings.identity)


def router_settings(
    endpoint: str,
    identity: Identity | None = None,
    access: dict[str, Any] | None = None,
    others: tuple[str, ...] = (),
) -> dict[str, Any]:
    """What a router is told, ours or zenohd: keys of Zenoh's configuration, with `/` between their parts.

    `access` is its access control, see `shared.runtime.access`; `others` are endpoints of routers that it connects to,
    again and again where one does not answer.
    """
    # nobody is scouted for, so there is nobody to wait for
    settings = COMMON | {"mode": "router", "listen/endpoints": [endpoint], "scouting/delay": 0} | _tls(identity)
    if others:
        settings |= {"connect/endpoints": list(others), "connect/retry": RETRY, "connect/exit_on_failure": False}
    return settings if access is None else settings | {"access_control": access}


def open_router(
    endpoint: str,
    identity: Identity | None = None,
    access: dict[str, Any] | None = None,
    others: tuple[str, ...] = (),
) -> zenoh.Session:
    """A session that routes for others, listening on that endpoint, and linked to routers of other endpoints.

    Raises:
        RouterError: where the endpoint cannot be listened on.
        IdentityError: where the endpoint is off loopback and the certificate is missing or not valid.
    """
    for one in (endpoint, *others):
        check_security(one, identity)
    # read when the first session of a process is opened
    os.environ.setdefault(RUNTIME_VARIABLE, ROUTER_RUNTIME)
    try:
        return opened(router_settings(endpoint, identity, access, others))
    except zenoh.ZError as error:
        said = str(error).split(" at /")[0]
        raise RouterError(
            f"no router can listen on {endpoint} ({said}): another one may be running there; stop it, or use another "
            "endpoint"
        ) from None


def open_from(file: Path) -> zenoh.Session:
    """A session as a file of Zenoh's own says, such as one that is written for zenohd.

    Raises:
        RouterError: where it cannot be read, or says what cannot be done.
    """
    os.environ.setdefault(RUNTIME_VARIABLE, ROUTER_RUNTIME)
    try:
        return zenoh.open(zenoh.Config.from_file(str(file)))
    except zenoh.ZError as error:
        raise RouterError(f"{file} is no configuration that Zenoh takes: {str(error).split(' at /')[0]}") from None


def have_links_logged() -> None:
    """Have Zenoh say on standard output what is wrong with links, unless RUST_LOG asks for something else already."""
    os.environ.setdefault("RUST_LOG", "zenoh_link_tls=warn,zenoh_transport=warn")
    zenoh.try_init_log_from_env()


def check_security(endpoint: str, identity: Identity | None) -> None:
    """Refuse what would leave this machine without certificates on both sides.

    Raises:
        IdentityError: where it would, or where the certificate cannot be used.
    """
    if identity is not None:
        check_identity(identity)
    if on_loopback(endpoint):
        return
    if identity is None or not endpoint.startswith("tls/"):
        raise IdentityError(
            f"{endpoint} leaves this machine, which needs certificates on both sides (mutual TLS): describe [hosts] "
            "and [security] in the rig's file, see docs/deployment.md"
        )


def host_of(endpoint: str) -> str:
    """The address that an endpoint names; empty where it is no endpoint."""
    found = ENDPOINT.fullmatch(endpoint)
    return "" if found is None else found["host"].strip("[]")


def on_loopback(endpoint: str) -> bool:
    """Whether an endpoint is of this machine alone."""
    host = host_of(endpoint)
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def runs_already(session: zenoh.Session, rig: str, kind: str, instance: str) -> bool:
    """Whether an agent of that kind and instance is alive: two that drive one arm would fight over it."""
    replies = session.liveliness().get(key_root(rig, instance, kind), timeout=1.0)
    return any(reply.ok is not None for reply in replies)


def present(session: zenoh.Session, roots: str) -> list[tuple[str, str, str]] | None:
    """Which agents are there whose keys begin so: rig, kind and instance; None where the router gives no answer."""
    replies = list(session.liveliness().get(roots, timeout=1.0))
    if any(reply.err is not None for reply in replies):
        return None
    names = (str(reply.ok.key_expr).split("/") for reply in replies if reply.ok is not None)
    return sorted((rig, kind, instance) for _, rig, kind, instance in names)


def free_local_endpoint() -> str:
    """An endpoint on this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def _tls(identity: Identity | None) -> dict[str, Any]:
    """Both sides show a certificate, and a link ends when that of the other side does."""
    if identity is None:
        return {}
    own = {"certificate": str(identity.certificate), "private_key": str(identity.key)}
    tls = {
        "root_ca_certificate": str(identity.authority),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
    tls |= {f"{side}_{name}": path for side in ("listen", "connect") for name, path in own.items()}
    return {"transport/link/tls": tls}


def opened(settings: dict[str, Any]) -> zenoh.Session:
    """A session with these settings; where the system grants no shared memory, one that sends all by network."""
    try:
        return zenoh.open(_config(settings))
    except zenoh.ZError as error:
        if NO_SHARED_MEMORY not in str(error):
            raise
        said = str(error).split(" at /")[0]
        LOG.warning("large messages go by network, for no memory can be shared (%s): %s", said, REMEDY)
        return zenoh.open(_config(settings | {"transport/shared_memory/enabled": False}))


def _config(settings: dict[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for name, value in (COMMON | settings).items():
        config.insert_json5(name, json.dumps(value))
    return config


ENDS_S = 5.0


class RouterWatch:
    """Tells in a sentence of each time that the link was down, once it is up again, from a thread of its own."""

    def __init__(self, session: zenoh.Session, tell: Callable[[str], None]) -> None:
        self._listener = session.info.declare_transport_events_listener(zenoh.handlers.FifoChannel(16))
        self._thread = threading.Thread(target=_watch, args=(self._listener.handler, tell), name="router", daemon=True)
        self._thread.start()

    def undeclare(self) -> None:
        """End it: a thread that is still inside Zenoh when the interpreter ends aborts the process."""
        self._listener.undeclare()
        self._thread.join(ENDS_S)


def _watch(events: Any, tell: Callable[[str], None]) -> None:
    down_s: float | None = None
    try:
        while True:
            event = events.recv()
            if event.kind == zenoh.SampleKind.DELETE:
                down_s = down_s or monotonic_s()
            elif down_s is not None:
                away_s, down_s = monotonic_s() - down_s, None
                tell(f"the link to the router broke, and was back after {away_s:.1f} s")
    except zenoh.ZError:
        return
