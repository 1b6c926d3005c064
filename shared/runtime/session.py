"""A Zenoh session from a few settings, and the settings of a router.

Agents are clients of one router: they wait for one that is not up yet, and come back within a fraction of a second
when it restarts. Nothing is scouted for by multicast.
"""

import json
import socket
from dataclasses import dataclass

import zenoh

LOCAL_ENDPOINT = "tcp/127.0.0.1:7447"
LEASE_MS = 2000
BATCHES_WAITING = 16
"""Of states and results, for a busy machine's turn to send: Zenoh's own 2 are full within 20 ms at 100 Hz, and what
finds no room for a millisecond is lost. Consumers take the newest of what comes late."""


class RouterError(RuntimeError):
    """A router that cannot be started; the text names the remedy."""


@dataclass(frozen=True)
class SessionSettings:
    """How an agent reaches the dataflow.

    Fields:
        rig: name of the rig, the second part of every key.
        endpoint: of the router, as Zenoh writes it.
    """

    rig: str = "lab"
    endpoint: str = LOCAL_ENDPOINT


def open_session(settings: SessionSettings) -> zenoh.Session:
    """A session of a client of the router; it waits for the router, and heeds no signal meanwhile."""
    config = _config(
        {
            "mode": "client",
            "connect/endpoints": [settings.endpoint],
            "connect/timeout_ms": -1,
            "connect/exit_on_failure": False,
            "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
        }
    )
    return zenoh.open(config)


def open_router(endpoint: str) -> zenoh.Session:
    """A session that routes for others, listening on that endpoint.

    Raises:
        RouterError: where the endpoint cannot be listened on.
    """
    try:
        # nobody is scouted for, so there is nobody to wait for
        return zenoh.open(_config({"mode": "router", "listen/endpoints": [endpoint], "scouting/delay": 0}))
    except zenoh.ZError:
        raise RouterError(
            f"no router can listen on {endpoint}: another one may be running there; stop it, or use another endpoint"
        ) from None


def runs_already(session: zenoh.Session, rig: str, kind: str, instance: str) -> bool:
    """Whether an agent of that kind and instance is alive: two that drive one arm would fight over it."""
    replies = session.liveliness().get(f"suturegrasp/{rig}/{kind}/{instance}", timeout=1.0)
    return any(reply.ok is not None for reply in replies)


def free_local_endpoint() -> str:
    """An endpoint on this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def _config(settings: dict[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    common = {
        "scouting/multicast/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/queue/size/real_time": BATCHES_WAITING,
        "transport/link/tx/queue/size/data_high": BATCHES_WAITING,
    }
    for name, value in (common | settings).items():
        config.insert_json5(name, json.dumps(value))
    return config
