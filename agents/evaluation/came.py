"""What came of a trial, as the journal keeps it."""

from typing import Literal

from agents.evaluation.protocol import Trial
from shared.runtime.config import Settings

Outcome = Literal["held", "failed", "declined"]


class Came(Settings):
    """What came of a trial. Lengths in metres, times in seconds of the simulated world.

    Fields:
        outcome: `declined` where planner or robot bridge would not, so that nothing moved.
        code: the cause in one word; sentence: the same in the words of whoever said so.
        s, s_capture: of the reconstruction; s_caught: of the true thread.
        goal_px: where the goal was in the left image, as reconstructed; capture_px likewise.
        probability: of success, as the plan promised.
        error_m, capture_error_m: how far the reconstructed goal, and capture, were from the true thread.
        injected_m: by how much the thread was moved before it was planned for.
        took_s, least_s: from armed to finished, and what the limits of speed alone ask for.
        attempts: how many grasps were tried; said: what the planner's own check said of the last one.
    """

    trial: Trial
    outcome: Outcome
    code: str
    sentence: str
    s: float | None = None
    s_capture: float | None = None
    s_caught: float | None = None
    goal_px: tuple[float, float] | None = None
    capture_px: tuple[float, float] | None = None
    probability: float | None = None
    slide_m: float | None = None
    error_m: float | None = None
    capture_error_m: float | None = None
    injected_m: float = 0.0
    took_s: float | None = None
    least_s: float | None = None
    peak_force_n: float | None = None
    slipped_m: float | None = None
    attempts: int = 1
    said: str | None = None
    processor_s: float = 0.0
