"""The options of the command that finds where a robot's base is before the camera."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.cli.on_rig import OptionalPath


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
    unit: Annotated[str | None, tyro.conf.arg(metavar="{m,cm,mm,um}")] = None
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
