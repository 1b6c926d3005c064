"""A cable that takes its time: Ethernet frames pass between pairs of ports, each so long after it came.

    python -m agents.cli.lab.rehearsal.relay SECONDS PORT=PORT ...

Linux' own netem is often left out of kernels. What comes keeps its order, and nothing is lost but where a port's buffer
is full.
"""

import array
import fcntl
import os
import select
import signal
import socket
import struct
import subprocess
import sys
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager

from shared.clock import monotonic_s

ALL_PROTOCOLS = 0x0003
ROOM = 4 << 20
LONGEST_FRAME = 65_600
IGNORES_OWN = 23
"""PACKET_IGNORE_OUTGOING of packet(7), which socket does not name."""
SOL_PACKET = 263
SIOCETHTOOL = 0x8946
FLAGS = (0x17, 0x1F, 0x24, 0x2C)
"""Setting transmit checksums, segmentation, and both generic ones (ETHTOOL_STXCSUM, STSO, SGSO, SGRO)."""
READY = "relaying"


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


def send_whole_packets(devices: tuple[str, ...]) -> None:
    """Have these devices send packets as they travel on a wire, checked and no longer than its frames."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for device in devices:
            for flag in FLAGS:
                value = array.array("B", struct.pack("II", flag, 0))
                request = struct.pack("16sP", device.encode(), value.buffer_info()[0])
                fcntl.ioctl(any_socket.fileno(), SIOCETHTOOL, request + b"\0" * 16)


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
