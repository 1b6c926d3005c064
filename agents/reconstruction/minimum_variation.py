"""The minimum-variation spline through all reliability regions (paper, sections II-D and II-E).

For fixed parameters s_j the spline's control points P solve a quadratic program,

    min ½ ∫‖B'''‖² = ½ PᵀAP    so that    C_j P + f_j ≤ 0  for every region j,

A from the third difference of the control points (eq. 13) and C_j, f_j the six faces of region j (eq. 4, 5), each
divided by its bound so that one unit means "the region's own size". Five times the program is solved and the
parameters follow the arc length of its curve (eq. 17).

Regions can contradict each other. So each gets a slack t_j ≥ 0, C_j P + f_j ≤ t_j, at the price ρ t_j. No slack is
used where the regions allow a curve and the multipliers of no region add up to more than ρ; otherwise the sum of all
slack is at most J / ρ above the least possible one, J being the cost of the smoothest curve that reaches it. The
slack is part of the result.

Lengths are scaled to the size of the thread about its centre, and parameters to one knot span, before anything is
solved. docs/reconstruction.md has the derivations.
"""

from dataclasses import dataclass

import numpy as np
import piqp
import scipy.sparse
from jaxtyping import Float64

from schemas.messages import RectifiedStereo
from shared.arc_length import length, lengths_until
from shared.camera import project
from shared.splines import basis_matrix, clamped_uniform_knots, difference_matrix

CONTROL_POINTS = 20
DEGREE = 3
ROUNDS = 5
SLACK_PRICE = 1e3
"""Per unit of slack, where a smooth curve costs 0.01 to 1. A price that is higher by orders of magnitude buys the last
hundredths of a region's size with curves that fold."""
NEGLIGIBLE_SLACK = 1e-6
LARGEST_GROWTH = 1.1
"""Of the curve's length from one round to the next; more is divergence."""
MOST_ITERATIONS = 100
"""Of the solver, which takes about 20: this bounds the time of a round."""


class UnsolvedError(RuntimeError):
    """The quadratic program has no solution that the solver can vouch for; the text says what it reported."""


@dataclass(frozen=True)
class Regions:
    """Where the curve must pass, in the unit of the points; see ReliabilityRegions for the fields."""

    centre_camera: Float64[np.ndarray, "n 3"]
    bound_px: Float64[np.ndarray, "n 2"]
    bound_depth: Float64[np.ndarray, "n"]


@dataclass(frozen=True)
class Faces:
    """Linear inequalities `normal[i] · B(s_j) + offset[i] ≤ 0` of all regions, six to a region.

    Fields:
        normal: (n, 6, 3), in units of the region's own bounds per unit of length.
        offset: (n, 6).
    """

    normal: Float64[np.ndarray, "n 6 3"]
    offset: Float64[np.ndarray, "n 6"]


@dataclass(frozen=True)
class MinimumVariationSpline:
    """The curve, the parameters at which it was held to the regions, and how far regions had to give way."""

    knots: Float64[np.ndarray, "k"]
    control_points_camera: Float64[np.ndarray, "m 3"]
    s: Float64[np.ndarray, "n"]
    slack: Float64[np.ndarray, "n"]


def minimum_variation_spline(
    regions: Regions, camera: RectifiedStereo, s_start: Float64[np.ndarray, "n"]
) -> MinimumVariationSpline:
    """The smoothest spline through all regions, at nearly constant speed.

    The rounds end early where they diverge: a curve that overshoots between two regions takes parameter length from
    its neighbours, which then overshoot in the next round. The round before is the result.

    Args:
        regions: in order along the thread.
        camera: that the regions' image bounds belong to.
        s_start: parameters of the regions to begin with, not decreasing, from 0 to 1.

    Raises:
        UnsolvedError: where the first round has no solution, or all observations are at one place.
    """
    centre = regions.centre_camera.mean(axis=0)
    size = float(np.linalg.norm(regions.centre_camera - centre, axis=1).max())
    if not size > 0:
        raise UnsolvedError("all observations are at one place")
    faces = region_faces(regions, camera, centre, size)
    knots = clamped_uniform_knots(CONTROL_POINTS, DEGREE)
    s = s_start
    scaled, slack = solve(knots, faces, s)
    for _ in range(ROUNDS - 1):
        next_s = constant_speed_parameters(knots, scaled, s)
        try:
            next_scaled, next_slack = solve(knots, faces, next_s)
        except UnsolvedError:
            break
        longer = length(knots, next_scaled, DEGREE) > LARGEST_GROWTH * length(knots, scaled, DEGREE)
        if longer or next_slack.sum() > slack.sum() + NEGLIGIBLE_SLACK:
            break
        s, scaled, slack = next_s, next_scaled, next_slack
    return MinimumVariationSpline(knots, centre + size * scaled, s, slack)


