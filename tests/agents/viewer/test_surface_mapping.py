"""Cells with a known depth become points at that depth; the others are not shown."""

import numpy as np
import rerun as rr

from agents.viewer.live_mapping import LiveMapping
from schemas.messages import FrameStamp, RectifiedStereo, TissueSurface


def test_each_valid_cell_is_a_point_in_millimetres():
    camera = RectifiedStereo(640, 360, 600.0, 600.0, 319.5, 179.5, 5e-3, 1.0)
    depth, valid = np.array([[0.09, 0.0], [0.1, 0.11]]), np.array([[True, False], [True, True]])
    surface = TissueSurface(
        FrameStamp(1, 2, 3, ""), camera, np.array([319.5, 379.5]), np.array([179.5, 239.5]), depth, valid
    )
    ((path, (cloud,)),) = LiveMapping().entities(surface)
    assert path == "world/surface"
    assert isinstance(cloud, rr.Points3D)
    assert cloud.positions is not None
    points = np.array(cloud.positions.as_arrow_array().to_pylist())
    np.testing.assert_allclose(points, [[0, 0, 90], [0, 10, 100], [11, 11, 110]], atol=1e-4)
