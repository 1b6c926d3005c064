"""Kinematics of any arm with six joints from its Denavit-Hartenberg table, by iteration.

Rows are in modified form (Craig), as in psm.py. Near a guess q the pose changes by J dq, with a column for each joint:
its axis z as the angular part, and z × (p - o), o being a point of the axis and p the tool, as the linear one (z and 0
where it slides). Newton's step, damped so that it stays finite where J is singular (Nakamura and Hanafusa, 1986), is

    dq = Jᵀ (J Jᵀ + λ² I)⁻¹ e,      e = (p_wanted - p) / length, log(R_wanted Rᵀ).

All poses of a way take a step at once. They start from poses a few samples apart, each of which starts from the one
ahead of it, so the arm keeps to one of its postures along the way: what does not come to its pose from there is
refused.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float64, Int64

from shared.kinematics.arm import JOINTS, Link, Problem, Solution
from shared.rigid_transforms import log_so3, orthonormality_error

STRIDE = 20
"""Samples of a way between two that are solved one after the other."""
ITERATIONS, DAMPING, CLOSE = 40, 1e-3, 1e-10
STARTS = 16
"""Postures that a pose without one before it is tried from, drawn within the limits, always the same."""
SINGULAR_RATIO = 0.1
"""Of the least to the greatest singular value of J, from where on a pose counts as fully dextrous."""
_TOLERANCE = 1e-9
_ROTATION_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class DhArm:
    """An arm as data.

    Fields:
        rows: six of them, radians, metres and seconds.
        T_last_tool: the tool frame (z along the closed fingers, x the axis about which they open) in the last row's.
        length_m: by which positions are divided to be weighed against angles; the arm's reach, or so.
    """

    rows: tuple[Link, ...]
    T_last_tool: Float64[np.ndarray, "4 4"]
    jaw_limit: tuple[float, float]
    jaw_max_speed: float
    length_m: float

    name: ClassVar[str] = "dh"

    @property
    def limits(self) -> Float64[np.ndarray, "6 2"]:
        """Lower and upper limit of each joint."""
        return np.array([row.limit for row in self.rows])

    @property
    def max_speeds(self) -> Float64[np.ndarray, "6"]:
        """The greatest speed of each joint."""
        return np.array([row.max_speed for row in self.rows])

    def forward(self, joints: Float64[np.ndarray, "*batch 6"]) -> Float64[np.ndarray, "*batch 4 4"]:
        """`T_base_tool`, where these joints bring the tool."""
        return self._frames(joints)[-1]

    def reach(self, T_base_tool: Float64[np.ndarray, "*batch 4 4"]) -> Solution:
        """Joints that bring the tool to each pose, from whichever of a few postures leads there."""
        poses = T_base_tool.reshape(-1, 4, 4)
        joints, problem = np.full((len(poses), JOINTS), np.nan), pose_problem(poses)
        with np.errstate(invalid="ignore"):
            far = np.linalg.norm(poses[:, :3, 3], axis=1) > self._farthest_m()
        near = ~far & (problem == Problem.NONE)
        problem = np.where(far & (problem == Problem.NONE), Problem.WRIST_FOLDED, problem)
        if near.any():
            joints[near], problem[near] = self._reached(poses[near])
        batch = T_base_tool.shape[:-2]
        return Solution(joints.reshape(*batch, JOINTS), problem.reshape(batch))

    def _farthest_m(self) -> float:
        """No joints bring the tool farther from the base than this."""
        slides = [max(abs(row.d + limit) for limit in row.limit) if row.slides else abs(row.d) for row in self.rows]
        links = [float(np.hypot(row.a, d)) for row, d in zip(self.rows, slides, strict=True)]
        return sum(links) + float(np.linalg.norm(self.T_last_tool[:3, 3]))

    def _reached(self, poses: Float64[np.ndarray, "n 4 4"]) -> Solution:
        limits = self.limits
        drawn = limits[:, 0] + np.random.default_rng(0).random((STARTS, JOINTS)) * np.diff(limits, axis=1)[:, 0]
        found = self._solved(poses, np.broadcast_to(drawn[0], (len(poses), JOINTS)).copy())
        for start in drawn[1:]:
            if not (bad := found.problem != Problem.NONE).any():
                break
            again = self._solved(poses[bad], np.broadcast_to(start, (int(bad.sum()), JOINTS)).copy())
            better = again.problem == Problem.NONE
            found.joints[np.flatnonzero(bad)[better]] = again.joints[better]
            found.problem[np.flatnonzero(bad)[better]] = Problem.NONE
        return found

    def follow(self, T_base_tool: Float64[np.ndarray, "n 4 4"], before: Float64[np.ndarray, "6"]) -> Solution:
        """The joints along a way, in the posture that the arm has before it."""
        keys = np.unique(np.append(np.arange(0, len(T_base_tool), STRIDE), len(T_base_tool) - 1))
        ahead, solved = before, list[np.ndarray]()
        for key in keys:
            ahead = self._solved(T_base_tool[key : key + 1], ahead[None].copy()).joints[0]
            solved.append(ahead)
        known = np.stack(solved)
        if not np.isfinite(known).all():
            first = int(keys[np.argmax(~np.isfinite(known).all(axis=1))])
            problem = np.zeros(len(T_base_tool), np.int64)
            problem[first] = self._solved(T_base_tool[first : first + 1], before[None].copy()).problem[0]
            problem[first] = problem[first] or Problem.WRIST_FOLDED
            return Solution(np.full((len(T_base_tool), JOINTS), np.nan), problem)
        samples = np.arange(len(T_base_tool))
        guess = np.column_stack([np.interp(samples, keys, known[:, joint]) for joint in range(JOINTS)])
        return self._solved(T_base_tool, guess)

    def problems(self, joints: Float64[np.ndarray, "*batch 6"]) -> Int64[np.ndarray, "*batch"]:
        """The first Problem of each set of joints: not finite, or outside a limit."""
        limits = self.limits
        outside = (joints < limits[:, 0] - _TOLERANCE) | (joints > limits[:, 1] + _TOLERANCE)
        limit = np.where(outside.any(axis=-1), Problem.YAW + np.argmax(outside, axis=-1), Problem.NONE)
        return np.where(np.isfinite(joints).all(axis=-1), limit, Problem.NOT_FINITE)

    def explain(self, problem: Problem, joints: Float64[np.ndarray, "6"]) -> str:
        """A problem of these joints in a sentence."""
        if problem >= Problem.YAW:
            row = self.rows[problem - Problem.YAW]
            at = f"{joints[problem - Problem.YAW]:.4g} {'m' if row.slides else 'rad'}"
            return f"joint {problem - Problem.YAW + 1} would be at {at}, outside {row.limit[0]} to {row.limit[1]}"
        return {
            Problem.NOT_FINITE: "a number of it is not finite",
            Problem.NO_ROTATION: "it is no rigid transform",
        }.get(problem, "the arm does not come there from where it is before")

    def dexterity(self, joints: Float64[np.ndarray, "*batch 6"]) -> Float64[np.ndarray, "*batch"]:
        """The least singular value of J as a share of the greatest, and of SINGULAR_RATIO; 1 at most."""
        values = np.linalg.svd(self._jacobian(self._frames(joints)), compute_uv=False)
        return np.minimum(values[..., -1] / values[..., 0] / SINGULAR_RATIO, 1.0)

    def _frames(self, joints: Float64[np.ndarray, "*batch 6"]) -> list[Float64[np.ndarray, "*batch 4 4"]]:
        """The frame of each link in the base, and the tool's as the last."""
        before, frames = np.eye(4), list[np.ndarray]()
        for index, row in enumerate(self.rows):
            value = joints[..., index]
            theta = row.theta + (0.0 if row.slides else 1.0) * value
            d = row.d + (1.0 if row.slides else 0.0) * value
            c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(row.alpha), np.sin(row.alpha)
            link = np.zeros((*value.shape, 4, 4))
            link[..., 0, 0], link[..., 0, 1], link[..., 0, 3] = c, -s, row.a
            link[..., 1, 0], link[..., 1, 1], link[..., 1, 2], link[..., 1, 3] = s * ca, c * ca, -sa, -d * sa
            link[..., 2, 0], link[..., 2, 1], link[..., 2, 2], link[..., 2, 3] = s * sa, c * sa, ca, d * ca
            link[..., 3, 3] = 1
            before = before @ link
            frames.append(before)
        return [*frames, before @ self.T_last_tool]

    def _jacobian(self, frames: list[Float64[np.ndarray, "*batch 4 4"]]) -> Float64[np.ndarray, "*batch 6 6"]:
        """How position, divided by the length, and orientation of the tool change with each joint."""
        p, columns = frames[-1][..., :3, 3], list[np.ndarray]()
        for row, T in zip(self.rows, frames, strict=False):
            z = T[..., :3, 2]
            linear = z if row.slides else np.cross(z, p - T[..., :3, 3])
            columns.append(np.concatenate((linear / self.length_m, 0.0 * z if row.slides else z), axis=-1))
        return np.stack(columns, axis=-1)

    def _solved(self, T_wanted: Float64[np.ndarray, "n 4 4"], joints: Float64[np.ndarray, "n 6"]) -> Solution:
        """Newton's steps from a guess for each pose; NaN where they lead nowhere."""
        pose = pose_problem(T_wanted)
        wanted = np.where((pose == Problem.NONE)[:, None, None], T_wanted, np.eye(4))
        error = np.full((len(wanted), JOINTS), np.inf)
        joints = np.where(np.isfinite(joints), joints, 0.0)
        for _ in range(ITERATIONS):
            frames = self._frames(joints)
            R = frames[-1][:, :3, :3]
            turn = log_so3(wanted[:, :3, :3] @ np.swapaxes(R, -1, -2))
            error = np.concatenate(((wanted[:, :3, 3] - frames[-1][:, :3, 3]) / self.length_m, turn), axis=1)
            if np.abs(error).max() < CLOSE:
                break
            J = self._jacobian(frames)
            # the damping fades as the pose comes near, so that the last steps are Newton's own
            damped = J @ np.swapaxes(J, -1, -2) + (DAMPING * np.square(error).sum(axis=1))[:, None, None] * np.eye(6)
            damped = damped + 1e-12 * np.eye(6)
            step = np.einsum("nji,nj->ni", J, np.linalg.solve(damped, error[..., None])[..., 0])
            joints = joints + np.clip(step, -0.5, 0.5)
        lost = np.abs(error).max(axis=1) > 1e3 * CLOSE
        problem = np.where(lost, Problem.WRIST_FOLDED, self.problems(joints))
        joints[lost | (pose != Problem.NONE)] = np.nan
        return Solution(joints, np.where(pose == Problem.NONE, problem, pose))


def pose_problem(T: Float64[np.ndarray, "n 4 4"]) -> Int64[np.ndarray, "n"]:
    """What speaks against each pose for whatever arm."""
    finite = np.isfinite(T).all(axis=(-2, -1))
    R = np.where(np.reshape(finite, (-1, 1, 1)), T, np.eye(4))[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        rotates = (orthonormality_error(R) < _ROTATION_TOLERANCE) & (np.linalg.det(R) > 0)
    return np.where(finite, np.where(rotates, Problem.NONE, Problem.NO_ROTATION), Problem.NOT_FINITE)
