"""Known points through a made-up pair of distorted, rotated cameras, and back by triangulation of rectified pixels."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from schemas.messages import StereoCalibration
from shared.camera import backproject, depth_of_disparity, is_rectified
from shared.rectification import (
    RectificationError,
    rectification,
    rectify_image,
    rectify_mask,
)

WIDTH, HEIGHT = 320, 240


def calibration_of(R_right_left, t_right_left, distorted=True) -> StereoCalibration:
    T_right_left = np.eye(4)
    T_right_left[:3, :3], T_right_left[:3, 3] = R_right_left, t_right_left
    distortion = np.array([-0.12, 0.05, 0.001, -0.0008, 0.01]) if distorted else np.zeros(0)
    return StereoCalibration(
        image_width=WIDTH,
        image_height=HEIGHT,
        K_left=np.array([[330.0, 0, 158.0], [0, 332.0, 122.0], [0, 0, 1]]),
        K_right=np.array([[335.0, 0, 163.0], [0, 334.0, 117.0], [0, 0, 1]]),
        distortion_left=distortion,
        distortion_right=1.2 * distortion,
        T_right_left=T_right_left,
        metres_per_unit=1e-3,
    )


def turned() -> StereoCalibration:
    R, _ = cv2.Rodrigues(np.array([0.02, -0.05, 0.03]))
    return calibration_of(R, [-5.5, 0.3, -0.2])


def already_rectified() -> StereoCalibration:
    K = np.array([[330.0, 0, 158.0], [0, 332.0, 122.0], [0, 0, 1]])
    return replace(calibration_of(np.eye(3), [-5.5, 0, 0], distorted=False), K_left=K, K_right=K)


def raw_pixels(points, calibration, eye):
    """Projection by OpenCV, which is how the calibration defines its cameras."""
    K, distortion = getattr(calibration, f"K_{eye}"), getattr(calibration, f"distortion_{eye}")
    T = calibration.T_right_left if eye == "right" else np.eye(4)
    rotation, _ = cv2.Rodrigues(T[:3, :3].copy())
    return cv2.projectPoints(points, rotation, T[:3, 3].copy(), np.array(K), np.array(distortion))[0].reshape(-1, 2)


def image_of_blob(centre_px):
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    grey = 240 * np.exp(-((u - centre_px[0]) ** 2 + (v - centre_px[1]) ** 2) / (2 * 3.0**2))
    return np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=2)


def centre_of_blob(image):
    grey = image[..., 0].astype(float)
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(u * grey).sum(), (v * grey).sum()]) / grey.sum()


def test_points_seen_by_a_distorted_and_turned_pair_are_found_again_in_the_rectified_one():
    calibration = turned()
    to_rectified = rectification(calibration)
    baseline = np.linalg.norm(calibration.T_right_left[:3, 3])
    assert to_rectified.camera.baseline == pytest.approx(baseline, rel=1e-9)
    points = np.array([[0.0, 0, 80], [-14, 8, 75], [12, -9, 95], [5, 10, 70], [-8, -8, 110]])
    seen = {}
    for eye, map_px in (("left", to_rectified.map_left), ("right", to_rectified.map_right)):
        raw = raw_pixels(points, calibration, eye)
        seen[eye] = np.array([centre_of_blob(rectify_image(image_of_blob(p), map_px)) for p in raw])
        # a mask is resampled as its image is
        assert map_px is not None
        mask = rectify_mask(image_of_blob(raw[0])[..., 0], map_px)
        np.testing.assert_allclose(centre_of_blob(mask[..., None]), seen[eye][0], atol=0.1)
    np.testing.assert_allclose(seen["left"][:, 1], seen["right"][:, 1], atol=0.1)

    disparity = seen["left"][:, 0] - seen["right"][:, 0]
    found = backproject(to_rectified.camera, seen["left"], depth_of_disparity(to_rectified.camera, disparity))
    # the rectified frame is turned against the raw one: distances between points are what both share
    np.testing.assert_allclose(
        np.linalg.norm(found[:, None] - found, axis=2), np.linalg.norm(points[:, None] - points, axis=2), atol=0.7
    )
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.linalg.norm(points, axis=1), atol=0.5)


def test_images_of_a_rectified_camera_stay_the_very_same_objects():
    to_rectified = rectification(already_rectified())
    image, mask = np.zeros((HEIGHT, WIDTH, 3), np.uint8), np.zeros((HEIGHT, WIDTH), np.uint8)
    assert rectify_image(image, to_rectified.map_left) is image
    assert rectify_mask(mask, to_rectified.map_right) is mask
    assert (to_rectified.camera.fx_px, to_rectified.camera.cx_px, to_rectified.camera.baseline) == (330.0, 158.0, 5.5)


@pytest.mark.parametrize(
    "change",
    [
        {"distortion_left": np.array([1e-3, 0, 0, 0])},
        {"K_right": np.array([[330.0, 0, 159.0], [0, 332.0, 122.0], [0, 0, 1]])},
        {"T_right_left": np.array([[1.0, 0, 0, -5.5], [0, 1, 0, 0.1], [0, 0, 1, 0], [0, 0, 0, 1]])},
    ],
    ids=["distortion", "another right camera", "a camera further up"],
)
def test_each_departure_from_a_rectified_camera_is_resampled(change):
    assert is_rectified(already_rectified())
    changed = replace(already_rectified(), **change)
    assert not is_rectified(changed)
    assert rectification(changed).map_left is not None


def test_a_right_camera_that_is_not_to_the_right_is_refused_with_a_remedy():
    for t in ((5.5, 0.0, 0.0), (0.0, -5.5, 0.0), (-1.0, 0.0, 4.0)):
        with pytest.raises(RectificationError, match="right camera to the right of the left one; exchange the cameras"):
            rectification(calibration_of(np.eye(3), t))
