"""How many events are lost over killed routers and links that are cut: by our subscriber, and by Zenoh's own."""

import contextlib
import signal
import subprocess
import sys
import threading
from collections.abc import Generator, Iterable
from typing import Any

from zenoh import ext

from benchmarks.hop_ends import AGENT, RIG, Load, message_of
from benchmarks.hops import router
from schemas.codec import encode
from schemas.topics import LOG, key
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import declare_publisher, subscribe
from shared.runtime.session import SessionSettings, free_local_endpoint, open_session

KILLS, AWAY_S = 4, 0.5
CUTS, CUT_S = 4, 3.0
"""Of the listeners' links and of the senders' in turn; Zenoh gives a link up after 2 s of silence."""
BACK_S, SETTLES_S, SENDERS, RATE_HZ = 3.0, 10.0, 3, 50.0
RELAY_PROGRAM = """
import asyncio, contextlib, signal, sys

is_cut, ends = False, set()

def cut():
    global is_cut
    is_cut = not is_cut
    for end in () if is_cut else ends:
        end.transport.abort()

async def pass_on(reader, writer):
    while data := await reader.read(65536):
        if not is_cut:
            writer.write(data)

async def relay(reader, writer):
    with contextlib.suppress(OSError), contextlib.closing(writer):
        there, back = await asyncio.open_connection("127.0.0.1", int(sys.argv[2]))
        with contextlib.closing(back):
            ends.update((writer, back))
            ways = [asyncio.create_task(pass_on(*way)) for way in ((reader, back), (there, writer))]
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            ends.difference_update((writer, back))

async def main():
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, cut)
    server = await asyncio.start_server(relay, "127.0.0.1", int(sys.argv[1]))
    print("up", flush=True)
    await server.serve_forever()

asyncio.run(main())
"""
"""Passes on what comes over TCP. What comes while it is cut is lost, and no link outlives that."""


def advanced_subscriber(session: Any, name: str, _lossless: bool, most: int, receive: Any, *_told: Any) -> Any:
    """Zenoh's own, in the place of `shared.runtime.lossless.LosslessSubscriber`."""
    history = ext.HistoryConfig(detect_late_publishers=True, max_samples=most)
    recovery = ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
    return ext.declare_advanced_subscriber(session, name, receive, history=history, recovery=recovery)


def lost_events() -> dict[str, int]:
    """Events that were sent meanwhile, and those of them that either subscriber never had."""
    endpoint, pause = free_local_endpoint(), threading.Event()
    heard: tuple[set[tuple[str, bytes]], ...] = set(), set()
    with contextlib.ExitStack() as stack:
        up = stack.enter_context(contextlib.ExitStack())
        up.enter_context(router(endpoint))
        links = [stack.enter_context(_relay(endpoint)) for _ in range(2 + SENDERS)]
        ours, zenohs, *senders = (stack.enter_context(open_session(SessionSettings(RIG, at))) for at, _ in links)
        takes = [lambda sample, to=to: to.add((str(sample.key_expr), sample.attachment.to_bytes())) for to in heard]
        everybodys = key(RIG, LOG, "*", "*")
        kept = (
            subscribe(ours, everybodys, LOG, takes[0], lambda _: None),
            advanced_subscriber(zenohs, everybodys, True, LOG.kept, takes[1]),
        )
        names = [key(RIG, LOG, f"sender{i}", AGENT) for i in range(SENDERS)]
        publishers = [declare_publisher(at, name, LOG) for at, name in zip(senders, names, strict=True)]
        pause.wait(BACK_S)
        with contextlib.ExitStack() as sending:
            sent = [sending.enter_context(_publishing(publisher)) for publisher in publishers]
            for _ in range(KILLS):
                pause.wait(BACK_S)
                up.close()
                pause.wait(AWAY_S)
                up.enter_context(router(endpoint))
            for turn in range(CUTS):
                pause.wait(BACK_S)
                _cut(links[2:] if turn % 2 else links[:2])
            pause.wait(BACK_S)
        pause.wait(SETTLES_S)
        for publisher in publishers:
            publisher.undeclare()
        for declared in kept:
            declared.undeclare()
    total = sum(map(len, sent))
    ours_missed, zenohs_missed = (total - len(events) for events in heard)
    return {"sent": total, "missed by ours": ours_missed, "missed by Zenoh's own": zenohs_missed}


@contextlib.contextmanager
def _publishing(publisher: Any) -> Generator[list[int]]:
    """The numbers of what was published meanwhile."""
    over, message, sent = threading.Event(), message_of(Load((0, 0), 0, RATE_HZ)), list[int]()

    def publish() -> None:
        while not over.wait(1.0 / RATE_HZ):
            number = len(sent)
            sent.append(number)
            publisher.put(encode(message(number)), attachment=pack(Attachment(1, number, 0, 0.0)))

    thread = threading.Thread(target=publish)
    thread.start()
    yield sent
    over.set()
    thread.join()


@contextlib.contextmanager
def _relay(endpoint: str) -> Generator[tuple[str, "subprocess.Popen[str]"]]:
    """A way to an endpoint that can be made to stand still: where it begins, and its process."""
    at = free_local_endpoint()
    ports = (one.rpartition(":")[2] for one in (at, endpoint))
    command = [sys.executable, "-c", RELAY_PROGRAM, *ports]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n", "the relay has not started"
        yield at, process
        process.kill()


def _cut(links: Iterable[tuple[str, "subprocess.Popen[str]"]]) -> None:
    for _, process in links:
        process.send_signal(signal.SIGUSR1)
    threading.Event().wait(CUT_S)
    for _, process in links:
        process.send_signal(signal.SIGUSR1)
