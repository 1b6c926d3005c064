"""What the last frame says of the next: its posterior with process noise, a quadratic function of the control points.

Between frames a thread moves by a displacement u that is common to all of it (camera, hand) and one that changes along
it (bending). Both are taken as normal, so that control point i moves by u_i with

    E u_i u_jᵀ = (c² + d² k(|i − j|) + e² δ_ij) I,      k(r) = (1 + √3 r / l) exp(−√3 r / l)   (Matérn, 3/2),

and the prediction is normal with covariance Σ + Q, Σ being the last posterior's. What depends on one place of a curve
depends on four control points, so of Σ + Q only the blocks within four neighbours are kept, and the prior is the normal
distribution of greatest entropy that has them: with C_k the block of the control points k to k + 3, and S_k that of
k + 1 to k + 3, its precision is Σ_k C_k⁻¹ − Σ_k S_k⁻¹ (Lauritzen 1996, decomposable models; exact for those blocks).
It has the form of all other terms, and costs as little.

Thread does not stretch: at the middle of each span, ‖B'‖ is the known length but for a small share. What is hidden has
its length from this, and an end that is hidden its place.
"""

import numpy as np
from jaxtyping import Float64, Int64

from agents.reconstruction.refined.cubic import DEGREE, basis_at, kept
from agents.reconstruction.refined.normal_equations import SIDE, Blocks
from agents.reconstruction.refined.projection import Curve
from schemas.messages import RectifiedStereo

COMMON_SHARE, BENDING_SHARE, LOCAL_SHARE = 0.012, 0.003, 0.00003
"""Of the image's width, at the thread's depth: c, d and e of one thirtieth of a second."""
BENDING_REACH = 0.25
"""Of the thread: l."""
STRETCH = 0.03
"""Standard deviation of the length of one span, as a share of it."""
FRAME_S = 1.0 / 30.0

Band = Float64[np.ndarray, "m 4 3 3"]
Precision = Float64[np.ndarray, "spans 12 12"]


def band_of(covariance: Float64[np.ndarray, "spans 12 12"]) -> Band:
    """The blocks [i, j] of the control points i and i + j, from those of the control points of each span."""
    spans = len(covariance)
    blocks = covariance.reshape(spans, DEGREE + 1, 3, DEGREE + 1, 3)
    band = np.zeros((spans + DEGREE, DEGREE + 1, 3, 3))
    band[:spans] = blocks[:, 0].transpose(0, 2, 1, 3)
    for i in range(1, DEGREE + 1):
        band[spans + i - 1, : DEGREE + 1 - i] = blocks[-1, i, :, i:].transpose(1, 0, 2)
    return band


def process_noise(curve: Curve, camera: RectifiedStereo, elapsed_s: float) -> Float64[np.ndarray, "4"]:
    """Q for control points that lie 0 to 3 apart, the same in each direction."""
    unit = camera.image_width * float(np.median(curve.control_points[:, 2])) / camera.fx_px
    r = np.sqrt(3.0) * np.arange(DEGREE + 1) / (BENDING_REACH * curve.spans)
    one = (COMMON_SHARE * unit) ** 2 + (BENDING_SHARE * unit) ** 2 * (1.0 + r) * np.exp(-r)
    one[0] += (LOCAL_SHARE * unit) ** 2
    return one * max(elapsed_s / FRAME_S, 1.0)


def prior(band: Band, noise: Float64[np.ndarray, "4"]) -> Precision:
    """The precision of the prediction, in blocks of one knot span each.

    Raises:
        numpy.linalg.LinAlgError: where the covariance is none.
    """
    apart = np.abs(np.subtract.outer(np.arange(4), np.arange(4)))
    cliques = _cliques(band) + np.einsum("ij,ab->iajb", noise[apart], np.eye(3)).reshape(SIDE, SIDE)
    # each block but the last is the first control point's conditional on the other three
    first, both, rest = cliques[:-1, :3, :3], cliques[:-1, :3, 3:], cliques[:-1, 3:, 3:]
    follows = np.linalg.solve(rest, both.transpose(0, 2, 1))
    apart_from = np.concatenate((np.tile(np.eye(3), (len(follows), 1, 1)), -follows.transpose(0, 2, 1)), axis=2)
    precision = np.empty_like(cliques)
    precision[:-1] = apart_from.transpose(0, 2, 1) @ np.linalg.inv(first - both @ follows) @ apart_from
    precision[-1] = np.linalg.inv(cliques[-1])
    return 0.5 * (precision + precision.transpose(0, 2, 1))


def away_from(precision: Precision, curve: Curve, predicted: Curve) -> Blocks:
    """The prior as a function of the motion from `curve`."""
    away = curve.near - predicted.near
    return Blocks(precision, (precision @ away.reshape(-1, SIDE, 1))[:, :, 0])


def stretching(curve: Curve, length: float) -> Blocks:
    """½ Σ_k ((‖B'(s_k)‖ − length) / deviation)² about `curve`, s_k the middles of its spans."""
    slope = _middle_slopes(curve.spans)
    velocity = (slope[:, None] @ curve.near)[:, 0]
    speed = np.maximum(np.sqrt(np.einsum("ka,ka->k", velocity, velocity)), 1e-12)
    design = (slope[:, :, None] * (velocity / speed[:, None])[:, None, :]).reshape(curve.spans, SIDE) / (
        STRETCH * length
    )
    residual = (speed / length - 1.0) / STRETCH
    return Blocks(design[:, :, None] * design[:, None, :], design * residual[:, None])


@kept
def _middle_slopes(spans: int) -> Float64[np.ndarray, "spans 4"]:
    """The derivatives of the basis functions in the middle of each span."""
    return basis_at(spans, (np.arange(spans) + 0.5) / spans)[2]


def _cliques(band: Band) -> Float64[np.ndarray, "spans 12 12"]:
    return band.ravel().take(_clique_index(len(band) - DEGREE))


@kept
def _clique_index(spans: int) -> Int64[np.ndarray, "spans 12 12"]:
    """Where each number of each block lies in the band, of which the lower half is left out."""
    number = np.arange((spans + DEGREE) * (DEGREE + 1) * 9).reshape(-1, DEGREE + 1, 3, 3)
    k = np.arange(spans)
    blocks = np.empty((spans, 4, 3, 4, 3), np.int64)
    for a in range(4):
        for b in range(a, 4):
            blocks[:, a, :, b, :] = number[k + a, b - a]
            blocks[:, b, :, a, :] = number[k + a, b - a].transpose(0, 2, 1)
    return blocks.reshape(spans, SIDE, SIDE)
