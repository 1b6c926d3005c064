import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.viewer.polyline import CORNERS, cross_sections, thread_polyline, tube_triangles
from shared.splines import evaluate


def sections_of(reconstruction):
    return cross_sections(reconstruction, thread_polyline(reconstruction))


def with_covariance(reconstruction, covariance):
    return dataclasses.replace(
        reconstruction,
        posterior_covariance=np.broadcast_to(covariance, (len(reconstruction.posterior_s), 3, 3)).copy(),
    )


@settings(max_examples=10)
@given(root=arrays(np.float64, (3, 3), elements=st.floats(-2, 2)))
def test_rings_are_the_ellipse_of_95_percent_in_the_plane_across_the_thread(refined, root):
    covariance = root @ root.T + 1e-3 * np.eye(3)
    reconstruction = with_covariance(refined.reconstruction, covariance)
    sections = sections_of(reconstruction)
    curve = reconstruction.knots, reconstruction.control_points_camera, reconstruction.degree
    centres = evaluate(*curve, reconstruction.posterior_s)
    tangents = evaluate(*curve, reconstruction.posterior_s, derivative=1)
    for ring, centre, tangent, deviation in zip(
        sections.rings_camera, centres, tangents, sections.deviation, strict=True
    ):
        _, _, rows = np.linalg.svd(tangent[None])
        across = rows[1:].T
        offset = ring - centre
        assert np.abs(offset @ tangent).max() < 1e-6 * np.linalg.norm(tangent)
        within = across.T @ covariance @ across
        squared = np.einsum("ki,ij,kj->k", offset @ across, np.linalg.inv(within), offset @ across)
        assert np.allclose(squared, -2 * np.log(0.05), rtol=1e-3)
        assert deviation == pytest.approx(np.sqrt(np.linalg.eigvalsh(within)[-1]), rel=1e-6)


def test_neighbouring_rings_begin_on_the_same_side_so_that_the_tube_is_not_twisted(refined):
    sections = sections_of(with_covariance(refined.reconstruction, np.eye(3)))
    centres = sections.rings_camera.mean(axis=1)
    first = sections.rings_camera[:, 0] - centres
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    assert (np.sum(first[1:] * first[:-1], axis=1) > 0.9).all()


def test_places_are_in_order_with_confidence_and_what_is_unseen(refined):
    reversed_order = dataclasses.replace(
        refined.reconstruction,
        posterior_s=refined.reconstruction.posterior_s[::-1].copy(),
        posterior_covariance=refined.reconstruction.posterior_covariance[::-1].copy(),
    )
    straight, turned = sections_of(refined.reconstruction), sections_of(reversed_order)
    assert np.array_equal(straight.rings_camera, turned.rings_camera)
    assert straight.along[0] == 0
    assert straight.along[-1] == 1
    assert straight.along[straight.confidence.argmin()] == pytest.approx(0.62, abs=0.03)
    unseen = straight.along[straight.unseen]
    assert len(unseen) >= 4
    assert unseen == pytest.approx(np.full(len(unseen), 0.61), abs=0.055)
    assert straight.along[straight.deviation.argmax()] == pytest.approx(0.5, abs=0.05)


def test_a_method_that_predicts_nothing_and_a_failure_have_no_sections(scene, failed):
    for reconstruction in (scene.reconstruction, failed):
        sections = sections_of(reconstruction)
        assert len(sections.along) == 0
        assert sections.rings_camera.shape == (0, CORNERS, 3)


@given(covariance=arrays(np.float64, (3, 3), elements=st.floats(-1e300, 1e300)))
def test_any_covariance_that_travels_gives_finite_rings_or_none(refined, covariance):
    sections = sections_of(with_covariance(refined.reconstruction, covariance))
    assert np.isfinite(sections.rings_camera).all()
    assert np.isfinite(sections.deviation).all()


def test_the_triangles_of_a_tube_join_each_ring_to_the_next_without_a_hole():
    triangles = tube_triangles(4)
    assert triangles.min() == 0
    assert triangles.max() == 4 * CORNERS - 1
    assert (np.ptp(triangles // CORNERS, axis=1) == 1).all()
    edges = np.sort(np.concatenate((triangles[:, :2], triangles[:, 1:], triangles[:, ::2])), axis=1)
    used, times = np.unique(edges, axis=0, return_counts=True)
    rim = np.isin(used // CORNERS, (0, 3)).all(axis=1) & (used[:, 0] // CORNERS == used[:, 1] // CORNERS)
    assert (times[~rim] == 2).all()
    assert rim.sum() == 2 * CORNERS
    assert len(tube_triangles(1)) == len(tube_triangles(0)) == 0
