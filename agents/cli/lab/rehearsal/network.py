"""Hosts that are network namespaces on a virtual switch, itself in one, and what can go wrong on the way between them.

Everything lies in namespaces named after the process that made them, but for the port of that process itself, so that
removing those few names removes everything; what a killed process left behind is removed by the next one.
"""

import array
import fcntl
import ipaddress
import os
import random
import re
import shutil
import socket
import struct
import subprocess
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import psutil

SIOCETHTOOL = 0x8946
FLAGS = (0x17, 0x1F, 0x24, 0x2C)
"""Setting transmit checksums, segmentation, and both generic ones (ETHTOOL_STXCSUM, STSO, SGSO, SGRO)."""


def send_whole_packets(devices: tuple[str, ...]) -> None:
    """Have these devices send packets as they travel on a wire, checked and no longer than its frames."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for device in devices:
            for flag in FLAGS:
                value = array.array("B", struct.pack("II", flag, 0))
                request = struct.pack("16sP", device.encode(), value.buffer_info()[0])
                fcntl.ioctl(any_socket.fileno(), SIOCETHTOOL, request + b"\0" * 16)


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
        with self.dropping((self.port(host),), "drop"):
            yield

    @contextmanager
    def dropping(self, ports: tuple[str, ...], verdict: str) -> Generator[None]:
        """What passes the bridge through one of these ports meets a verdict of nftables."""
        listed = "{ " + ", ".join(f'"{port}"' for port in ports) + " }"
        for direction in ("iifname", "oifname"):
            self.within(SWITCH, "nft", f"add rule bridge faults through {direction} {listed} {verdict}")
        try:
            yield
        finally:
            self.within(SWITCH, "nft", "flush chain bridge faults through")

    @contextmanager
    def narrowed(self, megabits: int, hosts: tuple[str, ...]) -> Generator[None]:
        """The links of these hosts carry so much per second, each way."""
        shaped = [(SWITCH, self.port(host)) for host in hosts] + [(host, "eth0") for host in hosts]
        for namespace, device in shaped:
            bucket = ("rate", f"{megabits}mbit", "burst", "32k", "latency", "50ms")
            self.within(namespace, "tc", "qdisc", "add", "dev", device, "root", "tbf", *bucket)
        try:
            yield
        finally:
            for namespace, device in shaped:
                _run("ip", "netns", "exec", self.namespace(namespace), "tc", "qdisc", "del", "dev", device, "root")

    def within(self, host: str, *command: str) -> None:
        """Run a command in the namespace that stands for a host, or for the switch.

        Raises:
            CannotError: where it fails.
        """
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
