"""How far the thread at the goal moved, the way the tool did, between two reconstructions.

Reconstructions of two frames may differ as a whole: tissue breathes, and calibration or matching can be wrong by the
same everywhere. So the displacement common to thread that is too far away to have been lifted is found first, by
nearest points in a few rounds with weights that fall off for what does not fit, and is taken off. What counts then is
where the later curve passes through the plane across the thread at the goal, along the part r of the viewing ray across
the thread, which stereo sees least of, and beside it, along q, as the image shows it:

    m = (r, q)ᵀ (x − b − t),   C = f (r, q)ᵀ (Σ_before + Σ_after + Σ_t) (r, q),

with b the goal before, t the common displacement, and x the passage that is nearest to the way from b to b + d, d being
the tool's motion. Much of what a reconstruction may be wrong by is
the same in both and falls out of their difference. How much, the thread that lies still tells: f is the mean square of
what is left of its displacement over what both covariances allow for, one more independent piece taken to be as wrong
as they say, and at most 1.

The instrument mostly hides the jaws, so no thread may be found at the goal. Then what counts is the nearest place that
is seen, a farther along the thread: what is held at the goal takes it along by a share of the way, 1 − κ a give or take
ν a. What something hides is a guess, and no place that is seen.

Limp thread that nothing holds is dragged along as a whole. So t may be the tool's doing (`check`).
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float64

from agents.planner.curve import unit_vectors
from agents.planner.poses import approach_directions
from schemas.messages import ThreadAround

FAR_M, ENOUGH_FAR = 0.02, 6
"""Thread at least so far along it from the goal lies still while a few millimetres are lifted."""
ROUNDS, FITS_M = 12, 0.0015
COMMON_M, UNSEEN_COMMON_M = 0.01, 0.001
"""Deviations of the common displacement: before it is looked for, and where nothing is far enough to tell it."""
TOGETHER_M = 0.006
"""Errors of one reconstruction go together so far along the thread."""
LEAST_M = 0.0002
"""No two reconstructions are compared more finely: thread shifts a little wherever it is pulled at."""
END_M, BENDS = 0.006, (0.3, 0.15)
"""An end that was lifted may be seen so much too short, and how far it goes off straight on, for each metre on, in
depth and in the image."""
BESIDE_M, DEEP_M = 0.006, 0.015
"""A passage farther from the way of the tool, in the image or in depth, is another part of the thread, or none."""
ELSEWHERE_M = 0.012
"""What passes farther away is another strand: reconstructions are hardly wrong by more."""
NEAR_M, FADES_PER_M, UNSURE_PER_M = 0.015, 26.0, 18.0
"""How far from the goal thread still tells of it, κ, and ν: 15 mm on, stiff thread follows by nearly all of the way,
and limp thread by a quarter."""


@dataclass(frozen=True)
class Motion:
    """How far thread and tool moved across the thread, in metres.

    Fields:
        tool, thread: along the viewing ray, and beside it in the image.
        covariance: of `thread`, from both reconstructions.
        axes: both directions, unit vectors in the camera frame.
        beside_m: how far along the thread from the goal that is.
        tool_moved: in the camera frame.
        common, common_covariance: by how much the thread as a whole moved besides, and how well that is told.
    """

    tool: Float64[np.ndarray, "2"]
    thread: Float64[np.ndarray, "2"]
    covariance: Float64[np.ndarray, "2 2"]
    axes: Float64[np.ndarray, "2 3"]
    beside_m: float = 0.0
    tool_moved: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    common: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    common_covariance: Float64[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))

    @property
    def follows(self) -> Float64[np.ndarray, "2"]:
        """How far thread moves there that is held at the goal."""
        return (1.0 - FADES_PER_M * self.beside_m) * self.tool

    @property
    def follows_covariance(self) -> Float64[np.ndarray, "2 2"]:
        """Of that."""
        return (UNSURE_PER_M * self.beside_m) ** 2 * np.outer(self.tool, self.tool)

    @property
    def tool_m(self) -> float:
        """How far the tool moved."""
        return float(np.linalg.norm(self.tool))

    @property
    def thread_m(self) -> float:
        """How far the thread moved the same way."""
        return float(self.thread @ self._way)

    @property
    def deviation_m(self) -> float:
        """The standard deviation of that."""
        return float(np.sqrt(max(self._way @ self.covariance @ self._way, 0.0)))

    @property
    def _way(self) -> Float64[np.ndarray, "2"]:
        return self.tool / max(self.tool_m, 1e-9)


@dataclass(frozen=True)
class Elsewhere:
    """Thread that passes the goal, but so far from the way of the tool: what it was taken to be was wrong by that."""

    off_m: float


@dataclass(frozen=True)
class Still:
    """What thread tells that lies still.

    Fields:
        common: its displacement, with its covariance.
        repeated: by how much variances are too large for what is left of it.
    """

    common: Float64[np.ndarray, "3"]
    covariance: Float64[np.ndarray, "3 3"]
    repeated: float


def axes_across(
    tangent: Float64[np.ndarray, "3"], point_camera: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "2 3"]:
    """Unit vectors across a thread at a point: the part of the viewing ray that is, and the one beside it."""
    deep = approach_directions(point_camera[None], tangent[None])[0][0]
    return np.stack((deep, np.cross(tangent, deep)))


def motion(
    before: ThreadAround,
    goal: int,
    after: ThreadAround,
    tool_moved: Float64[np.ndarray, "3"],
    seen: Bool[np.ndarray, "n"],
) -> Motion | Elsewhere | None:
    """What became of a sample of the thread; None where the later reconstruction has nothing there or near it.

    Args:
        before, after: both with samples as dense as thread bends, in metres and the camera frame.
        seen: which samples of the later one are seen.
    """
    tangents = unit_vectors(np.gradient(before.points_camera, axis=0))
    arc = _arc(before.points_camera)
    still = _common(before, arc, goal, tangents, after)
    # what hides the thread hides how it bends to the jaws: what is guessed there tells nothing
    at_goal = np.concatenate(([True], seen[:-1] & seen[1:], [True]))
    found = _passage(before, goal, tangents[goal], after, tool_moved, still, at_goal)
    if found is not None:
        return found
    # ends go no farther than they are seen there
    between = np.concatenate(([False], at_goal[1:-1], [False]))
    away = np.abs(arc - arc[goal])
    for place in np.argsort(away, kind="stable")[1 : np.count_nonzero(away <= NEAR_M)]:
        found = _passage(before, int(place), tangents[place], after, tool_moved, still, between)
        if isinstance(found, Motion):
            return replace(found, beside_m=float(away[place]))
    return None


def _passage(
    before: ThreadAround,
    place: int,
    tangent: Float64[np.ndarray, "3"],
    after: ThreadAround,
    tool_moved: Float64[np.ndarray, "3"],
    still: Still,
    between: Bool[np.ndarray, "n_and_1"],
) -> Motion | Elsewhere | None:
    """Where the later curve passes through the plane across the thread at a sample, on those of its pieces."""
    point = before.points_camera[place]
    axes = axes_across(tangent, point)
    tool = axes @ tool_moved
    offset = _longer(after.points_camera) - point - still.common
    ahead = offset @ tangent
    passes = np.flatnonzero(((ahead[:-1] <= 0) != (ahead[1:] <= 0)) & between)
    if not len(passes):
        return None
    share = ahead[passes] / (ahead[passes] - ahead[passes + 1])
    at = (offset[passes] + share[:, None] * (offset[passes + 1] - offset[passes])) @ axes.T
    # in units of how far off either may be
    scale = np.array([DEEP_M, BESIDE_M])
    along = np.clip((at @ tool) / max(tool @ tool, 1e-12), 0.0, 1.0)
    astray = at - along[:, None] * tool
    off = np.linalg.norm(astray / scale, axis=1)
    nearest = int(np.argmin(off))
    if off[nearest] > 1.0:
        off_m = float(np.linalg.norm(astray[nearest]))
        return Elsewhere(off_m) if off_m <= ELSEWHERE_M else None
    seen = int(np.clip(passes[nearest] - 1, 0, len(after.s) - 1))
    covariance = still.repeated * (before.covariance[place] + after.covariance[seen] + still.covariance)
    on_m = {0: 1.0 - share[nearest], len(after.s): share[nearest]}.get(int(passes[nearest]), 0.0) * END_M
    return Motion(
        tool,
        at[nearest],
        axes @ covariance @ axes.T + np.diag(np.square(BENDS) * on_m**2),
        axes,
        tool_moved=tool_moved,
        common=still.common,
        common_covariance=still.covariance,
    )


def _longer(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n_and_2 3"]:
    """With both ends straight on."""
    on = points[[0, -1]] + END_M * unit_vectors(points[[0, -1]] - points[[1, -2]])
    return np.concatenate((on[:1], points, on[1:]))


def _arc(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n"]:
    """How far along a polyline its corners are."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))


