"""The correction of a tool's place: six numbers for what registration and joints are wrong by, with their covariance.

The lumped error (Richter, Lu, Orosco, Yip: Robotic tool tracking under partially visible kinematic chain, T-RO 2021) is
one rigid motion C of the camera's frame, with which the tool is at C · T_camera_base · T_base_tool. About a pivot c,
which stays with a track, C = trans(c) exp(v, ω) trans(-c), so that v is where the tool is wrong, nearly whatever ω is.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from shared.rigid_transforms import exp_se3, log_se3

WRIST_M = 0.0002
"""How far (one deviation, each axis) fingers are from where one rigid motion of all the tool has them: a wrist whose
joints are right to 0.6 degrees, 9 to 19 mm before the tip."""


@dataclass(frozen=True, eq=False)
class Correction:
    """Mean and covariance of (v, ω), metres and radians, and the pivot in the camera's frame."""

    twist: Float64[np.ndarray, "6"]
    covariance: Float64[np.ndarray, "6 6"]
    pivot: Float64[np.ndarray, "3"]

    @property
    def matrix(self) -> Float64[np.ndarray, "4 4"]:
        """C, to be multiplied from the left onto T_camera_base."""
        return about(self.pivot, self.twist)

    def point_covariance(self, point_camera: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
        """Of a corrected point of the fingers there, which the wrist's own joints move too."""
        J = point_slope(point_camera[None], self.pivot)[0]
        return J @ self.covariance @ J.T + WRIST_M**2 * np.eye(3)

    def spread(self, elapsed_s: float, walk: Float64[np.ndarray, "6"]) -> "Correction":
        """The same so much later, having walked by so much a root of a second."""
        return Correction(self.twist, self.covariance + elapsed_s * np.diag(walk**2), self.pivot)


def about(pivot: Float64[np.ndarray, "3"], twist: Float64[np.ndarray, "*n 6"]) -> Float64[np.ndarray, "*n 4 4"]:
    """trans(c) exp(twist) trans(-c)."""
    T = exp_se3(twist)
    T[..., :3, 3] += pivot - T[..., :3, :3] @ pivot
    return T


def twist_about(pivot: Float64[np.ndarray, "3"], C: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "6"]:
    """The twist of which `about` makes C."""
    T = C.copy()
    T[:3, 3] += C[:3, :3] @ pivot - pivot
    return log_se3(T)


def point_slope(points: Float64[np.ndarray, "n 3"], pivot: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "n 3 6"]:
    """How points move with a further twist from the left: v + ω x (p - c)."""
    x, y, z = (points - pivot).T
    J = np.zeros((len(points), 3, 6))
    J[:, (0, 1, 2), (0, 1, 2)] = 1.0
    J[:, 0, 4], J[:, 0, 5], J[:, 1, 3] = z, -y, -z
    J[:, 1, 5], J[:, 2, 3], J[:, 2, 4] = x, y, -x
    return J
