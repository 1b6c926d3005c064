"""What every command on a rig is told: which rig, and which of its hosts this is."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

OptionalPath = Annotated[Path | None, tyro.conf.arg(metavar="PATH")]
OptionalNumber = Annotated[float | None, tyro.conf.arg(metavar="NUMBER")]
OptionalName = Annotated[str | None, tyro.conf.arg(metavar="HOST")]
OptionalLabel = Annotated[str | None, tyro.conf.arg(metavar="ID")]
Unit = Literal["m", "cm", "mm", "um"]
OptionalUnit = Annotated[Unit | None, tyro.conf.arg(metavar="{m,cm,mm,um}")]


@dataclass(frozen=True)
class OnRig:
    """A command that reads the configuration of a rig."""

    config: OptionalPath = None
    """The rig's configuration (TOML); without it the file that SUTUREGRASP_CONFIG names, or else everything simulated
    on this machine."""
    host: OptionalName = None
    """Which of the rig's hosts this machine is, where neither its file nor its address tells."""
