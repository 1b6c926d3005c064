"""How far two curves lie apart, in the project's one set of words.

- *mean*, *95 %*, *maximum*: nearest distances from either curve, sampled evenly by arc length, to the other; means and
  percentiles are averaged over both directions, the maximum is the larger one. Nearest distances forgive a curve that
  visits its places in the wrong order, therefore also
- *Fréchet*: the discrete Fréchet distance, the shortest leash for two walkers who each follow one curve forwards.
- *end error*: how far the ends lie apart, averaged over both.
- *coverage*: the share of places where the true curve lies inside the predicted 95 % ellipse of the normal plane.
- *negative log likelihood*: −log of the density that is predicted for where the true curve crosses that plane.
- *reprojection*: nearest distances in an image between the projected curve and the segmented pixels, both ways.

The direction of a curve is arbitrary, so the better of both is taken where order counts.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
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
    ends: float


def curve_distance(a: Float64[np.ndarray, "n d"], b: Float64[np.ndarray, "m d"]) -> CurveDistance:
    """Distances between two polylines whose points are evenly spaced along them."""
    from_a, from_b = distances_to_polyline(a, b), distances_to_polyline(b, a)
    few_a, few_b = _every(a, FRECHET_SAMPLES), _every(b, FRECHET_SAMPLES)
    return CurveDistance(
        mean=float(0.5 * (from_a.mean() + from_b.mean())),
        percentile_95=float(0.5 * (np.percentile(from_a, 95) + np.percentile(from_b, 95))),
        maximum=float(max(from_a.max(), from_b.max())),
        frechet=min(discrete_frechet(few_a, few_b), discrete_frechet(few_a, few_b[::-1])),
        ends=min(_end_distance(a, b), _end_distance(a, b[::-1])),
    )


def distances_to_polyline(
    points: Float64[np.ndarray, "n d"], polyline: Float64[np.ndarray, "m d"]
) -> Float64[np.ndarray, "n"]:
    """The distance of each point to the polyline: to the two pieces of it that meet in its nearest corner.

    Distances to the corners alone would add half their spacing to errors that are as small as that.
    """
    return np.linalg.norm(points - nearest_on_polyline(points, polyline)[0], axis=1)


def nearest_on_polyline(
    points: Float64[np.ndarray, "n d"], polyline: Float64[np.ndarray, "m d"]
) -> tuple[Float64[np.ndarray, "n d"], Float64[np.ndarray, "n"]]:
    """The place of the polyline that is nearest to each point, and where along it that is, counted in pieces.

    Of all pieces those two are looked at that meet in the nearest corner.
    """
    nearest = np.asarray(KDTree(polyline).query(points)[1])
    if len(polyline) == 1:
        return polyline[nearest], np.zeros(len(points))
    either = [np.clip(nearest - back, 0, len(polyline) - 2) for back in (1, 0)]
    (foot, at, squared), (other, other_at, other_squared) = (_on_piece(points, polyline, piece) for piece in either)
    nearer = squared <= other_squared
    return np.where(nearer[:, None], foot, other), np.where(nearer, at, other_at)


def _on_piece(
    points: Float64[np.ndarray, "n d"], polyline: Float64[np.ndarray, "m d"], piece: Int64[np.ndarray, "n"]
) -> tuple[Float64[np.ndarray, "n d"], Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """The nearest place on one piece for each point, where that is, and its squared distance."""
    start, step = polyline[piece], polyline[piece + 1] - polyline[piece]
    squared = np.einsum("ij,ij->i", step, step)
    share = np.divide(
        np.einsum("ij,ij->i", points - start, step), squared, out=np.zeros(len(points)), where=squared > 0
    )
    share = np.clip(share, 0.0, 1.0)
    foot = start + share[:, None] * step
    off = points - foot
    return foot, piece + share, np.einsum("ij,ij->i", off, off)


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


@dataclass(frozen=True)
class NormalErrors:
    """Where the true curve crosses the plane normal to a predicted one, judged by the covariance predicted there.

    Fields:
        nearest: index of the sample of the true curve that is nearest to each place.
        squared: squared Mahalanobis distance of the crossing, which has two degrees of freedom.
        log_likelihood: logarithm of the predicted density there, per squared unit of length.
    """

    nearest: Int64[np.ndarray, "q"]
    squared: Float64[np.ndarray, "q"]
    log_likelihood: Float64[np.ndarray, "q"]

    @property
    def inside(self) -> Bool[np.ndarray, "q"]:
        """Whether the true curve passes through the predicted 95 % ellipse."""
        return self.squared <= CHI_SQUARE_95


def normal_errors(
    points: Float64[np.ndarray, "q 3"],
    tangents: Float64[np.ndarray, "q 3"],
    covariance: Float64[np.ndarray, "q 3 3"],
    truth: Float64[np.ndarray, "m 3"],
) -> NormalErrors:
    """How the error in the plane normal to the thread compares with the covariance predicted for it.

    Args:
        points: places of the predicted curve, `tangents` its directions there (of any length).
        covariance: predicted at each place.
        truth: the true curve, sampled more densely than the ellipses are wide.
    """
    nearest = np.asarray(KDTree(truth).query(points)[1], dtype=np.int64)
    # the last two right-singular vectors of a direction span the plane normal to it
    plane = np.linalg.svd(tangents[:, None, :])[2][:, 1:]
    offset = np.einsum("qij,qj->qi", plane, truth[nearest] - points)
    spread = np.einsum("qij,qjk,qlk->qil", plane, covariance, plane)
    squared = np.einsum("qi,qi->q", offset, np.linalg.solve(spread, offset[..., None])[..., 0])
    log_area = np.linalg.slogdet(2.0 * np.pi * spread)[1]
    return NormalErrors(nearest, squared, -0.5 * (squared + log_area))


def _end_distance(a: Float64[np.ndarray, "n d"], b: Float64[np.ndarray, "m d"]) -> float:
    return float(0.5 * (np.linalg.norm(a[0] - b[0]) + np.linalg.norm(a[-1] - b[-1])))


def _every(points: Float64[np.ndarray, "n d"], count: int) -> Float64[np.ndarray, "k d"]:
    return points[np.unique(np.linspace(0, len(points) - 1, min(count, len(points))).round().astype(int))]
