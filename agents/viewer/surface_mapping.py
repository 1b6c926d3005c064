"""The tissue around the thread as Rerun shows it: world/surface, a cloud of points in millimetres."""

import numpy as np
import rerun as rr

from agents.viewer import colours
from agents.viewer.mapping import FAINT, Entity
from agents.viewer.units import camera_in_mm
from schemas.messages import TissueSurface
from shared.camera import backproject


def surface_entities(surface: TissueSurface) -> list[Entity]:
    """A point for each cell whose depth is known."""
    v, u = np.nonzero(surface.valid)
    pixel = np.column_stack((surface.u_px[u], surface.v_px[v]))
    camera = camera_in_mm(surface.camera)
    # of the same camera, in another unit
    depth = surface.depth[v, u] * (camera.baseline / surface.camera.baseline)
    points = backproject(camera, pixel, depth)
    return [("world/surface", [rr.Points3D(points, colors=[(*colours.TEXT[:3], FAINT)], radii=[-1.5])])]
