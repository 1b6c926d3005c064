"""A cable that is slow or loses packets: a relay between ports of the switch and its bridge, and rules of nftables.

Linux' own netem is often left out of kernels. The relay passes Ethernet frames between pairs of ports, each so long
after it came; what comes keeps its order, and nothing is lost but where a port's buffer is full.
"""

import os
import select
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager

from agents.cli.lab.rehearsal.network import SWITCH, Network
from shared.clock import monotonic_s

ALL_PROTOCOLS = 0x0003
ROOM = 4 << 20
LONGEST_FRAME = 65_600
IGNORES_OWN = 23
"""PACKET_IGNORE_OUTGOING of packet(7), which socket does not name."""
SOL_PACKET = 263
READY = "relaying"


@contextmanager
def losing(network: Network, percent: int, hosts: tuple[str, ...]) -> Generator[None]:
    """A share of all packets from and to these hosts is lost, by chance, also where `delayed` has put a relay."""
    ports = tuple(port for host in hosts for port in (network.port(host), f"{network.port(host)}-b"))
    with network.dropping(ports, f"numgen random mod 100 < {percent} drop"):
        yield


@contextmanager
def delayed(network: Network, seconds: float, hosts: tuple[str, ...]) -> Generator[None]:
    """Everything takes so much longer on the links of these hosts, each way."""
    ports = [network.port(host) for host in hosts]
    for port in ports:
        network.within(SWITCH, "ip", "link", "add", f"{port}-r", "type", "veth", "peer", "name", f"{port}-b")
        network.within(SWITCH, "ip", "link", "set", f"{port}-r", "up")
        network.within(SWITCH, "ip", "link", "set", port, "nomaster")
        network.within(SWITCH, "ip", "link", "set", f"{port}-b", "master", "bridge", "up")
    inside = ("ip", "netns", "exec", network.namespace(SWITCH))
    try:
        with relaying(inside, [(port, f"{port}-r") for port in ports], seconds):
            yield
    finally:
        for port in ports:
            network.within(SWITCH, "ip", "link", "delete", f"{port}-b")
            network.within(SWITCH, "ip", "link", "set", port, "master", "bridge")


@contextmanager
def relaying(inside: tuple[str, ...], pairs: list[tuple[str, str]], seconds: float) -> Generator[None]:
    """A process that relays, within a namespace, from when it is ready."""
    command = [*inside, sys.executable, "-m", __name__, str(seconds), *(f"{a}={b}" for a, b in pairs)]
    # it ends with its standard input, even where we are killed
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            if process.stdout is None or process.stdout.readline().strip() != READY:
                raise RuntimeError("the relay did not start")
            yield
        finally:
            process.kill()


def relay(seconds: float, pairs: list[tuple[str, str]]) -> None:
    """Relay until standard input ends."""
    ports = {name: _port(name) for pair in pairs for name in pair}
    other = {**{ports[a]: ports[b] for a, b in pairs}, **{ports[b]: ports[a] for a, b in pairs}}
    waiting: deque[tuple[float, socket.socket, bytes]] = deque()
    poll = select.poll()
    by_number = {port.fileno(): port for port in other}
    for number in (*by_number, 0):
        poll.register(number, select.POLLIN)
    print(READY, flush=True)
    while True:
        wait_s = max(0.0, waiting[0][0] - monotonic_s()) if waiting else 1.0
        for number, _ in poll.poll(1000.0 * wait_s):
            if number == 0:
                return
            _take(by_number[number], other[by_number[number]], seconds, waiting)
        now_s = monotonic_s()
        while waiting and waiting[0][0] <= now_s:
            _, port, frame = waiting.popleft()
            _send(port, frame)


def _port(name: str) -> socket.socket:
    port = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ALL_PROTOCOLS))
    port.setsockopt(SOL_PACKET, IGNORES_OWN, 1)
    port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, ROOM)
    port.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, ROOM)
    port.bind((name, 0))
    port.setblocking(False)
    return port


def _take(
    port: socket.socket, towards: socket.socket, seconds: float, waiting: deque[tuple[float, socket.socket, bytes]]
) -> None:
    try:
        while True:
            waiting.append((monotonic_s() + seconds, towards, port.recv(LONGEST_FRAME)))
    except BlockingIOError:
        return


def _send(port: socket.socket, frame: bytes) -> None:
    try:
        port.send(frame)
    except OSError:
        # a full buffer, or a port that is gone: as on a wire, it is lost
        return


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    relay(float(sys.argv[1]), [tuple(pair.split("=")) for pair in sys.argv[2:]])  # pyright: ignore[reportArgumentType]
    os._exit(0)
