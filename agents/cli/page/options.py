"""The options of `suturegrasp page`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.cli.on_rig import OnRig


@dataclass(frozen=True)
class Page(OnRig):
    """Serve the operator's page: see, click the thread, look at the plan, arm by press-and-hold, hold.

    Prints a link that works once, and a new one whenever one was used (docs/running.md).
    """

    port: int = 7450
    """Where it is served; 0 takes any that is free."""
    listen: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """Serve it to other machines too, at this address of this host, over HTTPS with the rig's certificates."""
    open: bool = True
    """Open it in a browser, where there is a screen."""
    start: bool = False
    """Start everything on this machine first, simulated without --config, and stop it in the end."""
    experiment: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Walk through the goals of this experiment, which suturegrasp experiment began, and write down the verdicts."""


@dataclass(frozen=True)
class Play(Page):
    """Keep the simulated field running with the operator's page until Ctrl-C; the same as `page --start`.

    Goals can be named from another terminal too: suturegrasp goal --s 0.4.
    """

    start: bool = True
    """Start everything on this machine first, simulated without --config, and stop it in the end."""
