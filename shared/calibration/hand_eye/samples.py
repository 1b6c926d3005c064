"""What a hand-eye calibration is estimated from: places of a point on the tool as the camera saw them, and the robot's
poses meanwhile, each with times of its own clock.

A place is two pixels of a rectified pair, or a point before the camera. Lengths are metres.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo


@dataclass(frozen=True, eq=False)
class Sightings:
    """What the camera saw of one point of the tool.

    Fields:
        seen: of n moments, (u, v) in the left and (u, v) in the right image; or (x, y, z) in the camera's frame.
        camera: in metres, that the pixels are of; None where points were seen.
    """

    time_s: Float64[np.ndarray, "n"]
    seen: Float64[np.ndarray, "n d"]
    camera: RectifiedStereo | None

    @property
    def points_camera(self) -> Float64[np.ndarray, "n 3"]:
        """Where each was; of pixels by the disparity, the rows' mean giving y."""
        if self.camera is None:
            return self.seen
        u_left, v_left, u_right, v_right = self.seen.T
        camera = self.camera
        z = camera.fx_px * camera.baseline / np.maximum(u_left - u_right, 1e-3)
        x = (u_left - camera.cx_px) * z / camera.fx_px
        return np.column_stack((x, (0.5 * (v_left + v_right) - camera.cy_px) * z / camera.fy_px, z))

    def predicted(self, points_camera: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n d"]:
        """What the camera would see of points: as `seen`."""
        camera = self.camera
        if camera is None:
            return points_camera
        x, y, z = points_camera.T
        z = np.maximum(z, 1e-3)
        u, v = camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px
        return np.column_stack((u, v, u - camera.fx_px * camera.baseline / z, v))

    def only(self, kept: np.ndarray) -> "Sightings":
        """Some of them."""
        return Sightings(self.time_s[kept], self.seen[kept], self.camera)


@dataclass(frozen=True, eq=False)
class Motion:
    """The tool's poses in the base's frame, their times increasing."""

    time_s: Float64[np.ndarray, "m"]
    T_base_tool: Float64[np.ndarray, "m 4 4"]

    def at(self, time_s: Float64[np.ndarray, "n"], point_tool: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "n 3"]:
        """Where a point of the tool was in the base's frame, between two poses on the straight line."""
        points = self.T_base_tool[:, :3, :3] @ point_tool + self.T_base_tool[:, :3, 3]
        return np.column_stack([np.interp(time_s, self.time_s, axis) for axis in points.T])
