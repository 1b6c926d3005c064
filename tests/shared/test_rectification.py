"""Known points through a made-up pair of distorted, rotated cameras, and back by triangulation of rectified pixels."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.messages import RectifiedStereo, StereoCalibration
from shared.camera import backproject, camera_matrix, depth_of_disparity, is_rectified, project
from shared.rectification import RectificationError, rectification, rectify_image, rectify_mask

CAMERA = RectifiedStereo(960, 540, 1000.0, 1010.0, 470.0, 280.0, 5.5, 1e-3)
POINTS = st.lists(st.tuples(st.floats(-100, 100), st.floats(-100, 100), st.floats(1, 1000)), max_size=10)
WIDTH, HEIGHT = 320, 240
K = np.array([[330.0, 0, 158.0], [0, 332.0, 122.0], [0, 0, 1]])


@given(points=POINTS.map(lambda rows: np.reshape(rows, (-1, 3))))
def test_points_come_back_from_their_left_pixel_and_depth_and_that_from_the_disparity(points):
    left_px, right_px = project(CAMERA, points)
    assert np.allclose(backproject(CAMERA, left_px, points[:, 2]), points, rtol=1e-9, atol=1e-7)
    assert np.array_equal(left_px[:, 1], right_px[:, 1])
    disparity_px = left_px[:, 0] - right_px[:, 0]
    assert np.allclose(depth_of_disparity(CAMERA, disparity_px), points[:, 2], rtol=1e-9)


def test_projection_is_that_of_opencv_with_the_right_camera_along_x():
    points = np.random.default_rng(0).uniform((-30, -20, 60), (30, 20, 120), (50, 3))
    for eye, pixels in enumerate(project(CAMERA, points)):
        theirs, _ = cv2.projectPoints(points, np.zeros(3), np.array([-5.5 * eye, 0, 0]), camera_matrix(CAMERA), None)
        assert np.allclose(pixels, theirs[:, 0], atol=1e-9)


def to_the_left(*t, turned=(0.0, 0.0, 0.0)):
    """The transform into a right camera for which the left one lies there."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(np.array(turned))[0], t
    return T


RECTIFIED = StereoCalibration(WIDTH, HEIGHT, K, K, np.zeros(0), np.zeros(0), to_the_left(-5.5, 0, 0), 1e-3)


def blob_at(centre_px):
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    grey = 240 * np.exp(-((u - centre_px[0]) ** 2 + (v - centre_px[1]) ** 2) / (2 * 3.0**2))
    return np.rint(grey).astype(np.uint8)


def centre_of(blob):
    v, u = np.mgrid[: blob.shape[0], : blob.shape[1]]
    return np.array([(u * blob.astype(float)).sum(), (v * blob.astype(float)).sum()]) / blob.sum()


def test_points_seen_by_a_distorted_and_turned_pair_are_found_again_in_the_rectified_one():
    K_right = np.array([[335.0, 0, 163.0], [0, 334.0, 117.0], [0, 0, 1]])
    left, T = np.array([-0.12, 0.05, 0.001, -0.0008, 0.01]), to_the_left(-5.5, 0.3, -0.2, turned=(0.02, -0.05, 0.03))
    right = 1.2 * left
    pair = replace(RECTIFIED, K_right=K_right, distortion_left=left, distortion_right=right, T_right_left=T)
    to_rectified = rectification(pair)
    assert to_rectified.camera.baseline == pytest.approx(np.linalg.norm(T[:3, 3]), rel=1e-9)
    points, seen = np.array([[0.0, 0, 80], [-14, 8, 75], [12, -9, 95], [5, 10, 70], [-8, -8, 110]]), []
    eyes = (K, left, np.eye(4), to_rectified.map_left), (K_right, right, T, to_rectified.map_right)
    for of, distortion, into, map_px in eyes:
        # by OpenCV, which is how the calibration defines its cameras
        raw, _ = cv2.projectPoints(points, cv2.Rodrigues(into[:3, :3])[0], into[:3, 3], of, distortion)
        images = [blob_at(pixel) for pixel in raw[:, 0]]
        seen.append(np.array([centre_of(rectify_image(image, map_px)) for image in images]))
        # a mask is resampled as its image is
        np.testing.assert_allclose(centre_of(rectify_mask(images[0], map_px)), seen[-1][0], atol=0.1)
    np.testing.assert_allclose(seen[0][:, 1], seen[1][:, 1], atol=0.1)
    depth = depth_of_disparity(to_rectified.camera, seen[0][:, 0] - seen[1][:, 0])
    # the rectified frame is turned against the raw one: distances, and those from the camera, are what both share
    found, true = (np.vstack((p, [0, 0, 0])) for p in (backproject(to_rectified.camera, seen[0], depth), points))
    apart, truly = (np.linalg.norm(p[:, None] - p, axis=2) for p in (found, true))
    np.testing.assert_allclose(apart, truly, atol=0.7)


def test_images_of_a_rectified_camera_stay_the_very_same_objects_and_each_departure_from_it_is_resampled():
    assert is_rectified(RECTIFIED)
    to_rectified, image = rectification(RECTIFIED), np.zeros((HEIGHT, WIDTH), np.uint8)
    assert rectify_image(image, to_rectified.map_left) is rectify_mask(image, to_rectified.map_right) is image
    assert (to_rectified.camera.fx_px, to_rectified.camera.cx_px, to_rectified.camera.baseline) == (330.0, 158.0, 5.5)
    distortion, K_right = np.array([1e-3, 0, 0, 0]), K + np.eye(3, k=2)
    further_up = {"T_right_left": to_the_left(-5.5, 0.1, 0)}
    for change in ({"distortion_left": distortion}, {"K_right": K_right}, further_up):
        changed = replace(RECTIFIED, **change)
        assert not is_rectified(changed)
        assert rectification(changed).map_left is not None


def test_a_right_camera_that_is_not_to_the_right_is_refused_with_a_remedy():
    for t in ((5.5, 0.0, 0.0), (0.0, -5.5, 0.0), (-1.0, 0.0, 4.0)):
        with pytest.raises(RectificationError, match="right camera to the right of the left one; exchange the cameras"):
            rectification(replace(RECTIFIED, T_right_left=to_the_left(*t)))
