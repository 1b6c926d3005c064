import dataclasses

import numpy as np
import pytest

from agents.viewer.entity import camera_in_mm, observations_in_mm, reconstruction_in_mm
from schemas import topics


def test_a_session_in_metres_becomes_the_same_one_in_millimetres(session_messages, scene):
    observations = observations_in_mm(session_messages[topics.OBSERVATIONS])
    reconstruction = reconstruction_in_mm(session_messages[topics.THREAD])
    assert observations.camera.baseline == pytest.approx(5.5)
    assert reconstruction.camera.metres_per_unit == 1e-3
    assert np.allclose(observations.points_camera, scene.observations.points_camera)
    assert np.allclose(reconstruction.control_points_camera, scene.reconstruction.control_points_camera)
    assert np.allclose(reconstruction.regions.centre_camera, scene.reconstruction.regions.centre_camera)
    assert np.allclose(reconstruction.regions.bound_depth, scene.reconstruction.regions.bound_depth)
    assert np.array_equal(reconstruction.regions.bound_px, scene.reconstruction.regions.bound_px)


def test_millimetres_and_what_is_in_an_unknown_unit_stay_as_they_are(scene):
    assert observations_in_mm(scene.observations) is scene.observations
    assert reconstruction_in_mm(scene.reconstruction) is scene.reconstruction
    unknown = dataclasses.replace(scene.reconstruction.camera, metres_per_unit=None)
    assert camera_in_mm(unknown) == unknown
    reconstruction = dataclasses.replace(scene.reconstruction, camera=unknown)
    assert reconstruction_in_mm(reconstruction) is reconstruction


def test_covariances_go_with_the_square(scene):
    inches = dataclasses.replace(scene.reconstruction.camera, metres_per_unit=0.0254)
    predicted = dataclasses.replace(
        scene.reconstruction, camera=inches, posterior_s=np.array([0.5]), posterior_covariance=np.eye(3)[None]
    )
    assert np.allclose(reconstruction_in_mm(predicted).posterior_covariance, 25.4**2 * np.eye(3))
