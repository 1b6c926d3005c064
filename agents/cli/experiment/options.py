"""The options of `suturegrasp experiment`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.cli.on_rig import OnRig


@dataclass(frozen=True)
class Experiment(OnRig):
    """Try goals along threads with both policies, and write how often each grasped (docs/evaluation.md).

    Can be interrupted at any time, and goes on where it was when it is called again with the same folder.
    """

    folder: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")] = None
    """Where the journal, the recordings and the results lie."""
    threads: Annotated[tuple[str, ...], tyro.conf.arg(metavar="CONFIGURATION/BACKGROUND ...")] = ()
    """What is laid out, one after the other: easy/paper hard/chicken, and hard/chicken/2 for another of one kind."""
    goals: Annotated[int | None, tyro.conf.arg(metavar="NUMBER")] = None
    """How many places along each thread; 20 without this option."""
    seed: Annotated[int | None, tyro.conf.arg(metavar="NUMBER")] = None
    """Of the order of goals and policies; 1 without this option."""
    arm: Annotated[str | None, tyro.conf.arg(metavar="ARM")] = None
    """Which arm grasps; psm1 without this option."""
    verdicts: Annotated[Literal["operator", "simulated"] | None, tyro.conf.arg(metavar="{operator,simulated}")] = None
    """Who says whether a grasp held: you, asked after each, which is so without this option, or the simulator."""
    record: bool = True
    """Record each thread's session."""
    report: bool = False
    """Only write the results of what was tried so far."""
