"""The options of `suturegrasp scenes`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

Config = Literal[
    "easy", "medium", "hard", "singularity", "occlusion", "crossing", "several", "needle", "rod", "none", "varied"
]
Extra = Literal["tools", "stains", "smoke", "blur", "interlaced", "meshes"]
Dye = Literal["violet", "blue", "green", "black", "undyed", "red", "beige", "white", "grey"]


@dataclass(frozen=True)
class Scenes:
    """Make stereo images of thread with known truth, by path tracing (docs/simulator.md); needs the extra `sim`.

    What lies in the folder already is kept, so that a batch that was interrupted goes on where it was. Exit status: 0
    all are there, 1 some found no place before the camera, 2 not as asked.
    """

    action: Annotated[Literal["render"], tyro.conf.Positional]
    output: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """Where the pairs go, as NAME_left.png, NAME_right.png, masks, NAME.json and NAME.npy."""
    config: tuple[Config, ...] = ("easy",)
    """How the thread lies, one or several; `varied` draws everything, for training."""
    background: tuple[Literal["chicken", "paper", "pad", "phantom"], ...] = ("chicken",)
    """What it lies on: raw flesh, a print of it, a suture pad, or a phantom's silicone skin; the last two in a lab."""
    extras: Annotated[tuple[Extra, ...], tyro.conf.arg(name="with")] = ()
    """What else is in view, or wrong with it; `meshes` are needle drivers as they are, from --meshes."""
    meshes: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Of the Large Needle Driver's *.dae."""
    colour: Dye | None = None
    """Of the thread; drawn by the seed if not given, and then red in a lab alone."""
    count: int = 1
    """How many of each configuration on each background, with seeds that follow one another."""
    seed: int = 1
    """Of the first."""
    samples: int = 4
    """Samples of each pixel for each lamp; 2 will do for training."""
    workers: int = 1
    """How many processes work at once; each takes a core and about a gigabyte."""
    size: Annotated[tuple[int, int], tyro.conf.arg(metavar="WIDTH HEIGHT")] = (960, 540)
    """Of the images, in pixels; the horizontal field of view stays."""
    calibration: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH [PATH]")] = ()
    """See through this camera instead, distorted and unrectified as it is; --size must be that of its images."""
    distance: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="NEAR FAR")] = None
    """Of the field, in mm; follows from the camera if not given."""
    unit: str | None = None
    """The calibration's unit of length, where its file does not say."""
