"""Which of a rig's hosts this machine is: as the command or the file says, or by its name or address."""

import os
import socket
from collections.abc import Mapping
from pathlib import Path

from agents.configuration.hosts import HostSection
from agents.configuration.rig import RigConfig, simulated_rig
from shared.runtime.config import ConfigError, load_config

CREDENTIALS = "CREDENTIALS_DIRECTORY"
"""Where systemd puts what one unit alone may read."""


CONFIG = "SUTUREGRASP_CONFIG"
"""Names the rig's file for commands that are given none."""


def rig_of(config: Path | None, host: str | None) -> RigConfig:
    """The rig as it is on this machine: of that file, or of the one that the environment names, or all simulated.

    Raises:
        ConfigError: where its configuration cannot be used.
    """
    named = os.environ.get(CONFIG)
    file = config or (Path(named) if named else None)
    if file is None:
        return simulated_rig()
    return certificates_of(at_host(load_config(file, RigConfig), host), file)


def at_host(rig: RigConfig, named: str | None) -> RigConfig:
    """The rig as it is on this machine.

    Raises:
        ConfigError: where the rig has hosts, and none of them is told to be this one.
    """
    if not rig.hosts:
        if named is not None:
            raise ConfigError(f"--host {named}: the configuration has no [hosts]")
        return rig
    host = named or rig.host or recognised(rig.hosts)
    if host is None:
        hosts = ", ".join(rig.hosts)
        raise ConfigError(f"which of the hosts {hosts} is this one? say so with --host, or with host = ... in the file")
    if host not in rig.hosts:
        raise ConfigError(f"{host!r} is none of the rig's hosts {', '.join(rig.hosts)}")
    return rig.model_copy(update={"host": host})


def certificates_of(rig: RigConfig, config: Path) -> RigConfig:
    """The rig with the folder of its certificates: as systemd or Compose give it, or beside the rig's file."""
    if rig.security is None:
        return rig
    given = os.environ.get(CREDENTIALS)
    folder = Path(given) if given else config.resolve().parent / rig.security.certificates
    return rig.model_copy(update={"security": rig.security.model_copy(update={"certificates": folder})})


def recognised(hosts: Mapping[str, HostSection]) -> str | None:
    """The one host that this machine is by its name or an address of it; None where that is none, or more than one."""
    name = socket.gethostname()
    found = {host for host, section in hosts.items() if host == name or name == section.address or _is_own(section)}
    return found.pop() if len(found) == 1 else None


def _is_own(section: HostSection) -> bool:
    """Whether a socket can be bound to the address, as only one of this machine's own can be."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(section.address, 0, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except OSError:
        return False
    return True