def chord_parameters(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n"]:
    """Parameters in [0, 1] in proportion to the length of the chords between ordered points; even where all agree."""
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    return along / along[-1] if along[-1] > 0 else np.linspace(0.0, 1.0, len(points))


def constant_speed_parameters(
    knots: Float64[np.ndarray, "k"], control_points: Float64[np.ndarray, "m 3"], s: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n"]:
    """The share of the curve's length that lies before each s (eq. 17); s itself for a curve without length."""
    lengths = lengths_until(knots, control_points, DEGREE, np.append(s, 1.0))
    return lengths[:-1] / lengths[-1] if 0 < lengths[-1] < np.inf else s


def region_faces(regions: Regions, camera: RectifiedStereo, centre: Float64[np.ndarray, "3"], size: float) -> Faces:
    """The faces of all regions for a curve b with B = centre + size · b.

    Upper image bound in u (eq. 5): fx X + cx Z ≤ (p_u + ε_u) Z, divided by ε_u o_z; the others likewise.
    """
    o = regions.centre_camera
    p, _ = project(camera, o)
    n = len(o)
    normal = np.zeros((n, 6, 3))
    constant = np.zeros((n, 6))
    sign = np.array([1.0, -1.0])
    for axis, (focal, principal) in enumerate(((camera.fx_px, camera.cx_px), (camera.fy_px, camera.cy_px))):
        faces = slice(2 * axis, 2 * axis + 2)
        bound = regions.bound_px[:, axis, None]
        unit = bound * o[:, 2, None]
        normal[:, faces, axis] = sign * focal / unit
        normal[:, faces, 2] = (sign * (principal - p[:, axis, None]) - bound) / unit
    normal[:, 4:, 2] = sign / regions.bound_depth[:, None]
    constant[:, 4:] = -sign * (o[:, 2] / regions.bound_depth)[:, None] - 1.0
    return Faces(normal * size, constant + normal @ centre)


def solve(
    knots: Float64[np.ndarray, "k"], faces: Faces, s: Float64[np.ndarray, "n"], price: float = SLACK_PRICE
) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, "n"]]:
    """Control points of the smoothest curve through all regions at s, and the slack of each region.

    The form with slack is solved even where none is needed: it takes a few iterations more, while the solver needs
    hundreds to give up on a form that has no solution.

    Raises:
        UnsolvedError: where the solver has not converged.
    """
    n, variables = len(s), 3 * (len(knots) - DEGREE - 1)
    objective = scipy.sparse.block_diag((variation_matrix(knots), scipy.sparse.csc_matrix((n, n))))
    C = inequality_matrix(basis_matrix(knots, DEGREE, s), faces)
    give = scipy.sparse.kron(scipy.sparse.eye(n), -np.ones((6, 1)))
    solver = piqp.SparseSolver()
    solver.settings.max_iter = MOST_ITERATIONS
    solver.setup(
        scipy.sparse.csc_matrix(objective),
        np.concatenate((np.zeros(variables), np.full(n, price))),
        None,
        None,
        scipy.sparse.csc_matrix(scipy.sparse.hstack((C, give))),
        None,
        -faces.offset.ravel(),
        np.concatenate((np.full(variables, -np.inf), np.zeros(n))),
        None,
    )
    status = solver.solve()
    if status != piqp.PIQP_SOLVED:
        reported = status.name.removeprefix("PIQP_").lower().replace("_", " ")
        raise UnsolvedError(f"no curve was found, the observations may contradict each other (solver: {reported})")
    x = np.array(solver.result.x)
    slack = x[variables:]
    return x[:variables].reshape(-1, 3), np.where(slack > NEGLIGIBLE_SLACK, slack, 0.0)


def variation_matrix(knots: Float64[np.ndarray, "k"]) -> scipy.sparse.csc_matrix:
    """A of eq. 13 for interleaved coordinates (3m, 3m), with knot spans of length 1 instead of 1 / (m − 3).

    That keeps its entries near 1, and is the same objective: ∫‖B'''‖² ds is (m − 3)⁵ times as large.
    """
    spans = len(knots) - 2 * DEGREE - 1
    third = difference_matrix(knots, DEGREE, 3) / spans**3
    return scipy.sparse.csc_matrix(scipy.sparse.kron(third.T @ third, scipy.sparse.eye(3)))


def inequality_matrix(basis: Float64[np.ndarray, "n m"], faces: Faces) -> scipy.sparse.csc_matrix:
    """C of all regions for interleaved control points: (6n, 3m)."""
    n, m = basis.shape
    rows, columns = np.nonzero(basis)
    blocks = basis[rows, columns, None, None] * faces.normal[rows]
    row_index = np.broadcast_to(6 * rows[:, None, None] + np.arange(6)[:, None], blocks.shape)
    column_index = np.broadcast_to(3 * columns[:, None, None] + np.arange(3), blocks.shape)
    return scipy.sparse.csc_matrix((blocks.ravel(), (row_index.ravel(), column_index.ravel())), shape=(6 * n, 3 * m))
