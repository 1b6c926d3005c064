"""Where the thread lies with 95 % probability: ellipses in the planes across it, a tube along it.

With C the posterior covariance of a point and N two unit vectors across the thread, Σ = Nᵀ C N is the covariance within
the plane. Its ellipse of 95 % is √5.991 Σ^½ (cos φ, sin φ), and the largest eigenvalue of Σ is the variance in the
worst direction. What is unknown along the thread moves no point off it, and does not count.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from agents.viewer.polyline import Polyline, along_at, at_shares
from schemas.messages import ThreadReconstruction
from shared.curve_distance import CHI_SQUARE_95
from shared.splines import evaluate

CORNERS = 12
"""Of a ring about the thread."""
TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class CrossSections:
    """What is predicted across the thread at places along it, none where the method predicts nothing.

    Fields:
        along: which share of the length lies before each place.
        deviation: standard deviation across the thread in its worst direction, in the unit of the calibration.
        rings_camera: the ellipse of 95 % as corners of a closed line; corners of one number lie beside each other.
        confidence, unseen: of the thread there.
    """

    along: Float64[np.ndarray, "q"]
    deviation: Float64[np.ndarray, "q"]
    rings_camera: Float64[np.ndarray, "q k 3"]
    confidence: Float64[np.ndarray, "q"]
    unseen: Bool[np.ndarray, "q"]


def cross_sections(reconstruction: ThreadReconstruction, thread: Polyline | None) -> CrossSections:
    """The cross-sections where the posterior is given, in order along the thread."""
    empty = np.zeros(0)
    if thread is None or not len(reconstruction.posterior_s):
        return CrossSections(empty, empty, np.zeros((0, CORNERS, 3)), empty, np.zeros(0, bool))
    order = np.argsort(reconstruction.posterior_s)
    s, covariance = reconstruction.posterior_s[order], reconstruction.posterior_covariance[order]
    curve = reconstruction.knots, reconstruction.control_points_camera, reconstruction.degree
    with np.errstate(all="ignore"):
        across = _across(evaluate(*curve, s, derivative=1))
        within = np.einsum("qai,qab,qbj->qij", across, covariance, across)
        deviation, root = _deviation_and_root(within)
        angle = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
        circle = np.sqrt(CHI_SQUARE_95) * np.stack((np.cos(angle), np.sin(angle)))
        rings = evaluate(*curve, s)[:, None] + np.moveaxis(across @ root @ circle, 2, 1)
    known = np.isfinite(rings).all(axis=(1, 2)) & np.isfinite(deviation)
    along = along_at(thread, s[known])
    confidence, unseen = at_shares(thread, along)
    return CrossSections(along, deviation[known], rings[known], confidence, unseen)


@functools.cache
def tube_triangles(rings: int) -> Int64[np.ndarray, "t 3"]:
    """The corners of the triangles between neighbouring rings, with the corners of all rings numbered one by one."""
    corner = np.arange(CORNERS)
    beside = (corner + 1) % CORNERS
    one = np.concatenate(
        (np.stack((corner, beside, corner + CORNERS), 1), np.stack((beside, beside + CORNERS, corner + CORNERS), 1))
    )
    return (one + CORNERS * np.arange(max(rings - 1, 0))[:, None, None]).reshape(-1, 3)


def _across(tangent: Float64[np.ndarray, "q 3"]) -> Float64[np.ndarray, "q 3 2"]:
    """Two unit vectors across the thread at each place, turned as little as can be from one place to the next."""
    t = tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), TINY)
    beside = np.eye(3)[np.argmin(np.abs(t[0]))].tolist()
    rows: list[list[float]] = []
    # one place follows from the one before it, where plain numbers take a tenth of the time of small arrays
    for x, y, z in t.tolist():
        u, v, w = beside
        along = u * x + v * y + w * z
        u, v, w = u - along * x, v - along * y, w - along * z
        size = max(math.sqrt(u * u + v * v + w * w), TINY)
        beside = [u / size, v / size, w / size]
        rows.append(beside)
    first = np.array(rows).reshape(t.shape)
    return np.stack((first, np.cross(t, first)), axis=2)


def _deviation_and_root(
    covariance: Float64[np.ndarray, "q 2 2"],
) -> tuple[Float64[np.ndarray, "q"], Float64[np.ndarray, "q 2 2"]]:
    """The root of the largest eigenvalue, and the symmetric root Σ^½ = (Σ + √|Σ| I) / √(tr Σ + 2 √|Σ|)."""
    a, b, d = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    largest = 0.5 * (a + d) + np.hypot(0.5 * (a - d), b)
    product = np.sqrt(np.maximum(a * d - b * b, 0.0))
    norm = np.sqrt(np.maximum(a + d + 2.0 * product, TINY))
    root = (covariance + product[:, None, None] * np.eye(2)) / norm[:, None, None]
    return np.sqrt(np.maximum(largest, 0.0)), root
