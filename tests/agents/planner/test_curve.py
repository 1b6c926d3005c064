"""The thread as it is planned on."""

import dataclasses

import numpy as np
import pytest

from agents.planner.curve import NoGraspError, curve_of, seen, strand_distance


@pytest.fixture
def bent(bench):
    """Most of a circle, with control points crowded at one end, so that parameter and arc length differ."""
    angle = 1.4 * np.pi * np.linspace(0, 1, 12) ** 2
    return bench.thread(np.column_stack((20 * np.cos(angle), 20 * np.sin(angle), np.full(12, 70.0))))


def test_places_are_shares_of_arc_length(bent):
    curve = curve_of(bent)
    chords = np.linalg.norm(np.diff(curve.points(np.linspace(0, 1, 2001)), axis=0), axis=1)
    assert chords.sum() == pytest.approx(curve.length_m, rel=1e-5)
    np.testing.assert_allclose(chords, curve.length_m / 2000, rtol=1e-3)


def test_tangents_are_the_direction_of_travel(bent):
    curve = curve_of(bent)
    s, h = np.linspace(0.01, 0.99, 50), 1e-5
    step = (curve.points(s + h) - curve.points(s - h)) / (2 * h * curve.length_m)
    np.testing.assert_allclose(curve.tangents(s), step, atol=1e-5)


def test_where_the_curve_stops_the_tangent_is_that_of_the_nearest_place_where_it_moves(bench):
    stopping = bench.thread([(-20, 0, 60)] * 4 + [(0, 0, 60), (10, 0, 60), (20, 0, 60)])
    np.testing.assert_allclose(curve_of(stopping).tangents(np.array([0.0, 0.5])), [[1, 0, 0], [1, 0, 0]], atol=1e-9)


def test_hidden_stretches_and_what_is_outside_of_either_image_are_unseen(bench):
    # of 960 columns at 60 mm the left eye sees x from -28.77 to 28.8 mm, the right one 5.5 mm more of the right side
    wide = curve_of(bench.straight((-40, 0, 60), (40, 0, 60), unseen=[(0.5, 0.55)]))
    s = np.array([0.05, 0.17, 0.19, 0.5, 0.501, 0.549, 0.551, 0.85, 0.87])
    x = -40 + 80 * s
    hidden = (s > 0.5) & (s < 0.55)
    expected = (x >= -28.8 + 5.5) & (x <= 28.83) & ~hidden
    np.testing.assert_array_equal(seen(wide, s), expected)
    assert expected.any()
    assert not expected.all()


def test_a_hidden_stretch_is_hidden_whichever_end_is_named_first_and_up_to_the_thread_s_ends(bench):
    s = np.array([0.45, 0.5, 0.56])
    for stretch in ((0.48, 0.55), (0.55, 0.48)):
        np.testing.assert_array_equal(seen(curve_of(bench.straight(unseen=[stretch])), s), [True, False, True])
    ends = curve_of(bench.straight(unseen=[(0.0, 0.2), (0.8, 1.0)]))
    np.testing.assert_array_equal(seen(ends, np.array([0.0, 0.5, 1.0])), [False, True, False])


def test_what_is_behind_the_camera_is_unseen(bench):
    through = curve_of(bench.straight((0, 0, -30), (1, 1, 60)))
    assert not seen(through, np.array([0.0, 0.1, 0.3])).any()


def test_a_straight_or_gently_curved_thread_has_no_other_strand_even_along_the_line_of_sight(bench):
    s, angle = np.linspace(0, 1, 50), np.linspace(0, np.pi, 12)
    half_circle = bench.thread(np.column_stack((4 * np.cos(angle), 4 * np.sin(angle), np.full(12, 70.0))))
    for reconstruction in (bench.straight(), bench.straight((0, 0, 60), (0, 0.1, 90)), half_circle):
        assert np.isinf(strand_distance(curve_of(reconstruction), s, 0.0102)).all()


def test_beside_a_crossing_the_other_strand_is_as_far_as_its_line(bench):
    """A strand along x, a wide loop, and back across it along y: the distance is that along x to the crossing."""
    loop = bench.polyline((-20, 0, 60), (20, 0, 60), (20, 20, 60), (0, 20, 60), (0, -20, 60))
    curve = curve_of(loop)
    length = 40 + 20 + 20 + 40
    x = np.array([-4.0, -2.0, -1.0, 1.0, 3.0])
    found = strand_distance(curve, (x + 20) / length, 0.0102)
    # distances are taken across the viewing ray, which is not quite straight ahead here
    np.testing.assert_allclose(found, np.abs(x) * 1e-3, rtol=0.02, atol=5e-5)


def test_a_strand_far_behind_does_not_count_and_one_at_a_noisy_depth_does(bench):
    def nearest(depth):
        z = 60 + depth
        curve = curve_of(bench.polyline((-20, 0, 60), (20, 0, 60), (20, 20, z), (0, 20, z), (0, -20, z)))
        return strand_distance(curve, np.array([20e-3 / curve.length_m]), 0.0102)[0]

    assert nearest(8.0) < 1e-3
    assert np.isinf(nearest(15.0))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda b: b.failed("two few observations"), "two few observations"),
        (lambda b: b.in_unit(b.straight(), None), "unit"),
        (lambda b: b.in_unit(b.straight((-20000, 0, 60000), (20000, 0, 60000)), 1e-3), "60 m from a camera"),
        (lambda b: b.straight((0, 0, 60), (0.5, 0, 60)), "0.5 mm long"),
        (lambda b: b.straight((0, 0, 60), (0, 0, 60)), "0 mm long"),
        (lambda b: b.straight((1e308, 0, 60), (-1e308, 0, 60)), "check the calibration's unit"),
        (lambda b: b.straight(camera=dataclasses.replace(b.CAMERA, baseline=1e300)), "check the calibration's unit"),
    ],
)
def test_what_is_no_thread_before_an_endoscope_is_named(bench, change, said):
    with pytest.raises(NoGraspError, match=said):
        curve_of(change(bench))
