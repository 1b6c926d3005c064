"""Published states become images: true to the state, the same for the same frame, and quick while nothing moves."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from agents.camera.scene_source import SceneSource, calibration_of, camera_in_mm
from schemas.messages import RectifiedStereo, SimulatorState
from shared.camera import project
from shared.scene.render import Scene, SceneError, render
from shared.scene.sensor import NO_NOISE
from shared.scene.surface import flat_surface
from shared.scene.thread_shapes import thread_on
from shared.splines import evaluate

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5e-3, 1.0)
THREAD_MM = thread_on(camera_in_mm(CAMERA), flat_surface(95.0), "medium", 2)
STATE = SimulatorState(
    at_ns=1,
    camera=CAMERA,
    background="plain",
    colour="violet",
    seed=2,
    distance_m=0.095,
    radius_m=1e-3 * THREAD_MM.radius_mm,
    knots=THREAD_MM.knots,
    control_points_camera=1e-3 * THREAD_MM.control_points,
    held=None,
)


SMALL = replace(STATE, camera=RectifiedStereo(240, 135, 250.0, 250.0, 119.5, 67.0, 5.5e-3, 1.0))
"""The same view in a quarter of the pixels each way."""


def moved(state: SimulatorState, by_mm: tuple[float, float, float]) -> SimulatorState:
    return replace(state, control_points_camera=state.control_points_camera + 1e-3 * np.array(by_mm))


def test_without_noise_it_is_the_light_renderers_pair():
    pair = SceneSource(NO_NOISE).render(STATE, 0)
    expected = render(Scene(camera_in_mm(CAMERA), THREAD_MM, "violet", "plain", 95.0, 2, NO_NOISE))
    for ours, theirs in ((pair.left_bgr, expected.left_bgr), (pair.right_bgr, expected.right_bgr)):
        # metres and back again may round a grey level
        assert np.abs(ours.astype(int) - theirs).max() <= 1


def test_the_thread_is_where_the_state_says_in_both_images():
    state = moved(STATE, (1.0, -0.5, -4.0))
    pair = SceneSource(NO_NOISE).render(state, 0)
    truth = evaluate(state.knots, state.control_points_camera, 3, np.linspace(0, 1, 20000))
    for image, line in zip((pair.left_bgr, pair.right_bgr), project(state.camera, truth), strict=True):
        darkness = 206.0 - image.astype(float).mean(axis=2)
        v, u = np.nonzero(darkness)
        pixels = np.column_stack((u, v)).astype(float)
        _, nearest = cKDTree(line).query(pixels)
        tangent = np.gradient(line, axis=0)
        normal = np.column_stack((-tangent[:, 1], tangent[:, 0])) / np.linalg.norm(tangent, axis=1)[:, None]
        across = ((pixels - line[nearest]) * normal[nearest]).sum(axis=1)
        inner = (nearest > 50) & (nearest < 19950)
        assert abs(np.average(across[inner], weights=darkness[v, u][inner])) < 0.03


def test_a_frame_depends_on_state_and_number_alone():
    other = moved(SMALL, (0.0, 0.0, -2.0))
    straight = SceneSource().render(SMALL, 7)
    source = SceneSource()
    for state, frame in ((other, 3), (SMALL, 6), (replace(SMALL, seed=5), 7), (other, 7)):
        source.render(state, frame)
    again = source.render(replace(SMALL, at_ns=99), 7)
    assert (again.left_bgr == straight.left_bgr).all()
    assert (again.right_bgr == straight.right_bgr).all()


def test_noise_is_new_in_every_frame_and_in_each_eye():
    source = SceneSource()
    plain = moved(SMALL, (500.0, 0.0, 0.0))
    images = [image.astype(float) for k in range(4) for image in vars(source.render(plain, k)).values()]
    flat = np.stack([(image - image.mean()).ravel() for image in images])
    correlation = np.corrcoef(flat)
    assert np.abs(correlation - np.eye(len(images))).max() < 0.02
    assert flat.std() == pytest.approx(np.sqrt(1.4**2 + 2.2**2 * 206 / 255 + 1 / 12), rel=0.03)


def test_the_calibration_belongs_to_the_images():
    calibration = calibration_of(CAMERA)
    assert (calibration.image_width, calibration.image_height) == (960, 540)
    points = np.array([[0.01, -0.02, 0.1], [-0.03, 0.01, 0.08]])
    _, right = project(CAMERA, points)
    seen, _ = cv2.projectPoints(
        points, np.zeros(3), calibration.T_right_left[:3, 3], calibration.K_right, calibration.distortion_right
    )
    assert np.asarray(seen)[:, 0] == pytest.approx(right)
    assert calibration.metres_per_unit == 1.0


def test_what_cannot_be_drawn_is_named_with_what_can():
    with pytest.raises(SceneError, match="violet, black, blue"):
        SceneSource().render(replace(STATE, colour="pink"), 0)
    with pytest.raises(SceneError, match="tissue, plain"):
        SceneSource().render(replace(STATE, background="paper"), 0)
    with pytest.raises(SceneError, match="metres_per_unit"):
        camera_in_mm(replace(CAMERA, metres_per_unit=None))
