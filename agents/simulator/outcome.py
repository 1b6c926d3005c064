"""What a physics says of a grasp, whichever it is."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float64

from agents.simulator.field import Field
from schemas.messages import Verdict


@dataclass(frozen=True)
class Outcome:
    """What became of a grasp so far; where it is not settled, what is to be said if it ends like that.

    Fields:
        s_caught, slid_m, peak_tissue_force_n, slipped_m, code: as of GraspJudgement.
        sentence: without the error of the goal.
    """

    settled: bool
    verdict: Verdict
    code: str
    sentence: str
    s_caught: float | None = None
    slid_m: float = 0.0
    peak_tissue_force_n: float | None = None
    slipped_m: float | None = None


@dataclass(frozen=True)
class MeasuredArm:
    """Where an arm's tool truly is, and since when."""

    name: str
    plan_id: str
    T_camera_tool: Float64[np.ndarray, "4 4"]
    jaw_rad: float
    measured_ns: int


class Physics(Protocol):
    """A thread on tissue among the fingers of arms."""

    @property
    def field(self) -> Field:
        """The field as it is."""
        ...

    @property
    def held_sample(self) -> int | None:
        """Which sample of the thread a jaw holds, None where none does."""
        ...

    def lay(self) -> None:
        """Lay the thread as it was at first, out of any jaw."""
        ...

    def follow(self, arm: MeasuredArm) -> Outcome:
        """What becomes of the field and of the arm's grasp when it has been measured there."""
        ...

    def carry(self) -> None:
        """Bring the thread up to date."""
        ...
