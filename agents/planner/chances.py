"""How likely a grasp succeeds from each capture and with each way to hold the tool.

`geometric`: the probability that the thread lies in the wedge that the fingers sweep (`wedge.py`), times that of
keeping it on the way (`slide.py`), from the posterior covariance of the reconstruction and the errors of the tool.
`paper`: the reconstruction's own confidence, P(s) · 0.99^steps, for all ways alike. A reconstruction that tells of no
covariance is planned on by the latter.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from agents.planner.config import PlannerConfig
from agents.planner.curve import ThreadCurve
from agents.planner.errors import Offset, across_jaw, thread_covariance, tool_covariance
from agents.planner.policy import capture_probability, grasp_probability, least_on_the_way
from agents.planner.slide import Spread, Swept, drawn_errors, keep_probability, spread
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
    asked: slice = slice(None),
) -> Known:
    """What a reconstruction tells of those of these places that are asked for, with what is known of the fingers."""
    covariance = thread_covariance(thread, curve, s) if config.policy_model == GEOMETRIC else None
    errors = None
    if covariance is not None:
        covariance = covariance[asked]
        errors = drawn_errors(covariance, offset, curve.length_m / max(len(s) - 1, 1), config)
    return Known(capture_probability(thread, s)[asked], covariance, errors, offset)


def chances(known: Known, ways: Ways, goal: int, config: PlannerConfig) -> Chances:
    """Of each capture with a slide to the goal's sample."""
    if known.covariance is None or known.errors is None:
        count = len(ways.on_thread)

        def alike(one: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "w n"]:
            return np.broadcast_to(one, (count, len(one)))

        captured, keep = known.confidence, config.keep_probability
        stated = grasp_probability(least_on_the_way(captured, goal), goal, keep)
        return Chances(alike(grasp_probability(captured, goal, keep)), alike(stated), alike(captured))
    aimed = aimed_with(known, ways, config)
    (whole,) = aimed.whole(goal, [config])
    return Chances(whole, whole, aimed.slid(config))


class Aimed:
    """Jaws turned as they are in some ways, whatever their depth and openings, and how the errors look to them."""

    def __init__(self, covariance: Float64[np.ndarray, "w n 2 2"], drawn: Spread) -> None:
        self._covariance, self._drawn = covariance, drawn

    def whole(self, goal: int, grips: Sequence[PlannerConfig]) -> list[Float64[np.ndarray, "w n"]]:
        """How likely a whole grasp succeeds with each of these depths and openings, for each way and capture.

        What several of them have in common is computed once.
        """

        @functools.cache
        def swept(setback_m: float) -> Swept:
            return Swept(self._drawn, setback_m, goal)

        @functools.cache
        def captured(
            setback_m: float, open_deg: float
        ) -> tuple[Float64[np.ndarray, "w n"], UInt8[np.ndarray, "w n b"]]:
            opening_rad = np.radians(open_deg)
            return self._between(setback_m, opening_rad, 0.0), swept(setback_m).captured(opening_rad)

        @functools.cache
        def kept(setback_m: float, slide_deg: float, give_m: float) -> UInt8[np.ndarray, "w n b"]:
            return swept(setback_m).kept(np.radians(slide_deg), give_m)

        found: list[Float64[np.ndarray, "w n"]] = []
        for grip in grips:
            likely, draws = captured(grip.setback_m, grip.open_deg)
            found.append(likely * keep_probability(draws, kept(grip.setback_m, grip.slide_deg, grip.give_m), goal))
        return found

    def slid(self, grip: PlannerConfig) -> Float64[np.ndarray, "w n"]:
        """That the thread is between the fingers as they stand while they slide."""
        return self._between(grip.setback_m, np.radians(grip.slide_deg), grip.give_m)

    def _between(self, setback_m: float, opening_rad: float, give_m: float) -> Float64[np.ndarray, "w n"]:
        mean = np.broadcast_to(np.array([0.0, setback_m]), self._covariance.shape[:-1])
        return wedge_probability(mean, self._covariance, opening_rad, give_m)


def aimed_with(known: Known, ways: Ways, config: PlannerConfig) -> Aimed:
    """The jaws in these ways, where a covariance is known."""
    assert known.covariance is not None and known.errors is not None  # noqa: S101 - asked of the geometric model alone
    R_camera_tool = ways.on_thread[:, 0, :, :3, :3]
    total = known.covariance + known.offset.covariance + tool_covariance(config)
    return Aimed(across_jaw(R_camera_tool, total), spread(known.errors, R_camera_tool))
