"""The options of the command that calibrates a stereo camera."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.cli.on_rig import OnRig, OptionalPath


@dataclass(frozen=True, kw_only=True)
class Calibrate(OnRig):
    """Calibrate a stereo camera with a chessboard or ChArUco board, or check a calibration against views of one.

    `stereo` estimates from images in folders, or with --live from the rig's running camera, and writes the
    calibration in three forms with a report; `check` says what a given --calibration is worth on such images.
    Exit status: 0, 1 where the check finds it wrong, 2 for unusable input, 3 where no calibration can be estimated.
    """

    action: Annotated[Literal["stereo", "check"], tyro.conf.Positional]
    """What to do."""
    squares: Annotated[tuple[int, int], tyro.conf.arg(metavar="COLUMNS ROWS")]
    """How many squares the board has; a chessboard of 13x8 inner corners has 14x9."""
    square: Annotated[float, tyro.conf.arg(metavar="LENGTH")]
    """The side of a square as it was printed: measure ten of them with a ruler."""
    unit: Annotated[str, tyro.conf.arg(metavar="{m,cm,mm,um}")] = "mm"
    """The unit of these lengths, and of the calibration."""
    marker: Annotated[float | None, tyro.conf.arg(metavar="LENGTH")] = None
    """The side of a marker, for a ChArUco board; without it the board is a chessboard."""
    dictionary: Annotated[str, tyro.conf.arg(metavar="NAME")] = "DICT_4X4_250"
    """OpenCV's name of the markers' dictionary."""
    legacy: bool = False
    """The ChArUco board was made by OpenCV before 4.6."""
    left: OptionalPath = None
    """A folder of left images, which pair up with the right ones in the order of their names."""
    right: OptionalPath = None
    """The folder of right images."""
    stereo: OptionalPath = None
    """A folder of images that show both eyes side by side, left first."""
    live: bool = False
    """Take frames of the rig's running camera, and say what is still missing; Ctrl-C ends it early."""
    views: Annotated[int, tyro.conf.arg(metavar="COUNT")] = 30
    """With --live: after how many views it ends at the latest."""
    output: OptionalPath = None
    """A folder, new or empty, for calibration, report, and with --live the images."""
    calibration: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH [PATH]")] = ()
    """What `check` is to check, in any format that `reconstruct` reads."""
