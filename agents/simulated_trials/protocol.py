"""What an evaluation tries: every goal of every thread with both policies and all methods, and all that is drawn."""

import zlib
from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float64
from pydantic import Field, StringConstraints

from shared.runtime.config import Settings

POLICIES = ("direct", "robust")
METHODS = ("paper", "refined")
PolicyName = Literal["direct", "robust"]
MethodName = Literal["paper", "refined"]
ScenarioName = Annotated[str, StringConstraints(pattern="^[a-z]+/[a-z]+$")]
MM = 1e-3


class Protocol(Settings):
    """What is tried, and with which errors.

    Fields:
        threads: on each scenario.
        goals: on each thread, evenly along what is seen of it.
        images: `traced` by Mitsuba, or drawn by the light renderer.
        judge: `geometric`, or `contact` physics.
        tool_errors_mm: deviations of each axis of the tool tip, drawn anew for each trial; each value is tried.
        hand_eye_mm, hand_eye_deg: the most that the registration of a scenario is wrong by.
        injected_share, injected_mm: how many of the goals find the thread moved as a whole, and by how much at most.
        attempts: how often a grasp may be tried.
        tissue: whether the planner is told of the tissue, which makes it decline what would press into that too deep.
        instrument: whether looks after a grasp show the instrument.
    """

    seed: int = Field(ge=0)
    scenarios: tuple[ScenarioName, ...] = Field(min_length=1)
    threads: int = Field(ge=1)
    goals: int = Field(ge=1, le=200)
    policies: tuple[PolicyName, ...] = Field(min_length=1)
    methods: tuple[MethodName, ...] = Field(min_length=1)
    images: Literal["traced", "light"]
    judge: Literal["geometric", "contact"]
    tool_errors_mm: tuple[Annotated[float, Field(ge=0, le=20)], ...] = Field(min_length=1)
    hand_eye_mm: float = Field(ge=0, le=20)
    hand_eye_deg: float = Field(ge=0, le=30)
    injected_share: float = Field(default=0.0, ge=0, le=1)
    injected_mm: float = Field(default=0.0, ge=0, le=50)
    attempts: int = Field(default=1, ge=1, le=10)
    tissue: bool = False
    instrument: bool = False


class Laid(Settings):
    """A thread: of which scenario, and the how many-th there."""

    scenario: ScenarioName
    thread: int

    @property
    def name(self) -> str:
        """As it is called in tables and files."""
        return f"{self.scenario}/{self.thread}"

    @property
    def config(self) -> str:
        """The configuration."""
        return self.scenario.split("/")[0]

    @property
    def background(self) -> str:
        """What it lies on."""
        return self.scenario.split("/")[1]


class Trial(Settings):
    """One grasp to be tried."""

    laid: Laid
    goal: int
    policy: PolicyName
    method: MethodName
    tool_error_mm: float

    @property
    def name(self) -> str:
        """SCENARIO/THREAD/GOAL/POLICY/METHOD, as `--record` takes it."""
        return f"{self.laid.name}/{self.goal}/{self.policy}/{self.method}"


class Tried(Settings):
    """What came of a trial."""

    trial: Any


def threads_of(protocol: Protocol) -> list[Laid]:
    """The first thread of every scenario, then the second of each: what is interrupted has seen all scenarios."""
    return [
        Laid(scenario=scenario, thread=number)
        for number in range(1, protocol.threads + 1)
        for scenario in protocol.scenarios
    ]


def trials_on(protocol: Protocol, laid: Laid) -> Iterator[Trial]:
    """All trials on one thread."""
    for method in protocol.methods:
        for tool_error_mm in protocol.tool_errors_mm:
            for goal in range(protocol.goals):
                for policy in protocol.policies:
                    yield Trial(laid=laid, goal=goal, policy=policy, method=method, tool_error_mm=tool_error_mm)


def scene_seed(protocol: Protocol, laid: Laid) -> int:
    """Of the images and the field of a thread."""
    return 1000 * protocol.seed + laid.thread


def tool_seed(protocol: Protocol, trial: Trial) -> int:
    """Of the error of the tool tip: the same for all methods and sizes of it, so that they are compared alike."""
    return _seed(protocol, trial.laid.name, str(trial.goal), trial.policy)


def hand_eye_seed(protocol: Protocol, laid: Laid) -> int:
    """Of the error of registration, which a scenario has throughout."""
    return _seed(protocol, laid.scenario, "hand-eye")


def injected_m(protocol: Protocol, trial: Trial, look: int = 0) -> Float64[np.ndarray, "3"]:
    """By how much the thread of a trial's n-th look is moved as a whole, in metres; mostly by nothing."""
    rng = np.random.default_rng([_seed(protocol, trial.laid.name, str(trial.goal), "injected"), look])
    if rng.uniform() >= protocol.injected_share:
        return np.zeros(3)
    direction = rng.normal(size=3)
    return MM * protocol.injected_mm * rng.uniform() * direction / np.linalg.norm(direction)


def _seed(protocol: Protocol, *names: str) -> int:
    return zlib.crc32("/".join((str(protocol.seed), *names)).encode())
