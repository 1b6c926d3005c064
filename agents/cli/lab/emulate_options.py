"""The options of the command that emulates a robot."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

Words = Literal[
    "fault", "error", "stick", "loose", "mute", "speak",
    "camera", "camera_back", "setup", "setup_back", "clutch", "unclutch", "pedal", "pedal_up", "unreached",
    "teleop", "no_teleop", "drift", "narrow", "wide", "open_jaw", "close_jaw",
]  # fmt: skip


@dataclass(frozen=True)
class Emulate:
    """Be the computer of a robot, for tests and to try without one (docs/dvrk.md).

    Says at its end how many set points were unsafe by its own rules; the exit status is 1 where any was.
    """

    robot: Annotated[Literal["dvrk"], tyro.conf.Positional]
    """Which robot."""
    arm: str = "PSM1"
    """The arm's name, as its console writes it; `PSM1,PSM2` for two of one console."""
    codec: Literal["ros2dds", "rmw_zenoh"] = "ros2dds"
    """How ROS is carried: by zenoh-bridge-ros2dds, or by rmw_zenoh."""
    domain: int = 0
    """ROS_DOMAIN_ID, of which rmw_zenoh makes use."""
    listen: Annotated[str | None, tyro.conf.arg(metavar="ENDPOINT")] = None
    """Be a Zenoh router there, as the robot's own computer has one: tcp/127.0.0.1:7448, without --connect."""
    connect: Annotated[str | None, tyro.conf.arg(metavar="ENDPOINT")] = None
    """Be a client of the Zenoh router there instead."""
    zenoh: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """Be the Zenoh that this file says instead, as deploy plan writes one for the robot's computer."""
    ready: bool = False
    """Begin enabled and homed."""
    foot: bool = False
    """Somebody stands at the console, and presses the operator's pedal anew for each motion."""
    lag_ms: float = 0.0
    """How far behind a steady motion its joints come, as joints with inertia do."""
    jaw_closes: Annotated[float | None, tyro.conf.arg(metavar="RAD")] = None
    """The angle at which the fingers of its instrument touch, and press on each other beyond; none without it."""
    camera: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """JSON with T_camera_base (4x4, metres), by which the place of the tool before the camera is judged too."""
    heartbeats: Annotated[str | None, tyro.conf.arg(metavar="ENDPOINT")] = None
    """The rig's router: set points without an operator's heartbeat there are unsafe."""
    verdict: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """Write the verdict there at the end (JSON)."""
    tell: Annotated[Words | None, tyro.conf.arg(metavar="{fault,error,stick,camera,setup,clutch,...}")] = None
    """Have a running one do this, and end."""