def _common(
    before: ThreadAround,
    arc: Float64[np.ndarray, "n"],
    goal: int,
    tangents: Float64[np.ndarray, "n 3"],
    after: ThreadAround,
) -> Still:
    points = before.points_camera
    far = np.flatnonzero(np.abs(arc - arc[goal]) >= FAR_M)
    if len(far) < ENOUGH_FAR:
        return Still(np.zeros(3), UNSEEN_COMMON_M**2 * np.eye(3), 1.0)
    spacing_m = arc[-1] / max(len(arc) - 1, 1)
    normal = np.eye(3) - tangents[far, :, None] * tangents[far, None, :]
    common, prior = np.zeros(3), np.eye(3) / COMMON_M**2
    information, squares = prior, np.ones(len(far))
    for _ in range(ROUNDS):
        offset = after.points_camera[None] - (points[far] + common)[:, None]
        nearest = np.argmin((offset**2).sum(axis=2), axis=1)
        left = np.einsum("nij,nj->ni", normal, offset[np.arange(len(far)), nearest])
        scale = (FITS_M**2) * np.eye(3)
        allowed = before.covariance[far] + after.covariance[nearest]
        # across the thread there are two directions
        squares = 0.5 * np.einsum("ni,nij,nj->n", left, np.linalg.inv(allowed + LEAST_M**2 * np.eye(3)), left)
        weight = np.linalg.inv(allowed + scale)
        weight = normal @ weight @ normal * (1.0 / (1.0 + (left**2).sum(axis=1) / FITS_M**2))[:, None, None]
        information = weight.sum(axis=0) + prior
        common = common + np.linalg.solve(information, np.einsum("nij,nj->i", weight, left) - prior @ common)
    together = max(TOGETHER_M / max(spacing_m, 1e-6), 1.0)
    pieces = len(far) / together
    repeated = min((float(squares.mean()) * pieces + 1.0) / (pieces + 1.0), 1.0)
    return Still(common, np.linalg.inv(information / together + prior), repeated)
