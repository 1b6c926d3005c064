"""The options of the commands that work on a running rig."""

from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro

from agents.cli.on_rig import OnRig, OptionalLabel, OptionalNumber, OptionalPath
from agents.registry import AGENTS


@dataclass(frozen=True)
class Router(OnRig):
    """Run a router, which all agents of a rig connect to."""


@dataclass(frozen=True)
class AgentOptions(OnRig):
    """Run an agent."""

    kind: ClassVar[str]
    """Its name in the registry."""


def agent_options(name: str) -> type[AgentOptions]:
    """The options of the command that runs an agent, from its row in the registry."""
    (row,) = (kind for kind in AGENTS if kind.name == name)
    fields: list[tuple[str, Any, Any]] = []
    if row.per_arm:
        of_arm = Annotated[str, tyro.conf.arg(help="Name of the arm, as in the configuration.")]
        fields.append(("arm", of_arm, field(default="psm1")))
    made = make_dataclass(f"{name.title().replace('_', '')}Agent", fields, bases=(AgentOptions,), frozen=True)
    made.kind = name
    made.__doc__ = f"Run the agent {name}: it {row.does}."
    return made


@dataclass(frozen=True)
class Record(OnRig):
    """Record every recorded topic of a rig until stopped, and say what is missing."""

    output: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("session.mcap")
    """The recording to write."""
    numbered: bool = False
    """Where that file exists, write session-2.mcap and so on beside it."""
    split_size: OptionalNumber = None
    """Begin another file, session_part2.mcap and so on, after so many MB."""
    split_minutes: OptionalNumber = None
    """Begin another file after so many minutes."""
    pre_trigger: OptionalNumber = None
    """Keep only events: so many seconds before each. Enter and SIGUSR1 make one too."""
    post_trigger: OptionalNumber = None
    """And so many seconds after it; without this option, as many as before."""
    keep_free: OptionalNumber = None
    """Stop while so many MB of the disk are free; without this option, 2 % of it or 500 MB."""
    foxglove: bool = True
    """Also write images, calibration and transforms as Foxglove and Rerun show them."""
    protocol: OptionalLabel = None
    """Id of the experiment's protocol."""
    specimen: OptionalLabel = None
    """Id of the specimen."""
    operator: OptionalLabel = None
    """Pseudonym of the operator, never a name."""
    consent: OptionalLabel = None
    """Class of the consent under which the recording is made."""
    retention_days: Annotated[int | None, tyro.conf.arg(metavar="DAYS")] = None
    """After how many days the recording is to be deleted."""


@dataclass(frozen=True)
class View(OnRig):
    """Show on Rerun a rig that runs, until stopped, or a recording."""

    recording: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="RECORDING")] = None
    """A recording (MCAP) to show, instead of the rig."""
    output: OptionalPath = None
    """Write what is shown to this file (.rrd): of a recording instead of a window, of a rig beside it."""
    numbered: bool = False
    """Where that file exists, write session-2.rrd and so on beside it."""
    show: Annotated[Literal["file", "native", "web"] | None, tyro.conf.arg(metavar="{file,native,web}")] = None
    """`file` opens no viewer, `native` a window, `web` a page; a window, unless a recording goes to a file."""
    layout: Literal["operate", "perception", "grasp", "timing"] = "operate"
    """What the views are laid out for; all of them show the same."""
    from_: Annotated[str | None, tyro.conf.arg(name="from", metavar="MOMENT")] = None
    """Where to begin in a recording: seconds from its start (12.5), a time of its day (14:32:07), or with its date."""
    to: Annotated[str | None, tyro.conf.arg(metavar="MOMENT")] = None
    """Where to end."""
    thin: bool = False
    """Leave out of a recording what is faster than an eye can follow, as is done live."""


@dataclass(frozen=True)
class Up(OnRig):
    """Start the router and all configured agents of this machine, watch them, and stop them together."""

    restart: bool = True
    """Start again what dies, after a while that grows."""


@dataclass(frozen=True)
class Demo:
    """A simulated grasp from image to judgement, all agents as processes of their own; ends by itself."""

    seed: int = 1
    """Varies the thread, the tissue and the tool's error, an honest miss included."""
    attempts: int = 1
    """How many grasps are tried where the planner sees that one missed, or cannot tell."""
    view: Literal["file", "native", "web"] = "file"
    """Also open a Rerun viewer."""
    sessions: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("sessions")
    """Where the recording goes."""


@dataclass(frozen=True)
class Goal(OnRig):
    """Ask for a grasp: at s along the thread, a rectified left-image pixel, a point, or a length from the needle."""

    s: OptionalNumber = None
    """Share of the thread's length, 0 to 1."""
    pixel: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="U V")] = None
    """Column and row."""
    point: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")] = None
    """In the rectified left camera's frame, in metres."""
    from_swage_mm: OptionalNumber = None
    """So much thread from where the needle holds it; needs the agent needle."""
    arm: str = "psm1"
    """Which arm is to grasp."""
    policy: Literal["robust", "direct"] = "robust"
    """`robust` captures where a grasp most likely succeeds and slides to the goal; `direct` grasps at the goal."""
    attempts: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """How often the planner may plan for it where it sees that a grasp missed; each plan must be armed all the same."""


