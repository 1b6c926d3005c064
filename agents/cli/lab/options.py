"""The options of the command that sets up a rig of several machines."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Deploy:
    """Derive from a rig's one file what each of its hosts needs (docs/deployment.md).

    `plan` writes configuration, systemd units, containers and the router's access rules, a folder for each host;
    `certificates` makes those that are missing or about to expire, and the lab's own authority if there is none;
    `install`, on a host and as root, puts that host's folder in its place; `rehearse`, as root on any Linux machine,
    plays all hosts on it, and what may happen to them.
    """

    action: Annotated[Literal["plan", "certificates", "install", "rehearse"], tyro.conf.Positional]
    """What to do."""
    config: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("rig.toml")
    """The rig's file (TOML), with its [hosts]; not for `install`."""
    folder: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("deployed")
    """Where `plan` and `certificates` write; for `install`, this host's folder in it."""
    anew: bool = False
    """With `certificates`: make all of them anew, as after a key was lost."""
    root: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("/")
    """With `install`: another folder than / to see what would be installed."""
    cut: tyro.conf.UseAppendAction[Annotated[tuple[str, ...], tyro.conf.arg(metavar="HOST")]] = ()
    """With `rehearse`: nothing reaches this host for a while. This and the next three may be given several times."""
    slow: tyro.conf.UseAppendAction[Annotated[tuple[tuple[str, str], ...], tyro.conf.arg(metavar="HOST RATE")]] = ()
    """With `rehearse`: the link of this host carries that much, such as robot 10Mbit."""
    kill: tyro.conf.UseAppendAction[Annotated[tuple[str, ...], tyro.conf.arg(metavar="PROCESS")]] = ()
    """With `rehearse`: this is killed, and started again as its unit would; as `runs` writes it."""
    skew: tyro.conf.UseAppendAction[Annotated[tuple[tuple[str, str], ...], tyro.conf.arg(metavar="HOST SECONDS")]] = ()
    """With `rehearse`: the clock of this host is off by so much, such as desk 2s."""
    seconds: float = 6.0
    """With `rehearse`: how long each of these lasts."""
    stay: bool = False
    """With `rehearse`: go on until Ctrl-C."""
    keep_logs: bool = False
    """With `rehearse`: keep what every process wrote, in a folder that is named in the end."""
