"""The options of the commands that set up a rig, emulate a robot, and render scenes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.cli.on_rig import OptionalPath, OptionalUnit

OptionalEndpoint = Annotated[str | None, tyro.conf.arg(metavar="ENDPOINT")]
Words = Literal[
    "fault", "error", "stick", "loose", "mute", "speak",
    "camera", "camera_back", "setup", "setup_back", "clutch", "unclutch", "pedal", "pedal_up", "unreached",
    "teleop", "no_teleop", "drift", "narrow", "wide", "open_jaw", "close_jaw",
]  # fmt: skip
Config = Literal[
    "easy", "medium", "hard", "singularity", "occlusion", "crossing", "several", "needle", "rod", "none", "varied"
]
Extra = Literal["tools", "stains", "smoke", "blur", "interlaced", "meshes"]
Dye = Literal["violet", "blue", "green", "black", "undyed", "red", "beige", "white", "grey"]


@dataclass(frozen=True)
class Deploy:
    """Derive from a rig's one file what each of its hosts needs (docs/deployment.md).

    `plan` writes configuration, systemd units, containers and the router's access rules, a folder for each host;
    `certificates` makes those that are missing or about to expire, and the lab's own authority if there is none;
    `install`, on a host and as root, puts that host's folder in its place; `rehearse`, as root on any Linux machine,
    plays all hosts on it, and what may happen to them.
    """

    action: Annotated[Literal["plan", "certificates", "install", "rehearse"], tyro.conf.Positional]
    """What to do."""
    config: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("rig.toml")
    """The rig's file (TOML), with its [hosts]; not for `install`."""
    folder: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("deployed")
    """Where `plan` and `certificates` write; for `install`, this host's folder in it."""
    anew: bool = False
    """With `certificates`: make all of them anew, as after a key was lost."""
    root: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("/")
    """With `install`: another folder than / to see what would be installed."""
    cut: tyro.conf.UseAppendAction[Annotated[tuple[str, ...], tyro.conf.arg(metavar="HOST")]] = ()
    """With `rehearse`: nothing reaches this host for a while. This and the next three may be given several times."""
    slow: tyro.conf.UseAppendAction[Annotated[tuple[tuple[str, str], ...], tyro.conf.arg(metavar="HOST RATE")]] = ()
    """With `rehearse`: the link of this host carries that much, such as robot 10Mbit."""
    kill: tyro.conf.UseAppendAction[Annotated[tuple[str, ...], tyro.conf.arg(metavar="PROCESS")]] = ()
    """With `rehearse`: this is killed, and started again as its unit would; as `runs` writes it."""
    skew: tyro.conf.UseAppendAction[Annotated[tuple[tuple[str, str], ...], tyro.conf.arg(metavar="HOST SECONDS")]] = ()
    """With `rehearse`: the clock of this host is off by so much, such as desk 2s."""
    seconds: float = 6.0
    """With `rehearse`: how long each of these lasts."""
    stay: bool = False
    """With `rehearse`: go on until Ctrl-C."""
    keep_logs: bool = False
    """With `rehearse`: keep what every process wrote, in a folder that is named in the end."""


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
    listen: OptionalEndpoint = None
    """Be a Zenoh router there, as the robot's own computer has one: tcp/127.0.0.1:7448, without --connect."""
    connect: OptionalEndpoint = None
    """Be a client of the Zenoh router there instead."""
    zenoh: OptionalPath = None
    """Be the Zenoh that this file says instead, as deploy plan writes one for the robot's computer."""
    ready: bool = False
    """Begin enabled and homed."""
    foot: bool = False
    """Somebody stands at the console, and presses the operator's pedal anew for each motion."""
    lag_ms: float = 0.0
    """How far behind a steady motion its joints come, as joints with inertia do."""
    jaw_closes: Annotated[float | None, tyro.conf.arg(metavar="RAD")] = None
    """The angle at which the fingers of its instrument touch, and press on each other beyond; none without it."""
    camera: OptionalPath = None
    """JSON with T_camera_base (4x4, metres), by which the place of the tool before the camera is judged too."""
    heartbeats: OptionalEndpoint = None
    """The rig's router: set points without an operator's heartbeat there are unsafe."""
    verdict: OptionalPath = None
    """Write the verdict there at the end (JSON)."""
    tell: Annotated[Words | None, tyro.conf.arg(metavar="{fault,error,stick,camera,setup,clutch,...}")] = None
    """Have a running one do this, and end."""


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
    unit: OptionalUnit = None
    """The calibration's unit of length, where its file does not say."""
