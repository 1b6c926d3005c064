"""Rotations and rigid transforms as arrays, any number of them at once along the leading axes.

`T_camera_base` is a 4x4 matrix that maps base coordinates to camera coordinates. Inner names meet:
`T_camera_tool = compose(T_camera_base, T_base_tool)`, `points_camera = apply(T_camera_base, points_base)`.

With θ = |ω| and W the cross-product matrix of ω, the exponential of SO(3) is Rodrigues' formula,

    exp(ω) = I + a W + b W²,        a = sin θ / θ,   b = (1 - cos θ) / θ²,

and that of SE(3), for a twist (v, ω), adds the translation V v, where

    V = I + b W + c W²,             c = (θ - sin θ) / θ³,
    V⁻¹ = I - W / 2 + d W²,         d = (1 - a / 2b) / θ²

(Barfoot, State Estimation for Robotics, 2017, section 7.1). a and b are sincs, exact at θ = 0; c and d lose digits
for small θ and follow their power series there. The logarithm goes by way of the unit quaternion
(cos θ/2, sin θ/2 · axis), which is well conditioned everywhere: near θ = π, where R - Rᵀ vanishes, as near 0.
"""

import math

import numpy as np
from jaxtyping import Float64

_SERIES_BELOW = 0.5
"""Angle in radians below which the power series are used; their first neglected term is then under 1e-17."""

_C_SERIES = (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800, -1 / 6227020800)
_D_SERIES = (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600)


