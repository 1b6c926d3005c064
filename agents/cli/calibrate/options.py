"""The options of the commands that calibrate: a stereo camera, a camera and an arm, an instrument's jaw."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.cli.on_rig import OnRig, OptionalPath, OptionalUnit, Unit


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
    unit: Unit = "mm"
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


@dataclass(frozen=True, kw_only=True)
class HandEye:
    """Find where an arm's base is before the camera, from what was seen of its moving tool (docs/camera.md).

    Written as `calibrate hand-eye`. Exit status: 0, 2 for unusable input, 3 where no calibration can be estimated.
    """

    tips: Annotated[Path, tyro.conf.arg(metavar="CSV")]
    """What was seen of one point of the tool: columns time_s and left_u, left_v, right_u, right_v (pixels of the images
    as the camera gave them), or time_s and x, y, z (metres before the rectified left camera, as a marker's)."""
    poses: Annotated[Path | None, tyro.conf.arg(metavar="CSV")] = None
    """The robot meanwhile: columns time_s and yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw; or time_s and x, y,
    z with qw, qx, qy, qz or without, in the base's frame (metres, radians)."""
    recording: Annotated[Path | None, tyro.conf.arg(metavar="MCAP")] = None
    """A recording that holds the robot's poses, instead; time_s of the tips is then in seconds since 1970."""
    arm: str = "psm1"
    """Which arm of the recording."""
    calibration: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH [PATH]")] = ()
    """Of the camera, in any format that `reconstruct` reads; needed for pixels."""
    unit: OptionalUnit = None
    """The calibration's unit, where its file does not say."""
    size: Annotated[tuple[int, int] | None, tyro.conf.arg(metavar="WIDTH HEIGHT")] = None
    """The images' size, where the calibration's file does not say."""
    point: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")] = None
    """Which point of the tool was seen, in the tool's frame in metres; without it the closed fingers' tip (0 0 0.0102),
    or the place itself where poses have no rotation."""
    unknown_point: bool = False
    """Estimate that point too, as of a marker that was glued on; the tool must have been turned."""
    output: OptionalPath = None
    """Where to write the calibration (JSON), for T_camera_base_file of a rig."""


@dataclass(frozen=True, kw_only=True)
class Jaw(OnRig):
    """Find the angle at which an instrument's jaw closes, while somebody closes it several times by the console.

    Written as `calibrate jaw`. It only listens: nothing is said to the arm, and nothing moves by it (docs/dvrk.md).
    Exit status: 0, 2 for unusable input, 3 where there is too little motion to tell, or closings contradict each other.
    """

    recording: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[MCAP]")] = None
    """A recording with the arm's states while its jaw was closed."""
    live: bool = False
    """Listen to the running rig instead, until --closings were seen, or Ctrl-C."""
    closings: Annotated[int, tyro.conf.arg(metavar="COUNT")] = 5
    """With --live: after how many it ends."""
    arm: str = "psm1"
    """Whose jaw, as the rig calls the arm."""
    instrument: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Which instrument it is, where the console does not tell."""
    output: OptionalPath = None
    """Where to write the calibration (JSON), for jaw_file of a rig."""
