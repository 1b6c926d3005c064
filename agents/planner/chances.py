"""How likely a grasp succeeds from each capture and with each way to hold the tool.

`geometric`: the probability that the thread lies in the wedge that the fingers sweep (`wedge.py`), times that of
keeping it on the way, from the posterior covariance of the reconstruction and the errors of the tool.
`paper`: the reconstruction's own confidence, P(s) · 0.99^steps, for all ways alike. A reconstruction that tells of no
covariance is planned on by the latter.

**Keeping the thread** from the capture to the goal: what is off at the capture is mostly off everywhere: the errors of
tool and registration are the same all along a slide, and only the error of the reconstruction changes along the thread.
So a grasp is followed for a fixed set of errors drawn from one distribution,

    e(s) = c + L(s) ξ(s),   L Lᵀ = Σ(s),   c ~ N(0, Σ_offset + Σ_tool),

with ξ a Gauss-Markov sequence, E ξ(s) ξ(s')ᵀ = exp(−|s − s'| length / ℓ) I: two places farther apart than ℓ are wrong
independently. The share of those captured at s_i that lie within the opening of the slide at every sample from s_i to
the goal is the probability of keeping the thread. The draws are the same for all captures, ways and plans, so what is
compared differs by geometry alone, and a plan is repeated exactly.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.planner.config import PlannerConfig
from agents.planner.curve import ThreadCurve
from agents.planner.policy import capture_probability, grasp_probability, least_on_the_way
from agents.planner.ways import Ways
from agents.planner.wedge import (
    Offset,
    across_jaw,
    face_half_width,
    thread_covariance,
    tips_half_width,
    tool_covariance,
    wedge_probability,
)
from schemas.messages import ThreadReconstruction

DRAWS, SEED = 256, 20251122
TINY_M2 = 1e-18


def drawn_errors(
    covariance: Float64[np.ndarray, "n 3 3"], offset: Offset, step_m: float, config: PlannerConfig
) -> Float64[np.ndarray, "m n 3"]:
    """Where the thread is, less where it is taken to be as the fingers see it, for each draw at each sample.

    Args:
        step_m: the way along the thread from one sample to the next.
    """
    common, along = _normals(len(covariance))
    constant = common @ _root(offset.covariance + tool_covariance(config)).T
    kept = np.exp(-step_m / config.correlation_m)
    field = along.copy()
    for k in range(1, len(covariance)):
        field[:, k] = kept * field[:, k - 1] + np.sqrt(1.0 - kept**2) * along[:, k]
    return constant[:, None] + np.einsum("nij,mnj->mni", _root(covariance), field)


@dataclass(frozen=True)
class Spread:
    """Where drawn errors put the thread in the plane across the pin, for each way and sample, m draws each.

    Fields:
        beside_m: to either side of the middle between the fingers, without a sign.
        beyond_m: along the fingers, less where the thread is meant to be.
    """

    beside_m: Float64[np.ndarray, "w n m"]
    beyond_m: Float64[np.ndarray, "w n m"]


def spread(errors: Float64[np.ndarray, "m n 3"], R_camera_tool: Float64[np.ndarray, "w n 3 3"]) -> Spread:
    """Drawn errors as the jaws see them."""
    plane = np.swapaxes(R_camera_tool[..., 1:], -1, -2) @ np.ascontiguousarray(errors.transpose(1, 2, 0))
    return Spread(np.abs(plane[..., 0, :]), plane[..., 1, :])


class Swept:
    """Jaws whose pin is so far before where the thread is meant to be, and which of the draws they have between them.

    Draws are bits of bytes, so that all openings for the approach can be put beside all for the slide.
    """

    def __init__(self, drawn: Spread, setback_m: float, goal: int) -> None:
        self._beside_m, self._z_m, self._goal = drawn.beside_m, drawn.beyond_m + setback_m, goal
        self._before_tips = (self._z_m > 0) & (self._beside_m <= tips_half_width(self._z_m))

    def captured(self, opening_rad: float) -> UInt8[np.ndarray, "w n m_8"]:
        """Between fingers of that opening."""
        return np.packbits(self._within(opening_rad, 0.0), axis=-1)

    def kept(self, opening_rad: float, give_m: float) -> UInt8[np.ndarray, "w n m_8"]:
        """The same at every sample from each one to the goal, though a thread gives way by so much."""
        holds = np.packbits(self._within(opening_rad, give_m), axis=-1)
        after = np.bitwise_and.accumulate(holds[:, self._goal :], axis=1)
        before = np.bitwise_and.accumulate(holds[:, self._goal :: -1], axis=1)[:, ::-1]
        return np.concatenate((before[:, :-1], after), axis=1)

    def _within(self, opening_rad: float, give_m: float) -> Bool[np.ndarray, "w n m"]:
        return self._before_tips & (self._beside_m <= face_half_width(self._z_m, 0.5 * opening_rad, give_m))


def keep_probability(
    captured: UInt8[np.ndarray, "w n m_8"], kept: UInt8[np.ndarray, "w n m_8"], goal: int
) -> Float64[np.ndarray, "w n"]:
    """That a thread captured at each sample is still between the fingers at the goal; 1 at the goal itself."""
    share = _count(captured & kept) / np.maximum(_count(captured), 1)
    share[:, goal] = 1.0
    return share


def _count(bits: UInt8[np.ndarray, "w n m_8"]) -> Int64[np.ndarray, "w n"]:
    return np.bitwise_count(bits).sum(axis=-1, dtype=np.int64)


@functools.cache
def _normals(n: int) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, "m n 3"]]:
    """Each with its opposite, so that what is symmetric stays so."""
    rng = np.random.default_rng(SEED)
    common, along = rng.standard_normal((DRAWS // 2, 3)), rng.standard_normal((DRAWS // 2, n, 3))
    return np.concatenate((common, -common)), np.concatenate((along, -along))


def _root(covariance: Float64[np.ndarray, "*n 3 3"]) -> Float64[np.ndarray, "*n 3 3"]:
    """The symmetric root, which rounding of what is singular does no harm."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
    return (vectors * np.sqrt(np.maximum(values, TINY_M2))[..., None, :]) @ np.swapaxes(vectors, -1, -2)


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
