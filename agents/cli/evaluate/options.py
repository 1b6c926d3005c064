"""The options of `suturegrasp evaluate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

Scenario = Literal["easy", "medium", "hard", "singularity", "occlusion"]


@dataclass(frozen=True)
class Evaluate:
    """Repeat the paper's experiment in simulation: from images to lifted thread, through the real agents' code.

    Scenarios x threads x goals x policies x methods, in virtual time. Ended at any time it goes on where it was when it
    is called again with the same folder and options. Table I, statistics, pictures: docs/evaluation.md. Exit status:
    0 all tried, 2 not as asked, 3 something is left.
    """

    what: Annotated[Literal["grasping"], tyro.conf.Positional]
    """The grasping experiment."""
    output: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/evaluation")
    """Where journal, results and report go, and images are kept."""
    quick: bool = False
    """One thread of each scenario, 5 goals, light images: minutes. What is given beside it counts."""
    config: tuple[Scenario, ...] = ("easy", "medium", "hard", "singularity", "occlusion")
    """How threads lie, one or several."""
    background: tuple[Literal["paper", "chicken"], ...] = ("paper", "chicken")
    """What they lie on: a print, raw flesh."""
    threads: int | None = None
    """Of each scenario. Default: 3."""
    goals: int | None = None
    """On each thread. Default: 20."""
    policies: tuple[Literal["direct", "robust"], ...] = ("direct", "robust")
    """Grasp where the goal is; or capture where that is best, slide to the goal, grasp."""
    methods: tuple[Literal["paper", "refined"], ...] = ("paper", "refined")
    """Of reconstruction, with what the planner makes of its confidence."""
    images: Literal["auto", "traced", "light"] | None = None
    """Path-traced by Mitsuba (extra `sim`), or drawn by the light renderer. Default: traced where Mitsuba is there."""
    judge: Literal["geometric", "contact"] = "geometric"
    """Whether a grasp held: by where the fingers passed, or by contact physics (extra `sim`)."""
    tool_error: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MM ...")] = (0.7,)
    """Deviation of each axis of the tool tip, drawn anew for each trial; several make a sweep."""
    hand_eye: Annotated[tuple[float, float], tyro.conf.arg(metavar="MM DEG")] = (1.5, 1.0)
    """The most that the registration of a scenario is shifted and turned by."""
    inject: Annotated[tuple[float, float], tyro.conf.arg(metavar="SHARE MM")] = (0.0, 0.0)
    """Of so many goals the reconstruction is moved as a whole, by so much at most."""
    attempts: int = 1
    """How often a grasp may be tried: the thread is looked at after each one."""
    tissue: bool = False
    """The planner is told of the tissue, as on a rig, and declines what would press into it too deep."""
    instrument: bool = False
    """Looks after a grasp show the instrument, which hides thread about the jaws, as on a rig."""
    seed: int = 1
    """Of everything that is drawn."""
    jobs: int = 1
    """How many processes work at once."""
    report: bool = False
    """Only write results and report anew, from the journal."""
    record: Annotated[str | None, tyro.conf.arg(metavar="TRIAL")] = None
    """Carry out this one trial again and record it, for `suturegrasp view`: SCENARIO/THREAD/GOAL/POLICY/METHOD, such
    as hard/chicken/1/7/robust/refined."""


@dataclass(frozen=True)
class EvaluatePulling:
    """Pull threads through simulated tissue until their tails have asked lengths: from images to the end of the pull.

    Drawn stitches in virtual time, with friction, stretch and knots. Ended at any time it goes on where it was when it
    is called again with the same folder and options. What is judged: docs/evaluation.md. Exit status: 0 all tried, 2
    not as asked, 3 something is left.
    """

    output: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/pulling")
    """Where journal and results go."""
    trials: int = 100
    """How many stitches are drawn, each for one pull."""
    puller: str = "planner"
    """Whose decisions are judged."""
    tool_error: Annotated[float, tyro.conf.arg(metavar="MM")] = 0.7
    """Deviation of each axis of the tool tip, drawn anew for each trial."""
    hand_eye: Annotated[tuple[float, float], tyro.conf.arg(metavar="MM DEG")] = (1.5, 1.0)
    """The most that the registration of a trial is shifted and turned by."""
    instrument: bool = False
    """Images show the instrument, which hides thread about the jaws, as on a rig."""
    seed: int = 1
    """Of everything that is drawn."""
    jobs: int = 1
    """How many processes work at once."""
    report: bool = False
    """Only write the results anew, from the journal."""
