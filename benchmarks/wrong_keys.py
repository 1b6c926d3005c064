"""How many messages come under a wrong key after a link to a router broke and is back at once, with Zenoh alone.

    python -m benchmarks.wrong_keys [--breaks 8]

One session is linked with a router through a relay, which stops carrying anything, as a network does that is cut off;
new links it takes at once. So both ends give the old link up after its lease, and the session connects again while the
router is still writing to the old one. All messages say the key that they were sent under, and whoever gets one
compares; this project's runtime does so itself. How it comes about is told in docs/faults.md.
"""

import argparse
import contextlib
import functools
import json
import multiprocessing
import socket
import threading
from collections import Counter
from collections.abc import Callable, Generator
from importlib.metadata import version
from typing import Any

import zenoh

from benchmarks.freezing_relay import Relay
from schemas.topics import HEARTBEAT, key
from shared.runtime.attachment import encoding_of
from shared.runtime.delivery import declare_publisher, subscribe

LEASE_S, KEYS, PAUSE_S, ROUNDS_AFTER_S, ENDS_S = 1.0, 20, 0.01, 3.0, 5.0
FILLING = b"#" * 8000
"""Behind each key, so that what the router cannot send soon fills the room that the system has for it."""
WAYS = (
    "to a subscriber behind the link",
    "to one of this project's runtime",
    "from a declared publisher behind the link",
    "from the session behind the link, by the key's text",
)


class Counts:
    """What came by each way, and how much of it under another key than its own."""

    def __init__(self) -> None:
        self.came, self.wrong, self.examples = Counter[str](), Counter[str](), dict[str, tuple[str, str]]()
        self.refused = 0

    def refuse(self, _under: str, _named: str) -> None:
        """Count what this project's runtime refused."""
        self.refused += 1

    def note(self, way: str, under: str, payload: bytes) -> None:
        """Count something that came under a key."""
        said = payload.partition(b"#")[0].decode()
        self.came[way] += 1
        if said != under:
            self.wrong[way] += 1
            self.examples.setdefault(way, (said, under))


def main() -> None:
    """Break the link again and again, and print what came under wrong keys."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--breaks", type=int, default=8)
    breaks = parser.parse_args().breaks
    counts = measured(breaks)
    rows = [[way, str(counts.came[way]), str(counts.wrong[way]), _example(counts, way)] for way in WAYS]
    print(f"Zenoh {version('eclipse-zenoh')}, {breaks} breaks, lease {LEASE_S:g} s, {KEYS} keys each way\n")
    for row in (["way", "came", "wrong", "for instance"], ["---"] * 4, *rows):
        print(f"| {' | '.join(row)} |")
    print(f"\nrefused by this project's runtime: {counts.refused}")
    if counts.wrong[WAYS[1]]:
        raise SystemExit("this project's runtime handed over what names another key")
    if not counts.wrong[WAYS[0]]:
        raise SystemExit("nothing came under a wrong key: say more breaks, or Zenoh has mended it")


def measured(breaks: int) -> Counts:
    """What came while a link broke so often."""
    counts = Counts()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with (
        _router(port),
        contextlib.closing(Relay(port)) as relay,
        _client(port) as beside,
        _client(relay.port) as behind,
        _speaking(counts, beside, behind),
    ):
        turn = threading.Event()
        turn.wait(ROUNDS_AFTER_S)
        for _ in range(breaks):
            relay.freeze()
            turn.wait(LEASE_S + ROUNDS_AFTER_S)
    return counts


@contextlib.contextmanager
def _speaking(counts: Counts, beside: zenoh.Session, behind: zenoh.Session) -> Generator[None]:
    """Both sessions say something under all keys, again and again, and note what they hear."""
    ended = threading.Event()
    ways: list[Callable[[], None]] = []
    kept: list[Any] = []
    for heard, says, way, topic, filling in (
        (behind, _declared(beside, kept), WAYS[0], "to", FILLING),
        (beside, _declared(behind, kept), WAYS[2], "from", b""),
        (beside, _by_text(behind), WAYS[3], "text", b""),
    ):
        keys = [f"lab/arm{number}/{topic}" for number in range(KEYS)]
        kept += [heard.declare_subscriber(one, _noting(counts, way)) for one in keys]
        ways.append(functools.partial(_say, says, keys, filling))
    keys = [key("lab", HEARTBEAT, f"arm{number}") for number in range(KEYS)]
    for one in keys:
        kept += subscribe(behind, one, HEARTBEAT, _noting(counts, WAYS[1]), lambda _: None, None, counts.refuse)
    publishers = {one: declare_publisher(beside, one, HEARTBEAT) for one in keys}
    kept += publishers.values()
    ways.append(functools.partial(_say, lambda one, said: publishers[one].put(said), keys, b""))
    threads = [threading.Thread(target=_again, args=(way, ended), daemon=True) for way in ways]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads:
            thread.join()
        for declared in kept:
            declared.undeclare()


def _say(says: Callable[[str, bytes], Any], keys: list[str], filling: bytes) -> None:
    for one in keys:
        says(one, one.encode() + filling)


def _again(way: Callable[[], None], ended: threading.Event) -> None:
    while not ended.wait(PAUSE_S):
        way()


def _declared(session: zenoh.Session, kept: list[Any]) -> Callable[[str, bytes], None]:
    publishers: dict[str, Any] = {}

    def put(under: str, payload: bytes) -> None:
        if under not in publishers:
            publishers[under] = session.declare_publisher(under, encoding=encoding_of(HEARTBEAT.message, under))
            kept.append(publishers[under])
        publishers[under].put(payload)

    return put


def _by_text(session: zenoh.Session) -> Callable[[str, bytes], None]:
    return lambda under, payload: session.put(under, payload, encoding=encoding_of(HEARTBEAT.message, under))


def _noting(counts: Counts, way: str) -> Callable[[zenoh.Sample], None]:
    return lambda sample: counts.note(way, str(sample.key_expr), bytes(sample.payload))


@contextlib.contextmanager
def _router(port: int) -> Generator[None]:
    """In a process of its own, for its threads are to be its own."""
    context = multiprocessing.get_context("spawn")
    ended = context.Event()
    process = context.Process(target=_route, args=(port, ended), daemon=True)
    process.start()
    try:
        yield
    finally:
        ended.set()
        process.join(ENDS_S)
        process.kill()


def _route(port: int, ended: Any) -> None:
    zenoh.init_log_from_env_or("off")
    with zenoh.open(_config({"mode": "router", "listen/endpoints": [f"tcp/127.0.0.1:{port}"], "scouting/delay": 0})):
        ended.wait()


def _client(port: int) -> zenoh.Session:
    return zenoh.open(
        _config(
            {
                "mode": "client",
                "connect/endpoints": [f"tcp/127.0.0.1:{port}"],
                "connect/timeout_ms": -1,
                "connect/exit_on_failure": False,
                "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
            }
        )
    )


def _config(settings: dict[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    common = {
        "scouting/multicast/enabled": False,
        "transport/link/tx/lease": round(LEASE_S * 1e3),
        "transport/shared_memory/enabled": False,
    }
    for name, value in (common | settings).items():
        config.insert_json5(name, json.dumps(value))
    return config


def _example(counts: Counts, way: str) -> str:
    return " came as ".join(counts.examples[way]) if way in counts.examples else "-"


if __name__ == "__main__":
    main()
