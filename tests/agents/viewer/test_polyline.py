import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.viewer.polyline import along_at, thread_polyline


@given(data=st.data(), degree=st.integers(1, 5))
def test_any_message_is_a_curve_before_the_camera_or_none(scene, data, degree):
    m = data.draw(st.integers(degree + 1, degree + 4))
    inner = data.draw(
        st.lists(st.floats(1e-300, 1 - 1e-9), min_size=m - degree - 1, max_size=m - degree - 1, unique=True)
    )
    knots = np.concatenate((np.zeros(degree + 1), np.sort(inner), np.ones(degree + 1)))
    control = data.draw(arrays(np.float64, (m, 3), elements=st.floats(-1e300, 1e300)))
    odd = dataclasses.replace(scene.reconstruction, degree=degree, knots=knots, control_points_camera=control)
    thread = thread_polyline(odd, 20)
    if thread is not None:
        assert np.isfinite(thread.points_camera).all()
        assert (thread.points_camera[:, 2] > 0).all()


def test_points_lie_evenly_on_the_whole_curve_which_is_as_long_as_it_is(scene):
    thread = thread_polyline(scene.reconstruction, 101)
    assert thread is not None
    steps = np.linalg.norm(np.diff(thread.points_camera, axis=0), axis=1)
    assert np.ptp(steps) < 0.01 * steps.mean()
    nearest = np.linalg.norm(thread.points_camera[:, None] - scene.curve[None], axis=2).min(axis=1)
    assert nearest.max() < 0.1
    assert np.linalg.norm(thread.points_camera[[0, -1]] - scene.curve[[0, -1]], axis=1).max() < 0.1
    assert thread.length == pytest.approx(scene.length, rel=1e-3)
    # the scene's thread was fitted by its length
    assert np.allclose(along_at(thread, np.linspace(0, 1, 11)), np.linspace(0, 1, 11), atol=0.01)
    assert np.flatnonzero(thread.unseen).tolist() == list(range(56, 67))


def test_confidence_follows_arc_length_whatever_the_order_of_its_samples(scene):
    backwards = dataclasses.replace(
        scene.reconstruction,
        confidence_s=scene.reconstruction.confidence_s[::-1].copy(),
        confidence=scene.reconstruction.confidence[::-1].copy(),
    )
    for reconstruction in (scene.reconstruction, backwards):
        thread = thread_polyline(reconstruction)
        assert thread is not None
        assert thread.along[thread.confidence.argmin()] == pytest.approx(0.62, abs=0.01)


def test_a_failure_a_curve_behind_the_camera_and_one_without_length_are_not_drawn(scene, failed):
    behind = scene.reconstruction.control_points_camera - [0, 0, 95.0]
    point = np.ones_like(behind)
    for control in (behind, point):
        assert thread_polyline(dataclasses.replace(scene.reconstruction, control_points_camera=control)) is None
    assert thread_polyline(failed) is None
