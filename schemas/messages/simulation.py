"""The simulated field: what is truly there, and whether a jaw caught it."""

import enum
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float64

from schemas.checks import Number, UInt64, check_message, require
from schemas.messages.imaging import RectifiedStereo
from schemas.messages.running import Consumed


@dataclass(frozen=True)
class SimulatorState:
    """The true field in the left camera's frame, metres: what the scene camera renders.

    Fields:
        background, colour, seed, distance_m: name the rendered tissue and thread.
        knots, control_points_camera: the thread as a clamped cubic B-spline.
        held: where along the thread a jaw holds it, as s; None where none does.
    """

    at_ns: int
    camera: RectifiedStereo
    background: str
    colour: str
    seed: UInt64
    distance_m: float
    radius_m: float
    knots: Float64[np.ndarray, "k"]
    control_points_camera: Float64[np.ndarray, "m 3"]
    held: float | None
    consumed: tuple[Consumed, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)
        require(self.radius_m > 0, f"the thread's radius must be positive, not {self.radius_m}")
        require(self.distance_m > 0, f"the tissue's distance must be positive, not {self.distance_m}")
        m = len(self.control_points_camera)
        require(
            m >= 4 and len(self.knots) == m + 4, f"{m} control points of a cubic do not go with {len(self.knots)} knots"
        )


class Verdict(enum.Enum):
    """Whether the thread was caught, and without more force on the tissue than was allowed."""

    HELD = 1
    MISSED = 2
    LOST = 3
    FORCE_EXCEEDED = 4


@dataclass(frozen=True)
class GraspJudgement:
    """What became of one plan in the simulated field, judged against the true thread.

    Fields:
        s_caught: where along the true thread the jaw closed on it, None where it did not.
        slid_m: how far along the thread it slid since capture.
        error_m: how far the reconstructed goal was from the true thread; None where the plan is not known.
        sentence: the same in plain words.
        peak_tissue_force_n: the most force that the fingers put on the tissue; None where no forces were computed.
        slipped_m: how far the thread slipped through the closed fingers while they lifted it; None likewise.
        code: the reason in one word for counting, such as HELD, BESIDE, BEYOND_THE_FINGERTIPS or SLIPPED_ON_SLIDE
            (docs/simulator.md lists them); empty in recordings from before there were any.
    """

    plan_id: str
    arm: str
    at_ns: int
    verdict: Verdict
    s_caught: float | None
    slid_m: float
    error_m: float | None
    sentence: str
    peak_tissue_force_n: float | None = None
    slipped_m: float | None = None
    code: str = ""
    consumed: Annotated[tuple[Consumed, ...], Number(9)] = ()

    def __post_init__(self) -> None:
        check_message(self)
