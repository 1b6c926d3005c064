"""The options of the command that finds where an instrument's jaw closes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.cli.on_rig import OptionalName, OptionalPath


@dataclass(frozen=True, kw_only=True)
class Jaw:
    """Find the angle at which an instrument's jaw closes, while somebody closes it several times by the console.

    Written as `calibrate jaw`. It only listens: nothing is said to the arm, and nothing moves by it (docs/dvrk.md).
    Exit status: 0, 2 for unusable input, 3 where there is too little motion to tell, or closings contradict each other.
    """

    recording: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[MCAP]")] = None
    """A recording with the arm's states while its jaw was closed."""
    live: bool = False
    """Listen to the running rig instead, until --closings were seen, or Ctrl-C."""
    config: OptionalPath = None
    """With --live: the rig's configuration (TOML)."""
    host: OptionalName = None
    """With --live: which of the rig's hosts this machine is."""
    closings: Annotated[int, tyro.conf.arg(metavar="COUNT")] = 5
    """With --live: after how many it ends."""
    arm: str = "psm1"
    """Whose jaw, as the rig calls the arm."""
    instrument: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Which instrument it is, where the console does not tell."""
    output: OptionalPath = None
    """Where to write the calibration (JSON), for jaw_file of a rig."""
