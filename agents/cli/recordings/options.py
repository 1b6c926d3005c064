"""The options of the commands that work on recordings."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.cli.on_rig import OnRig, OptionalPath


@dataclass(frozen=True)
class Inspect:
    """Say what a recording holds and lacks, how fast it was, and what came of its grasps; two or more are compared.

    Exit status: 0, 2 for no recording, 3 for a damaged one, of which what could be read was told.
    """

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="MCAP [MCAP]")]
    """Recordings as `suturegrasp record`, `up` and `demo` write them."""
    json: bool = False
    """Print one JSON document instead of tables."""
    html: OptionalPath = None
    """Also write a page with charts and pictures, in one file."""
    time_offset: bool = False
    """Also find how much later the camera's stamps are than each arm's joints, from its tool's motion in the images;
    it is not on the page."""


@dataclass(frozen=True)
class Export:
    """Turn a recording into tables: frames, curves, plans, waypoints, states of the arms, goals and outcomes.

    Exit status: 0, 2 for no recording, 3 for a damaged one, of which what could be read was written.
    """

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MCAP")]
    """The recording."""
    output: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """A folder that is new or empty."""
    format: Literal["csv", "npz", "json"] = "csv"
    """What the tables are written as."""
    points: int = 50
    """How many points of each curve, evenly spaced along it."""


@dataclass(frozen=True)
class Cut:
    """Write a stretch of a recording to a file of its own, which all that works on recordings takes as well.

    Exit status: 0, 2 for no recording, 3 for a damaged one, of which what could be read was written.
    """

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MCAP")]
    """The recording."""
    output: Annotated[Path, tyro.conf.arg(metavar="PATH")]
    """The shorter one."""
    begin: Annotated[str | None, tyro.conf.arg(name="from", metavar="MOMENT")] = None
    """Seconds from the start (12.5) or a time of the day (14:32:07), with its date where it is of another."""
    end: Annotated[str | None, tyro.conf.arg(name="to", metavar="MOMENT")] = None
    """The same."""
    delay: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="ARM=MS")] = ()
    """By how much the camera's stamps are later than an arm's, as `inspect --time-offset` tells: its states are moved.
    May be given for each arm."""
    used: bool = False
    """Leave out frames of which perception made nothing: much smaller, and replayed in process as the whole."""


@dataclass(frozen=True)
class Replay:
    """Publish a recording on the live keys again, as it was received: for running agents, or to look at it.

    What live agents publish themselves is left out, and so is what an arm would act on. On a terminal, space holds the
    replay, n steps to the next frame, q ends it. Exit status: 0 replayed, 1 not all of it, 2 not as asked, 3 damaged.
    """

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MCAP")]
    """The recording."""
    rate: float = 1.0
    """How fast: 0.5 for half as fast as recorded."""
    fast: bool = False
    """As fast as consumers take it, and none of them loses anything."""
    loop: bool = False
    """Again and again, until stopped."""
    from_: Annotated[str | None, tyro.conf.arg(name="from", metavar="MOMENT")] = None
    """Where to begin: seconds from the start, or a time (14:30:05, of another day with its date)."""
    to: Annotated[str | None, tyro.conf.arg(metavar="MOMENT")] = None
    """Where to end."""
    topics: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TOPIC ...")] = ()
    """Only these, such as camera/frames or 'camera/*'. What an arm would act on must be spelt out."""
    yes_execute: bool = False
    """Agents shall act on what is named in --topics: plans, heartbeats, commands."""
    step: bool = False
    """Begin held; Enter steps to the next frame."""
    rig: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """The rig on whose keys it is published. Default: the configured or else the recorded one."""
    config: OptionalPath = None
    """The rig's configuration (TOML), which names the router; without it, the one on this machine."""


@dataclass(frozen=True)
class Recompute:
    """Feed agents, in this process, exactly what they consumed, and compare what they say now with what they said.

    Nothing is published (docs/recordings.md). Exit status: 0 the same, 1 different, 2 nothing to compare, 3
    damaged.
    """

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MCAP")]
    """The recording."""
    through: Annotated[str, tyro.conf.arg(metavar="AGENT[,AGENT ...]")]
    """The agents, such as perception,reconstruction."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="KEY=VALUE")] = ()
    """A setting that is to be otherwise, such as reconstruction.method=paper; may be given often."""
    config: OptionalPath = None
    """The rig's configuration (TOML) in place of the recorded one."""
    tolerances: Literal["auto", "none", "table"] = "auto"
    """Whether differences below those of docs/recordings.md pass. Default: where settings, versions or the machine
    are not those of the recording."""
    output: Annotated[Path | None, tyro.conf.arg(metavar="RRD|MCAP")] = None
    """A Rerun recording of both side by side, or the recording with what the agents say now."""


@dataclass(frozen=True)
class TrackTool(OnRig):
    """Find an arm's instrument in the images, and say how far it is from where registration and joints have it.

    In a recording, or with --live on the running rig until stopped; it warns whenever that is more than --limit.
    Exit status: 0, 1 where it was so at the end, 2 for nothing to look at, 3 where the instrument was not found or lost
    (docs/tool_tracking.md).
    """

    recording: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[MCAP]")] = None
    """A recording with frames, calibration and the arm's states."""
    live: bool = False
    """Look at the running rig instead."""
    views: Annotated[int | None, tyro.conf.arg(metavar="COUNT")] = None
    """End after so many frames were looked at."""
    arm: str = "psm1"
    """Whose instrument."""
    delay_ms: float = 0.0
    """How late the camera's stamps are by the joints' clock, as `calibrate hand-eye` tells."""
    limit: Annotated[float, tyro.conf.arg(metavar="MM")] = 3.0
    """How far the tip may be off before the registration is said to have drifted."""
    output: OptionalPath = None
    """Write the corrected T_camera_base there, for T_camera_base_file of a rig."""
    tips: Annotated[Path | None, tyro.conf.arg(metavar="CSV")] = None
    """Write where the tip was before the camera, for `calibrate hand-eye --tips` with the same recording."""
    pictures: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Draw outlines into each looked-at frame: yellow as told, green as found."""