@dataclass(frozen=True)
class PullThread(OnRig):
    """Ask for a pull: the standing strand away from the tissue until the tail is so long (docs/pulling.md).

    Give `--tail-mm` or `--release`. The plan says with which bounds it is to be armed.
    """

    tail_mm: OptionalNumber = None
    """How long the tail is to be, from its free end to where it comes out of the tissue."""
    exit_pixel: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="U V")] = None
    """Of the tail's exit in the rectified left image, where it cannot be told which strand is the tail."""
    release: bool = False
    """Have the jaws let go of what they hold, and go back, instead."""
    arm: str = "psm1"
    """Which arm is to pull."""


@dataclass(frozen=True)
class ArmPlan(OnRig):
    """Arm a plan and stand by it: its heartbeat runs while this command does; Ctrl-C disarms.

    A real arm needs the console's operator-present pedal pressed beside it: a command proves nobody's presence.
    """

    plan: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN")] = ""
    """The plan's id, as `goal` or `pull` prints it."""
    arm: str = "psm1"
    """Which arm carries it out."""
    attempts: int = 1
    """How many attempts are armed: the next plan too where it is not held, as long as this command runs, and where the
    arm moves nothing real."""
    pull_mm: OptionalNumber = None
    """Of a pull, all three as `pull` prints them: the most that closed jaws may travel in all its segments."""
    pull_seconds: OptionalNumber = None
    """Of a pull: how long it may last."""
    pull_within_mm: OptionalNumber = None
    """Of a pull: how far closed jaws may be from where the strand goes into the tissue."""


@dataclass(frozen=True)
class HoldArm(OnRig):
    """Have all arms of the rig stop where they are, disarmed, or one."""

    arm: Annotated[str | None, tyro.conf.arg(metavar="ARM")] = None
    """This arm alone; without it every arm that the rig's file names, and any other one that is there."""


@dataclass(frozen=True, kw_only=True)
class ChangeArmState(OnRig):
    """Have the console of a real arm, which must be disarmed, enable, disable, pause, resume or home it.

    Homing moves the arm: have its tool in free space, and a hand at the emergency stop.
    """

    word: Annotated[Literal["enable", "disable", "pause", "resume", "home"], tyro.conf.Positional]
    """What to do."""
    arm: str = "psm1"
    """Which arm."""


@dataclass(frozen=True)
class Guard(OnRig):
    """Watch a real arm from its own computer, and have it held when bridge, link or operator is gone (docs/dvrk.md)."""

    arm: str = "psm1"
    """Name of the arm, as in the configuration."""


@dataclass(frozen=True)
class PromptThread(OnRig):
    """Say which thread is meant: the one at a pixel of the rectified left image. Without a pixel: any again."""

    pixel: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="U V")] = None
    """A pixel on the thread; left out, perception chooses by itself."""


@dataclass(frozen=True)
class Doctor(OnRig):
    """Look for what would keep a rig from running, here and across its hosts, and name the remedy.

    With a stereo pair (--left and --right, or --stereo) and its --calibration, that pair is looked at instead; with
    --arm, whether a dVRK's console does all that is relied on (docs/dvrk.md). It is listened to, and nothing moves.
    """

    arm: Annotated[str | None, tyro.conf.arg(metavar="ARM")] = None
    """An arm of the rig's file, such as psm1, whose console is listened to."""
    seconds: float = 5.0
    """How long; what only a motion shows is told where the arm moves meanwhile."""
    left: OptionalPath = None
    """The left image of a pair."""
    right: OptionalPath = None
    """The right image."""
    stereo: OptionalPath = None
    """Both images side by side in one file, left first."""
    calibration: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH [PATH]")] = ()
    """Of the camera that took the pair, in any format that `reconstruct` reads."""
    unit: Annotated[str | None, tyro.conf.arg(metavar="UNIT")] = None
    """The calibration's unit of length, where its file does not say."""
    json: bool = False
    """Print one JSON document instead."""


@dataclass(frozen=True)
class RigStatus(OnRig):
    """Show live how a rig fares: agents, hosts, rates, ages, and in plain words what is wrong."""

    json: bool = False
    """Print a JSON document a second instead, each on a line."""
    once: bool = False
    """Look once; the exit status is 1 where something is wrong."""


@dataclass(frozen=True)
class SetInAgent(OnRig):
    """Set a parameter of a running agent, or list what it is set to: set perception segmenter network."""

    words: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(name="agent", metavar="AGENT [NAME VALUE]")
    ] = ()
    """The agent, such as `perception`, `robot_bridge psm1` or `robot_bridge/psm1`; then the parameter and its value,
    as JSON or plain text."""
