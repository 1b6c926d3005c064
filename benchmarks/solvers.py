"""How long PIQP and OSQP take for the quadratic programs of method `paper`, and how well they solve them.

The program is the last one that the method solved: smallest variation and slack, inside the regions. Each solver gets
the same matrices with empty memory, at its own default tolerances; OSQP also at the tolerance that its answers need.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import osqp
import piqp
import scipy.sparse

from agents.reconstruction.minimum_variation import (
    DEGREE,
    SLACK_PRICE,
    Regions,
    inequality_matrix,
    region_faces,
    variation_matrix,
)
from agents.reconstruction.paper import reconstruct_paper
from schemas.messages import Status, ThreadObservations
from shared.clock import Stopwatch
from shared.splines import basis_matrix

TIGHT = 1e-6
MOST_ITERATIONS = 20_000
REPEATS = 3
"""Of which the fastest counts: other programs interrupt."""

Program = tuple[scipy.sparse.csc_matrix, np.ndarray, scipy.sparse.csc_matrix, np.ndarray, np.ndarray]
"""H, c, G, upper, least of: min ½ xᵀHx + cᵀx so that G x ≤ upper and x ≥ least."""


def solver_times(observations: ThreadObservations) -> dict[str, Any] | None:
    """Milliseconds and violation of each solver on the program of these observations, None where there is none."""
    result = reconstruct_paper(observations)
    if result.status is not Status.OK:
        return None
    regions = result.regions
    centre = regions.centre_camera.mean(axis=0)
    size = float(np.linalg.norm(regions.centre_camera - centre, axis=1).max())
    bounds = Regions(regions.centre_camera, regions.bound_px, regions.bound_depth)
    faces = region_faces(bounds, observations.camera, centre, size)
    n, m = len(regions.s), len(result.control_points_camera)
    H = scipy.sparse.block_diag((variation_matrix(result.knots), scipy.sparse.csc_matrix((n, n))))
    C = inequality_matrix(basis_matrix(result.knots, DEGREE, regions.s), faces)
    give = scipy.sparse.kron(scipy.sparse.eye(n), -np.ones((6, 1)))
    program = (
        scipy.sparse.csc_matrix(H),
        np.concatenate((np.zeros(3 * m), np.full(n, SLACK_PRICE))),
        scipy.sparse.csc_matrix(scipy.sparse.hstack((C, give))),
        -faces.offset.ravel(),
        np.concatenate((np.full(3 * m, -np.inf), np.zeros(n))),
    )
    return {
        "piqp": _judged(program, by_piqp),
        "osqp": _judged(program, by_osqp),
        f"osqp {TIGHT:g}": _judged(program, lambda program: by_osqp(program, TIGHT)),
    }


def by_piqp(program: Program) -> np.ndarray:
    """The solution by PIQP."""
    H, c, G, upper, least = program
    solver = piqp.SparseSolver()
    solver.setup(H, c, None, None, G, None, upper, least, None)
    solver.solve()
    return np.array(solver.result.x)


def by_osqp(program: Program, tolerance: float | None = None) -> np.ndarray:
    """The solution by OSQP, at its default tolerances where none is given."""
    H, c, G, upper, least = program
    bounded = np.isfinite(least)
    A = scipy.sparse.csc_matrix(scipy.sparse.vstack((G, scipy.sparse.eye(len(c), format="csr")[bounded])))
    low = np.concatenate((np.full(len(upper), -np.inf), least[bounded]))
    high = np.concatenate((upper, np.full(int(bounded.sum()), np.inf)))
    options = {} if tolerance is None else {"eps_abs": tolerance, "eps_rel": tolerance, "max_iter": MOST_ITERATIONS}
    solver = osqp.OSQP()
    solver.setup(scipy.sparse.triu(H, format="csc"), c, A, low, high, verbose=False, **options)
    return np.asarray(solver.solve(raise_error=False).x)


def _judged(program: Program, solve: Callable[[Program], np.ndarray]) -> dict[str, float]:
    H, c, G, upper, least = program
    fastest, x = np.inf, np.zeros(len(c))
    for _ in range(REPEATS):
        watch = Stopwatch("solve")
        with watch.step("solve"):
            x = solve(program)
        fastest = min(fastest, watch.ms["solve"])
    violation = max(float((G @ x - upper).max()), float((least - x).max()))
    return {"ms": fastest, "violation": violation, "cost": float(0.5 * x @ H @ x + c @ x)}