def exp_so3(rotation_vector: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """The rotation about a vector by its length in radians."""
    W = _cross_matrix(rotation_vector)
    a, b = _sincs(np.linalg.norm(rotation_vector, axis=-1))
    return np.eye(3) + a * W + b * (W @ W)


def log_so3(R: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3"]:
    """The rotation vector of a rotation: its axis times its angle, which lies within 0 and π.

    A rotation by exactly π has two; either may come back.
    """
    q = quaternion_from_rotation(R)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    half_angle = np.arctan2(sine, q[..., :1])
    return np.where(sine > 0, 2 * half_angle / np.where(sine > 0, sine, 1), 2) * q[..., 1:]


def angle_between(
    R_a: Float64[np.ndarray, "*batch 3 3"], R_b: Float64[np.ndarray, "*batch 3 3"]
) -> Float64[np.ndarray, "*batch"]:
    """The angle of the rotation that leads from each a to each b, 0 to π: that of log_so3 at a tenth of its cost.

    Rotations an angle θ apart differ by a matrix of Frobenius norm 2√2 sin(θ/2).
    """
    with np.errstate(over="ignore"):
        chord = np.sqrt(np.square(R_a - R_b).sum(axis=(-2, -1)))
    return 2 * np.arcsin(np.minimum(chord / math.sqrt(8), 1.0))


def exp_se3(twist: Float64[np.ndarray, "*batch 6"]) -> Float64[np.ndarray, "*batch 4 4"]:
    """The rigid transform of a twist: three components of translation, then three of rotation in radians."""
    v, rotation_vector = twist[..., :3], twist[..., 3:]
    W = _cross_matrix(rotation_vector)
    theta = np.linalg.norm(rotation_vector, axis=-1)
    _, b = _sincs(theta)
    V = np.eye(3) + b * W + _translation_coefficient(theta) * (W @ W)
    return transform(exp_so3(rotation_vector), np.einsum("...ij,...j->...i", V, v))


def log_se3(T: Float64[np.ndarray, "*batch 4 4"]) -> Float64[np.ndarray, "*batch 6"]:
    """The twist of a rigid transform: three components of translation, then three of rotation in radians."""
    rotation_vector = log_so3(T[..., :3, :3])
    W = _cross_matrix(rotation_vector)
    d = _inverse_translation_coefficient(np.linalg.norm(rotation_vector, axis=-1))
    V_inverse = np.eye(3) - W / 2 + d * (W @ W)
    v = np.einsum("...ij,...j->...i", V_inverse, T[..., :3, 3])
    return np.concatenate((v, rotation_vector), axis=-1)


def transform(
    R: Float64[np.ndarray, "*batch 3 3"], t: Float64[np.ndarray, "*batch 3"]
) -> Float64[np.ndarray, "*batch 4 4"]:
    """The rigid transform that rotates by R, then moves by t."""
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = t
    T[..., 3, 3] = 1
    return T


def compose(
    T_a_b: Float64[np.ndarray, "*batch 4 4"], T_b_c: Float64[np.ndarray, "*batch 4 4"]
) -> Float64[np.ndarray, "*batch 4 4"]:
    """`T_a_c`: first from c to b, then from b to a."""
    return T_a_b @ T_b_c


def inverse(T_a_b: Float64[np.ndarray, "*batch 4 4"]) -> Float64[np.ndarray, "*batch 4 4"]:
    """`T_b_a`, the way back."""
    R_b_a = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    return transform(R_b_a, -np.einsum("...ij,...j->...i", R_b_a, T_a_b[..., :3, 3]))


def apply(
    T_a_b: Float64[np.ndarray, "*batch 4 4"], points_b: Float64[np.ndarray, "*batch n 3"]
) -> Float64[np.ndarray, "*batch n 3"]:
    """The points in frame a."""
    return points_b @ np.swapaxes(T_a_b[..., :3, :3], -1, -2) + T_a_b[..., None, :3, 3]


def rotation_from_quaternion(q_wxyz: Float64[np.ndarray, "*batch 4"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """The rotation of a quaternion of any length but zero, scalar part first.

    Raises:
        ValueError: where a quaternion is zero, which is no rotation.
    """
    length = np.linalg.norm(q_wxyz, axis=-1, keepdims=True)
    if not (length > 0).all():
        raise ValueError("a quaternion of length zero is no rotation")
    q = q_wxyz / length
    W = _cross_matrix(q[..., 1:])
    return np.eye(3) + 2 * (q[..., :1, None] * W + W @ W)


def quaternion_from_rotation(R: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 4"]:
    """The unit quaternion of a rotation, scalar part first and not negative.

    R gives the ten products of a quaternion's components; the row with the largest square has the most digits
    (Shepperd, J. Guidance and Control 1, 1978).
    """
    x, y, z = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    products = np.empty((*R.shape[:-2], 4, 4))
    products[..., 0, 0] = 1 + x + y + z
    products[..., 1, 1] = 1 + x - y - z
    products[..., 2, 2] = 1 - x + y - z
    products[..., 3, 3] = 1 - x - y + z
    for i, j, k in ((1, 2, 3), (2, 3, 1), (3, 1, 2)):
        products[..., 0, i] = products[..., i, 0] = R[..., k - 1, j - 1] - R[..., j - 1, k - 1]
        products[..., i, j] = products[..., j, i] = R[..., j - 1, i - 1] + R[..., i - 1, j - 1]
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def nearest_rotation(matrix: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """The rotation with the least squared difference to a matrix (Kabsch: SVD with its reflection undone)."""
    U, _, Vt = np.linalg.svd(matrix)
    signs = np.ones(matrix.shape[:-1])
    signs[..., 2] = np.linalg.det(U @ Vt)
    return (U * signs[..., None, :]) @ Vt


def orthonormality_error(matrix: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch"]:
    """The largest entry of `|R Rᵀ - I|`: 0 for a rotation, and for a reflection too."""
    product = matrix @ np.swapaxes(matrix, -1, -2)
    return np.abs(product - np.eye(3)).max(axis=(-2, -1))


def _cross_matrix(v: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    W = np.zeros((*v.shape, 3))
    W[..., 2, 1], W[..., 0, 2], W[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    return W - np.swapaxes(W, -1, -2)


def _sincs(theta: Float64[np.ndarray, "*batch"]) -> tuple[np.ndarray, np.ndarray]:
    """a and b of the module's derivation, shaped to multiply matrices."""
    theta = np.asarray(theta)[..., None, None]
    return np.sinc(theta / np.pi), np.sinc(theta / (2 * np.pi)) ** 2 / 2


def _translation_coefficient(theta: Float64[np.ndarray, "*batch"]) -> np.ndarray:
    """c of the module's derivation, shaped to multiply matrices."""
    theta = np.asarray(theta)[..., None, None]
    safe = np.maximum(theta, _SERIES_BELOW)
    return np.where(theta < _SERIES_BELOW, _series(_C_SERIES, theta), (safe - np.sin(safe)) / safe**3)


def _inverse_translation_coefficient(theta: Float64[np.ndarray, "*batch"]) -> np.ndarray:
    """d of the module's derivation, shaped to multiply matrices."""
    theta = np.asarray(theta)[..., None, None]
    safe = np.maximum(theta, _SERIES_BELOW)
    closed = (1 - safe / (2 * np.tan(safe / 2))) / safe**2
    return np.where(theta < _SERIES_BELOW, _series(_D_SERIES, theta), closed)


def _series(coefficients: tuple[float, ...], theta: np.ndarray) -> np.ndarray:
    return np.polynomial.polynomial.polyval(theta**2, coefficients)
