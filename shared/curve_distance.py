"""How far two curves lie apart, in the project's one set of words.

- *mean*, *95 %*, *maximum*: nearest distances from either curve, sampled evenly by arc length, to the other; means and
  percentiles are averaged over both directions, the maximum is the larger one. Nearest distances forgive a curve that
  visits its places in the wrong order, therefore also
- *Fréchet*: the discrete Fréchet distance, the shortest leash for two walkers who each follow one curve forwards.
- *coverage*: the share of places where the true curve lies inside the predicted 95 % ellipse.
- *reprojection*: nearest distances in an image between the projected curve and the segmented pixels, both ways.

The direction of a curve is arbitrary, so the better of both is taken where order counts.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import KDTree

FRECHET_SAMPLES = 400
CHI_SQUARE_95 = 5.991
"""The 95 % quantile of the squared distance of a normal variable in two dimensions, −2 ln 0.05."""


@dataclass(frozen=True)
class CurveDistance:
    """Distances between two curves, in their unit."""

    mean: float
    percentile_95: float
    maximum: float
    frechet: float


def curve_distance(a: Float64[np.ndarray, "n d"], b: Float64[np.ndarray, "m d"]) -> CurveDistance:
    """Distances between two polylines whose points are evenly spaced along them."""
    from_a, from_b = nearest_distances(a, b), nearest_distances(b, a)
    few_a, few_b = _every(a, FRECHET_SAMPLES), _every(b, FRECHET_SAMPLES)
    return CurveDistance(
        mean=float(0.5 * (from_a.mean() + from_b.mean())),
        percentile_95=float(0.5 * (np.percentile(from_a, 95) + np.percentile(from_b, 95))),
        maximum=float(max(from_a.max(), from_b.max())),
        frechet=min(discrete_frechet(few_a, few_b), discrete_frechet(few_a, few_b[::-1])),
    )


def nearest_distances(points: Float64[np.ndarray, "n d"], to: Float64[np.ndarray, "m d"]) -> Float64[np.ndarray, "n"]:
    """The distance of each point to the nearest one of the others."""
    return np.asarray(KDTree(to).query(points)[0])


def discrete_frechet(a: Float64[np.ndarray, "n d"], b: Float64[np.ndarray, "m d"]) -> float:
    """The discrete Fréchet distance of two polylines (Eiter and Mannila 1994).

    The table c[i, j] = max(|a_i − b_j|, min(c[i−1, j], c[i, j−1], c[i−1, j−1])) is filled one anti-diagonal at a
    time, whose entries do not depend on each other.
    """
    n, m = len(a), len(b)
    distance = np.linalg.norm(a[:, None] - b[None], axis=2)
    reach = np.full((n + 1, m + 1), np.inf)
    reach[0, 0] = 0.0
    for diagonal in range(2, n + m + 1):
        i = np.arange(max(1, diagonal - m), min(n, diagonal - 1) + 1)
        j = diagonal - i
        before = np.minimum(np.minimum(reach[i - 1, j], reach[i, j - 1]), reach[i - 1, j - 1])
        reach[i, j] = np.maximum(distance[i - 1, j - 1], before)
    return float(reach[n, m])


def reprojection_px(
    curve_px: Float64[np.ndarray, "n 2"], segmented: Bool[np.ndarray, "h w"]
) -> tuple[Float64[np.ndarray, "i"], Float64[np.ndarray, "p"]]:
    """Distances from the projected curve to the nearest segmented pixel's centre, and from each pixel to the curve.

    Points of the curve outside the image are left out of the first; both are empty where nothing is segmented.
    """
    pixel = np.argwhere(segmented)[:, ::-1].astype(np.float64)
    height, width = segmented.shape
    inside = ((curve_px > -0.5) & (curve_px < (width - 0.5, height - 0.5))).all(axis=1)
    if len(pixel) == 0 or not inside.any():
        return np.zeros(0), np.zeros(0)
    return nearest_distances(curve_px[inside], pixel), nearest_distances(pixel, curve_px)


def inside_ellipse(
    points: Float64[np.ndarray, "q 3"],
    tangents: Float64[np.ndarray, "q 3"],
    covariance: Float64[np.ndarray, "q 3 3"],
    truth: Float64[np.ndarray, "m 3"],
) -> Bool[np.ndarray, "q"]:
    """Whether the true curve passes through the predicted 95 % ellipse in the plane normal to the thread.

    Args:
        points: places of the predicted curve, `tangents` its directions there (of any length).
        covariance: predicted at each place.
        truth: the true curve, sampled more densely than the ellipses are wide.
    """
    nearest = truth[np.asarray(KDTree(truth).query(points)[1])]
    # the last two right-singular vectors of a direction span the plane normal to it
    plane = np.linalg.svd(tangents[:, None, :])[2][:, 1:]
    offset = np.einsum("qij,qj->qi", plane, nearest - points)
    spread = np.einsum("qij,qjk,qlk->qil", plane, covariance, plane)
    distance = np.einsum("qi,qi->q", offset, np.linalg.solve(spread, offset[..., None])[..., 0])
    return distance <= CHI_SQUARE_95


def _every(points: Float64[np.ndarray, "n d"], count: int) -> Float64[np.ndarray, "k d"]:
    return points[np.unique(np.linspace(0, len(points) - 1, min(count, len(points))).round().astype(int))]
