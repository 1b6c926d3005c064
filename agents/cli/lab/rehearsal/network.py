"""Hosts that are network namespaces on a virtual switch, itself in one, and what can go wrong on the way between them.

Everything lies in namespaces named after the process that made them, but for the port of that process itself, so that
removing those few names removes everything; what a killed process left behind is removed by the next one.

A slow cable passes Ethernet frames between pairs of ports, each so long after it came. Linux' own netem is often left
out of kernels. What comes keeps its order, and nothing is lost but where a port's buffer is full.
"""

import array
import fcntl
import ipaddress
import os
import random
import re
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
from collections import deque
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import psutil

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


PREFIX, NETWORK = "sg", "10.213"
SWITCH, OWN = "switch", "own"
OWN_FILES = Path("/etc/netns")
LIMIT_S = 60.0
OWN_MEMORY_AND_NAME = 'mount -t tmpfs shm /dev/shm && hostname "$0" && exec "$@"'
TABLE = "table bridge faults { chain through { type filter hook forward priority 0; }; }"


class CannotError(RuntimeError):
    """This system cannot play hosts, or a fault; the text says what is missing."""


@dataclass(frozen=True)
class Network:
    """Hosts by name, each with an address, and a port of our own at the switch.

    Fields:
        owner: id of the process that made it.
        network: the first three numbers of addresses that nobody has given.
        given: addresses or names that hosts have been given, in which case we have no port of our own.
    """

    owner: int
    network: str
    hosts: tuple[str, ...]
    given: Mapping[str, str] = field(default_factory=dict[str, str])

    def address(self, host: str) -> str:
        """The IP address by which a host, or our own port, is reached by the others."""
        if host in self.given and not self.named(host):
            return self.given[host]
        return f"{self.network}.{1 if host == OWN else 2 + self.hosts.index(host)}"

    def named(self, host: str) -> bool:
        """Whether what a host was given is a name."""
        try:
            ipaddress.ip_address(self.given[host])
        except (KeyError, ValueError):
            return host in self.given
        return False

    def namespace(self, host: str) -> str:
        """The namespace that stands for a host, or for the switch."""
        return f"{PREFIX}{self.owner}{SWITCH if host == SWITCH else self.port(host)}"

    def port(self, host: str) -> str:
        """The switch's port for a host, or for us; names of hosts are longer than devices' may be."""
        return OWN if host == OWN else f"h{self.hosts.index(host)}"

    def inside(self, host: str) -> tuple[str, ...]:
        """What comes before a command that is to run there, with the host's own name.

        Shared memory is the command's own: namespaces of networks have it in common, which hosts have not, and large
        messages would go past the links.
        """
        own = ("unshare", "--uts", "--mount", "sh", "-c", OWN_MEMORY_AND_NAME, host)
        return ("ip", "netns", "exec", self.namespace(host), *own)

    @contextmanager
    def cut_off(self, host: str) -> Generator[None]:
        """Nothing reaches a host, and nothing comes from it."""
        with self._dropping(host, "drop"):
            yield

    @contextmanager
    def losing(self, percent: int, hosts: tuple[str, ...]) -> Generator[None]:
        """A share of all packets from and to these hosts is lost, by chance."""
        with self._dropping(hosts, f"numgen random mod 100 < {percent} drop"):
            yield

    @contextmanager
    def narrowed(self, megabits: int, hosts: tuple[str, ...]) -> Generator[None]:
        """The links of these hosts carry so much per second, each way."""
        shaped = [(SWITCH, self.port(host)) for host in hosts] + [(host, "eth0") for host in hosts]
        for namespace, device in shaped:
            bucket = ("rate", f"{megabits}mbit", "burst", "32k", "latency", "50ms")
            self._within(namespace, "tc", "qdisc", "add", "dev", device, "root", "tbf", *bucket)
        try:
            yield
        finally:
            for namespace, device in shaped:
                _run("ip", "netns", "exec", self.namespace(namespace), "tc", "qdisc", "del", "dev", device, "root")

    @contextmanager
    def delayed(self, seconds: float, hosts: tuple[str, ...]) -> Generator[None]:
        """Everything takes so much longer on the links of these hosts, each way."""
        ports = [self.port(host) for host in hosts]
        pairs = [(port, f"{port}-r") for port in ports]
        for port in ports:
            self._within(SWITCH, "ip", "link", "set", port, "nomaster")
            self._within(SWITCH, "ip", "link", "set", f"{port}-b", "master", "bridge")
        try:
            with relaying(("ip", "netns", "exec", self.namespace(SWITCH)), pairs, seconds):
                yield
        finally:
            for port in ports:
                self._within(SWITCH, "ip", "link", "set", f"{port}-b", "nomaster")
                self._within(SWITCH, "ip", "link", "set", port, "master", "bridge")

    @contextmanager
    def _dropping(self, hosts: str | tuple[str, ...], verdict: str) -> Generator[None]:
        those = [self.port(host) for host in ((hosts,) if isinstance(hosts, str) else hosts)]
        ports = [port for one in those for port in (one, f"{one}-b")]
        listed = "{ " + ", ".join(f'"{port}"' for port in ports) + " }"
        for direction in ("iifname", "oifname"):
            self._within(SWITCH, "nft", f"add rule bridge faults through {direction} {listed} {verdict}")
        try:
            yield
        finally:
            self._within(SWITCH, "nft", "flush chain bridge faults through")

    def _within(self, host: str, *command: str) -> None:
        _must("ip", "netns", "exec", self.namespace(host), *command)


