"""A correction from the edges of an instrument in both eyes: the most probable one, given the one before.

With e the signed distance of an edge from the expected outline, along its normal n and outward in pixels, and J the
slope of that outline with the twist, each step minimises

    Σ ρ((e - J ξ - β - s) / σ) + Σ (s / σ_s)² + Σ (β / σ_β)² + (ξ + ξ₀ - ξ₋)ᵀ P⁻¹ (ξ + ξ₀ - ξ₋),

ρ being Tukey's biweight: an iterated extended Kalman filter's update (Bell and Cathey, 1993) against outliers. β is by
how much the outline of one kind of part looks wider than it is (blur, light, a tool made a little thicker), and s by
how much one place of it lies beside where the shape has it. Both are the same in both eyes and are eliminated: depth
then comes from the difference between the eyes, in which they cancel, and hardly from how wide the shaft looks, of
which a pixel in 90 is a millimetre at 90 mm. Neighbouring edges err alike, so that each counts for 1 / ALIKE of a
measurement.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float64, Int64

from agents.tool_tracker.correction import Correction, about, point_slope, twist_about
from agents.tool_tracker.evidence import Eye, edges
from agents.tool_tracker.outline import Outline, outline
from agents.tool_tracker.tubes import DRIVER, Shape, Tube, tubes
from schemas.messages import RectifiedStereo

SIGMA_PX, PLACE_PX = 0.4, 0.7
ALIKE = 16.0
WIDER_PX = (1.0, 1.0, 1.0)
"""Deviation of β: of the shaft, of the wrist and the shaft's end, of the fingers."""
GROUP = np.array((0, 1, 2, 2, 1))
"""Which of them is of SHAFT, WRIST, FINGER, TIP and END."""
TUKEY_PX = 4.0
FITS_PX = 2.5
ROUNDS = 6
REACH_PX = (6.0, 45.0)
ASIDE_RAD, ASIDE_REACH_PX = 0.05, 18.0
BETTER, FAR_BETTER = 0.03, 0.2
"""By how much another start must be better, for what chance makes of it not to count, and where it leads far away."""
LARGEST_SHIFT = 30.0
"""Of a chi square with 6 degrees of freedom, exceeded once in 25 000 times."""


@dataclass(frozen=True, eq=False)
class View:
    """What is known at one moment: images, and where registration and joints have the tool.

    Fields:
        camera: in metres.
    """

    camera: RectifiedStereo
    eyes: tuple[Eye, Eye] | tuple[()]
    T_camera_base: Float64[np.ndarray, "4 4"]
    T_base_tool: Float64[np.ndarray, "4 4"]
    jaw_rad: float

    def parts(self, C: Float64[np.ndarray, "4 4"], shape: Shape = DRIVER) -> tuple[Tube, ...]:
        """The instrument with a correction."""
        return tubes(C @ self.T_camera_base, self.T_base_tool, self.jaw_rad, shape)

    def expected(self, C: Float64[np.ndarray, "4 4"], shape: Shape = DRIVER) -> tuple[Outline, Outline]:
        """Its outlines in both eyes."""
        parts = self.parts(C, shape)
        left, right = (outline(self.camera, parts, eye_x) for eye_x in (0.0, self.camera.baseline))
        return left, right


@dataclass(frozen=True, eq=False)
class Refined:
    """A correction, and how well the images bear it out.

    Fields:
        expected: points of the outline in view, of both eyes.
        fits: the share of them at which there is an edge; `quality` weighs them by how near it is.
        residual_px: of the edges that fit, root mean square.
        shift: the squared length of the change by the prior covariance; of a chi square with 6 degrees of freedom.
    """

    correction: Correction
    expected: int
    fits: float
    quality: float
    residual_px: float
    shift: float


def refined(view: View, before: Correction, rounds: int = ROUNDS, first_reach_px: float | None = None) -> Refined:
    """The correction after this view."""
    information = np.linalg.inv(before.covariance)
    pivot, twist = before.pivot, before.twist.copy()
    px_per_m = view.camera.fx_px / max(float(pivot[2]), 0.02)
    spread = px_per_m * float(np.sqrt(np.trace(before.covariance[:3, :3]) / 3))
    reach = first_reach_px or float(np.clip(3 * spread, *REACH_PX))
    total = information
    for _ in range(rounds):
        C = about(pivot, twist)
        seen = _gathered(view, C, pivot, reach, spread)
        weight = np.where(seen.found, _tukey(seen.distance, max(TUKEY_PX, 0.5 * reach)), 0.0)
        total, right = _normal(seen, weight)
        offset = twist_about(pivot, C) - before.twist
        total, right = total + information, right - information @ offset
        step = np.linalg.solve(total, right)
        twist = twist_about(pivot, about(pivot, step) @ C)
        reach = max(REACH_PX[0], 0.6 * reach)
        spread = max(1.0, 0.5 * spread)
        if np.abs(step[:3]).max() < 2e-6 and np.abs(step[3:]).max() < 2e-5 and reach <= REACH_PX[0]:
            break
    seen = _gathered(view, about(pivot, twist), pivot, REACH_PX[0], 2.0)
    e, found = seen.distance, seen.found
    fitting = found & (np.abs(e) < FITS_PX)
    change = twist - before.twist
    return Refined(
        Correction(twist, np.linalg.inv(total), pivot),
        len(e),
        float(fitting.mean()) if len(e) else 0.0,
        float(np.where(found, _tukey(e, TUKEY_PX), 0.0).mean()) if len(e) else 0.0,
        float(np.sqrt((e[fitting] ** 2).mean())) if fitting.any() else float("inf"),
        float(change @ information @ change),
    )


