import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.messages import RectifiedStereo
from shared.camera import backproject, camera_matrix, depth_of_disparity, project

CAMERAS = st.builds(
    RectifiedStereo,
    image_width=st.integers(16, 4000),
    image_height=st.integers(16, 4000),
    fx_px=st.floats(100, 5000),
    fy_px=st.floats(100, 5000),
    cx_px=st.floats(-500, 4500),
    cy_px=st.floats(-500, 4500),
    baseline=st.floats(1e-4, 100),
    metres_per_unit=st.none(),
)
POINTS = st.lists(st.tuples(st.floats(-100, 100), st.floats(-100, 100), st.floats(1, 1000)), min_size=1, max_size=10)


@given(camera=CAMERAS, points=POINTS.map(np.array))
def test_points_come_back_from_their_left_pixel_and_depth_and_that_from_the_disparity(camera, points):
    left_px, right_px = project(camera, points)
    assert np.allclose(backproject(camera, left_px, points[:, 2]), points, rtol=1e-9, atol=1e-7)
    assert np.array_equal(left_px[:, 1], right_px[:, 1])
    disparity_px = camera.fx_px * camera.baseline / points[:, 2]
    assert np.allclose(left_px[:, 0] - right_px[:, 0], disparity_px, rtol=1e-9, atol=1e-7)
    assert np.allclose(depth_of_disparity(camera, disparity_px), points[:, 2], rtol=1e-12)


@pytest.mark.parametrize("eye", [0, 1])
def test_projection_is_that_of_opencv_with_the_right_camera_along_x(eye):
    camera = RectifiedStereo(960, 540, 1000.0, 1010.0, 470.0, 280.0, 5.5, 1e-3)
    points = np.random.default_rng(0).uniform((-30, -20, 60), (30, 20, 120), (50, 3))
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.array([-5.5 * eye, 0, 0]), camera_matrix(camera), None)
    assert np.allclose(project(camera, points)[eye], theirs[:, 0], atol=1e-9)


def test_no_points_project_to_no_pixels():
    camera = RectifiedStereo(960, 540, 1000.0, 1010.0, 470.0, 280.0, 5.5, 1e-3)
    left_px, right_px = project(camera, np.zeros((0, 3)))
    assert left_px.shape == right_px.shape == (0, 2)
    assert backproject(camera, left_px, np.zeros(0)).shape == (0, 3)