@contextmanager
def connected_hosts(hosts: tuple[str, ...], given: Mapping[str, str] | None = None) -> Generator[Network]:
    """Hosts on a switch, removed in the end; with a port for us, unless they are `given` addresses or names.

    Whatever addresses hosts are given, they reach each other, and nothing else.

    Raises:
        CannotError: where this system makes none.
    """
    _look()
    for owner in _left_behind():
        _tear_down(owner)
    network = Network(os.getpid(), _free_network(), hosts, given or {})
    try:
        _build(network)
        yield network
    finally:
        _tear_down(network.owner)


def _look() -> None:
    if os.geteuid() != 0:
        raise CannotError("network namespaces need root")
    for command, package in (("ip", "iproute2"), ("tc", "iproute2"), ("nft", "nftables"), ("unshare", "util-linux")):
        if shutil.which(command) is None:
            raise CannotError(f"there is no command {command} here (Debian: {package})")


def _build(network: Network) -> None:
    switch = network.namespace(SWITCH)
    _must("ip", "netns", "add", switch)
    _must("ip", "-n", switch, "link", "add", "bridge", "type", "bridge")
    _must("ip", "-n", switch, "link", "set", "bridge", "up")
    _must("ip", "netns", "exec", switch, "nft", TABLE)
    for host in network.hosts:
        _must("ip", "netns", "add", network.namespace(host))
        _plug(network, host, "eth0", network.namespace(host), network.address(host))
        _name_hosts(network, host)
        # for a relay, which is put between a host's port and the bridge
        ends = (f"{network.port(host)}-r", f"{network.port(host)}-b")
        _must("ip", "-n", switch, "link", "add", ends[0], "type", "veth", "peer", "name", ends[1])
        for end in ends:
            _must("ip", "-n", switch, "link", "set", end, "up")
    if not network.given:
        _plug(network, OWN, f"{PREFIX}{network.owner}", None, f"{network.network}.1")


def _name_hosts(network: Network, host: str) -> None:
    """Have the hosts' names mean their addresses within a namespace; `ip netns exec` puts the file in place."""
    named = [one for one in network.hosts if network.named(one)]
    if named:
        folder = OWN_FILES / network.namespace(host)
        folder.mkdir(parents=True, exist_ok=True)
        lines = ["127.0.0.1 localhost", *(f"{network.address(one)} {network.given[one]}" for one in named)]
        (folder / "hosts").write_text("\n".join(lines) + "\n")


def _plug(network: Network, host: str, device: str, namespace: str | None, address: str) -> None:
    """A cable from the switch to a namespace; None for our own."""
    switch, made = network.namespace(SWITCH), f"{PREFIX}{network.owner}"
    inside = ("ip",) if namespace is None else ("ip", "-n", namespace)
    _must("ip", "link", "add", made, "type", "veth", "peer", "name", f"{made}s")
    send_whole_packets((made, f"{made}s"))
    _must("ip", "link", "set", f"{made}s", "netns", switch)
    _must("ip", "-n", switch, "link", "set", f"{made}s", "name", network.port(host))
    _must("ip", "-n", switch, "link", "set", network.port(host), "master", "bridge", "up")
    if namespace is not None:
        _must("ip", "link", "set", made, "netns", namespace)
        _must(*inside, "link", "set", made, "name", device)
        _must(*inside, "link", "set", "lo", "up")
    if not network.given:
        _must(*inside, "address", "add", f"{address}/24", "dev", device)
        _must(*inside, "link", "set", device, "up")
        return
    is_new = ":" in address
    _must(
        *inside, "address", "add", f"{address}/{128 if is_new else 32}", "dev", device, *(("nodad",) if is_new else ())
    )
    _must(*inside, "link", "set", device, "up")
    _must(*inside, *(("-6",) if is_new else ()), "route", "add", "default", "dev", device)


def _tear_down(owner: int) -> None:
    for path in Path("/run/netns").glob(f"{PREFIX}{owner}[a-z]*"):
        _run("ip", "netns", "delete", path.name)
        shutil.rmtree(OWN_FILES / path.name, ignore_errors=True)
    _run("ip", "link", "delete", f"{PREFIX}{owner}")


def _left_behind() -> list[int]:
    """The ids of processes that were killed before they could tear down."""
    names = [path.name for path in (*Path("/run/netns").glob(f"{PREFIX}*"), *Path("/sys/class/net").glob(f"{PREFIX}*"))]
    owners = {int(found[1]) for name in names if (found := re.fullmatch(rf"{PREFIX}(\d+)(?:[a-z].*)?", name))}
    return [owner for owner in owners if not psutil.pid_exists(owner)]


def _free_network() -> str:
    """The first three numbers of a network that no interface of this system is in."""
    _, said = _run("ip", "-4", "-oneline", "address")
    free = [f"{NETWORK}.{number}" for number in range(256) if f" {NETWORK}.{number}." not in said]
    return random.SystemRandom().choice(free)


def _run(*command: str) -> tuple[bool, str]:
    """Whether a command succeeded, and what it said."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    return done.returncode == 0, (done.stdout + done.stderr).strip()


def _must(*command: str) -> None:
    succeeded, said = _run(*command)
    if not succeeded:
        raise CannotError(f"this system makes no such network: {' '.join(command)}: {said}")