def elsewhere(view: View, found: Refined, steps_m: tuple[float, ...], before: Correction | None = None) -> Refined:
    """The best of what was found and of what starts so far beside it lead to, in the direction that is known least.

    Edges of different parts lie one behind another along the shaft, and a fit may have settled on the wrong ones.

    Args:
        before: what was known before this view; what is farther from it than it allows must be better by far.
    """
    C = found.correction
    w = np.linalg.eigh(C.covariance[:3, :3])[1][:, -1]
    way = C.covariance[:, :3] @ w
    way /= float(np.linalg.norm(way[:3]))
    best = found
    for step_m in steps_m:
        turned = np.clip(step_m * way[3:], -ASIDE_RAD, ASIDE_RAD)
        start = Correction(
            C.twist + np.concatenate((step_m * way[:3], turned)), np.diag(np.repeat((0.003, 0.03), 3) ** 2), C.pivot
        )
        other = refined(view, start, first_reach_px=ASIDE_REACH_PX)
        if other.quality > best.quality + (BETTER if before is None or _allowed(before, other) else FAR_BETTER):
            best = other
    return best


def _allowed(before: Correction, found: Refined) -> bool:
    change = found.correction.twist - before.twist
    return float(change @ np.linalg.solve(before.covariance, change)) <= LARGEST_SHIFT


@dataclass(frozen=True, eq=False)
class _Seen:
    """Edges of both eyes: distances, their slopes with twist and β, the place of each, and which were found."""

    distance: Float64[np.ndarray, "n"]
    slope: Float64[np.ndarray, "n k"]
    place: Int64[np.ndarray, "n"]
    found: Bool[np.ndarray, "n"]


def _gathered(
    view: View, C: Float64[np.ndarray, "4 4"], pivot: Float64[np.ndarray, "3"], reach: float, spread: float
) -> _Seen:
    camera, told = view.camera, list[_Seen]()
    for image, expected, eye_x in zip(view.eyes, view.expected(C), (0.0, camera.baseline), strict=True):
        found = edges(image, expected, reach, spread)
        x, y, z = (expected.points_camera - (eye_x, 0.0, 0.0)).T
        zero = np.zeros(len(x))
        u = np.column_stack((camera.fx_px / z, zero, -camera.fx_px * x / z**2))
        v = np.column_stack((zero, camera.fy_px / z, -camera.fy_px * y / z**2))
        across = expected.normal[:, :1] * u + expected.normal[:, 1:] * v
        J = np.einsum("ni,nij->nj", across, point_slope(expected.points_camera, pivot))
        wider = GROUP[expected.part][:, None] == np.arange(len(WIDER_PX))
        told.append(_Seen(found.distance, np.hstack((J, wider)), expected.place, found.contrast > 0))
    return _Seen(*(np.concatenate([getattr(one, f.name) for one in told]) for f in fields(_Seen)))


def _normal(
    seen: _Seen, weight: Float64[np.ndarray, "n"]
) -> tuple[Float64[np.ndarray, "6 6"], Float64[np.ndarray, "6"]]:
    """Normal equations of the twist; what each place and each part has in common is eliminated (Schur)."""
    w = weight / (ALIKE * SIGMA_PX**2)
    index = np.unique(seen.place, return_inverse=True)[1]
    regress = np.column_stack((seen.slope, seen.distance))
    of_place = np.zeros((int(index.max(initial=-1)) + 1, regress.shape[1]))
    np.add.at(of_place, index, w[:, None] * regress)
    own = np.bincount(index, w, len(of_place)) + 1 / (ALIKE * PLACE_PX**2)
    total = (regress * w[:, None]).T @ regress - (of_place / own[:, None]).T @ of_place
    N, right = total[:-1, :-1], total[:-1, -1]
    N[6:, 6:] += np.diag(1 / (ALIKE * np.square(WIDER_PX)))
    gain = np.linalg.solve(N[6:, 6:], N[6:, :6]).T
    return N[:6, :6] - gain @ N[6:, :6], right[:6] - gain @ right[6:]


def _tukey(e: np.ndarray, limit: float) -> np.ndarray:
    return np.maximum(1 - (e / limit) ** 2, 0.0) ** 2
