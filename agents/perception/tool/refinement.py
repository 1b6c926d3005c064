"""A correction from the edges of an instrument in both eyes: the most probable one, given the one before.

With e the signed distance of an edge from the expected outline, along its normal n and outward in pixels, and J the
slope of that outline with the twist, each step minimises

    Σ ρ((e - J ξ - β) / σ) + (ξ + ξ₀ - ξ₋)ᵀ P⁻¹ (ξ + ξ₀ - ξ₋) + |β / σ_β|²,

ρ being Tukey's biweight: an iterated extended Kalman filter's update (Bell and Cathey, 1993) against outliers. β is by
how much outlines of one part look wider than they are (blur, light, a shape known to half a millimetre); it is the same
in both eyes, and is eliminated. Neighbouring edges err alike, so that each counts for 1 / ALIKE of a measurement.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.perception.tool.correction import Correction, about, point_slope, twist_about
from agents.perception.tool.evidence import Eye, edges
from agents.perception.tool.outline import Outline, outline
from agents.perception.tool.tubes import DRIVER, SHAFT, Shape, Tube, tubes
from schemas.messages import RectifiedStereo

SIGMA_PX = 0.8
ALIKE = 16.0
WIDER_PX = (0.4, 1.0)
"""Deviation of β, of the shaft and of the other parts."""
TUKEY_PX = 4.0
FITS_PX = 2.5
ROUNDS = 6
REACH_PX = (6.0, 45.0)
ASIDE_RAD, ASIDE_REACH_PX = 0.05, 18.0
BETTER = 0.03
"""By how much another start must be better, for what chance makes of it not to count."""


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
    total, gathered = information, None
    for _ in range(rounds):
        C = about(pivot, twist)
        gathered = _gathered(view, C, pivot, reach, spread)
        e, J, group, found = gathered
        weight = np.where(found, _tukey(e, max(TUKEY_PX, 0.5 * reach)), 0.0) / (ALIKE * SIGMA_PX**2)
        total, right = _normal(e, J, group, weight)
        offset = twist_about(pivot, C) - before.twist
        total, right = total + information, right - information @ offset
        step = np.linalg.solve(total, right)
        twist = twist_about(pivot, about(pivot, step) @ C)
        reach = max(REACH_PX[0], 0.6 * reach)
        spread = max(1.0, 0.5 * spread)
        if np.abs(step[:3]).max() < 2e-6 and np.abs(step[3:]).max() < 2e-5 and reach <= REACH_PX[0]:
            break
    e, _, _, found = _gathered(view, about(pivot, twist), pivot, REACH_PX[0], 2.0)
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


def elsewhere(view: View, found: Refined, steps_m: tuple[float, ...]) -> Refined:
    """The best of what was found and of what starts so far beside it lead to, in the direction that is known least.

    Edges of different parts lie one behind another along the shaft, and a fit may have settled on the wrong ones.
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
        if other.quality > best.quality + BETTER:
            best = other
    return best


def _gathered(
    view: View, C: Float64[np.ndarray, "4 4"], pivot: Float64[np.ndarray, "3"], reach: float, spread: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distances of edges in both eyes, their slopes with the twist, the group of β of each, and which were found."""
    camera, told = view.camera, []
    for image, expected, eye_x in zip(view.eyes, view.expected(C), (0.0, camera.baseline), strict=True):
        found = edges(image, expected, reach, spread)
        x, y, z = (expected.points_camera - (eye_x, 0.0, 0.0)).T
        zero = np.zeros(len(x))
        u = np.column_stack((camera.fx_px / z, zero, -camera.fx_px * x / z**2))
        v = np.column_stack((zero, camera.fy_px / z, -camera.fy_px * y / z**2))
        across = expected.normal[:, :1] * u + expected.normal[:, 1:] * v
        J = np.einsum("ni,nij->nj", across, point_slope(expected.points_camera, pivot))
        told.append((found.distance, J, (expected.part != SHAFT).astype(np.int64), found.contrast > 0))
    e, slope, group, found = (np.concatenate(one) for one in zip(*told, strict=True))
    return e, slope, group, found


def _normal(
    e: np.ndarray, J: np.ndarray, group: np.ndarray, weight: np.ndarray
) -> tuple[Float64[np.ndarray, "6 6"], Float64[np.ndarray, "6"]]:
    """Normal equations of the twist, β eliminated (Schur)."""
    JW = J * weight[:, None]
    total, right = JW.T @ J, JW.T @ e
    for i, deviation in enumerate(WIDER_PX):
        mine = group == i
        own = float(weight[mine].sum()) + 1 / (ALIKE * deviation**2)
        with_twist = JW[mine].sum(axis=0)
        total = total - np.outer(with_twist, with_twist) / own
        right = right - with_twist * float(weight[mine] @ e[mine]) / own
    return total, right


def _tukey(e: np.ndarray, limit: float) -> np.ndarray:
    return np.maximum(1 - (e / limit) ** 2, 0.0) ** 2
