"""How likely a grasp succeeds from each capture and with each way to hold the tool.

`geometric`: the probability that the thread lies in the wedge that the fingers sweep (`wedge.py`), times that of
keeping it on the way (`slide.py`), from the posterior covariance of the reconstruction and the errors of the tool.
`paper`: the reconstruction's own confidence, P(s) · 0.99^steps, for all ways alike. A reconstruction that tells of no
covariance is planned on by the latter.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.curve import ThreadCurve
from agents.planner.errors import Offset, across_jaw, thread_covariance, tool_covariance
from agents.planner.policy import capture_probability, grasp_probability, least_on_the_way
from agents.planner.slide import drawn_errors, keep_probability
from agents.planner.ways import Ways
from agents.planner.wedge import wedge_probability
from schemas.messages import ThreadReconstruction

PAPER, GEOMETRIC = "paper", "geometric"


@dataclass(frozen=True)
class Known:
    """What is known of where the thread is at samples along it.

    Fields:
        confidence: as the reconstruction states it.
        covariance: in m²; None where the paper's model is used.
        errors: as `drawn_errors` gives them; None likewise.
        offset: of the fingers; where they are aimed makes up for its mean.
    """

    confidence: Float64[np.ndarray, "n"]
    covariance: Float64[np.ndarray, "n 3 3"] | None
    errors: Float64[np.ndarray, "m n 3"] | None
    offset: Offset

    @property
    def aim_camera(self) -> Float64[np.ndarray, "3"]:
        """By how much the tool is aimed beside the thread."""
        return -self.offset.mean_camera

    @property
    def model(self) -> str:
        """Which of the two models is used."""
        return PAPER if self.covariance is None else GEOMETRIC


@dataclass(frozen=True)
class Chances:
    """Of success, for each way and sample.

    Fields:
        likelihood: of the whole grasp, by which captures are chosen.
        probability: of the whole grasp, which is stated.
        here: that the thread is between the fingers as they stand while they slide.
    """

    likelihood: Float64[np.ndarray, "w n"]
    probability: Float64[np.ndarray, "w n"]
    here: Float64[np.ndarray, "w n"]


def known_along(
    thread: ThreadReconstruction,
    curve: ThreadCurve,
    s: Float64[np.ndarray, "n"],
    config: PlannerConfig,
    offset: Offset,
) -> Known:
    """What a reconstruction tells of these places, with what is known of the fingers."""
    covariance = thread_covariance(thread, curve, s) if config.policy_model == GEOMETRIC else None
    errors = None
    if covariance is not None:
        errors = drawn_errors(covariance, offset, curve.length_m / max(len(s) - 1, 1), config)
    return Known(capture_probability(thread, s), covariance, errors, offset)


def chances(known: Known, ways: Ways, goal: int, config: PlannerConfig) -> Chances:
    """Of each capture with a slide to the goal's sample."""
    if known.covariance is None or known.errors is None:
        count = len(ways.on_thread)

        def alike(one: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "w n"]:
            return np.broadcast_to(one, (count, len(one)))

        captured, keep = known.confidence, config.keep_probability
        stated = grasp_probability(least_on_the_way(captured, goal), goal, keep)
        return Chances(alike(grasp_probability(captured, goal, keep)), alike(stated), alike(captured))
    R_camera_tool = ways.on_thread[:, 0, :, :3, :3]
    total = known.covariance + known.offset.covariance + tool_covariance(config)
    covariance = across_jaw(R_camera_tool, total)
    mean = np.broadcast_to(np.array([0.0, config.setback_m]), covariance.shape[:-1])
    captured = wedge_probability(mean, covariance, np.radians(config.open_deg))
    here = wedge_probability(mean, covariance, np.radians(config.slide_deg), config.give_m)
    whole = captured * keep_probability(known.errors, R_camera_tool, goal, config)
    return Chances(whole, whole, here)
