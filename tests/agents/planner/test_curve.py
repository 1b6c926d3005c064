"""The thread as it is planned on: how long, where it is seen, how near strands lie, and what is none."""

import dataclasses

import numpy as np
import pytest

from agents.planner.curve import NoGraspError, curve_of, seen, strand_distance
from tests.agents.planner import bench


def test_places_are_shares_of_arc_length_and_tangents_the_direction_of_travel():
    """Most of a circle, with control points crowded at one end, so that parameter and arc length differ."""
    angle = 1.4 * np.pi * np.linspace(0, 1, 12) ** 2
    curve = curve_of(bench.thread(np.column_stack((20 * np.cos(angle), 20 * np.sin(angle), np.full(12, 70.0)))))
    chords = np.diff(curve.points(np.linspace(0, 1, 2001)), axis=0)
    lengths = np.linalg.norm(chords, axis=1)
    assert lengths.sum() == pytest.approx(curve.length_m, rel=1e-5)
    np.testing.assert_allclose(lengths, curve.length_m / 2000, rtol=1e-3)
    np.testing.assert_allclose(curve.tangents(np.linspace(0, 1, 2001))[:-1], chords / lengths[:, None], atol=5e-3)
    stopping = bench.thread([(-20, 0, 60)] * 4 + [(0, 0, 60), (10, 0, 60), (20, 0, 60)])
    np.testing.assert_allclose(curve_of(stopping).tangents(np.array([0.0, 0.5])), [[1, 0, 0], [1, 0, 0]], atol=1e-9)


def test_hidden_stretches_and_what_is_outside_of_either_image_or_behind_the_camera_are_unseen():
    # of 960 columns at 60 mm the left eye sees x from -28.77 to 28.8 mm, the right one 5.5 mm more of the right side
    wide = bench.straight((-40, 0, 60), (40, 0, 60), unseen=[(0.5, 0.55)])
    turned, ends = bench.straight(unseen=[(0.55, 0.48)]), bench.straight(unseen=[(0.0, 0.2), (0.8, 1.0)])
    for thread, places, expected in (
        (wide, (0.05, 0.17, 0.19, 0.5, 0.501, 0.549, 0.551, 0.85, 0.87), (0, 0, 0, 1, 0, 0, 1, 1, 0)),
        (wide, (0.2, 0.22), (0, 1)),
        (turned, (0.45, 0.5, 0.56), (1, 0, 1)),
        (ends, (0.0, 0.5, 1.0), (0, 1, 0)),
        (bench.straight((0, 0, -30), (1, 1, 60)), (0.0, 0.1, 0.3), (0, 0, 0)),
    ):
        np.testing.assert_array_equal(seen(curve_of(thread), np.array(places)), np.array(expected, bool))


def test_beside_a_crossing_the_other_strand_is_as_far_as_its_line_unless_it_lies_far_behind():
    """A strand along x, a wide loop, and back across it along y: the distance is that along x to the crossing."""
    x = np.array([-4.0, -2.0, -1.0, 1.0, 3.0])

    def distances_m(deeper_mm):
        z = 60 + deeper_mm
        curve = curve_of(bench.polyline((-20, 0, 60), (20, 0, 60), (20, 20, z), (0, 20, z), (0, -20, z)))
        return strand_distance(curve, 1e-3 * (x + 20) / curve.length_m, 0.0102)

    # distances are taken across the viewing ray, which is not quite straight ahead here
    np.testing.assert_allclose(distances_m(0.0), np.abs(x) * 1e-3, rtol=0.02, atol=5e-5)
    assert distances_m(8.0)[2] < 2e-3, "depth is noisy"
    assert np.isinf(distances_m(15.0)).all()
    # neither a straight thread, even along the line of sight, nor one that bends gently has another strand
    angle = np.linspace(0, np.pi, 12)
    half_circle = bench.thread(np.column_stack((4 * np.cos(angle), 4 * np.sin(angle), np.full(12, 70.0))))
    for thread in (bench.straight(), bench.straight((0, 0, 60), (0, 0.1, 90)), half_circle):
        assert np.isinf(strand_distance(curve_of(thread), np.linspace(0, 1, 50), 0.0102)).all()


@pytest.mark.parametrize(
    ("thread", "said"),
    [
        (bench.failed("two few observations"), "two few observations"),
        (bench.in_unit(bench.straight(), None), "metres_per_unit"),
        (bench.in_unit(bench.straight((-20000, 0, 60000), (20000, 0, 60000)), 1e-3), "60 m from a camera"),
        (bench.straight((0, 0, 60), (0.5, 0, 60)), "0.5 mm long"),
        (bench.straight((0, 0, 60), (0, 0, 60)), "0 mm long"),
        (bench.straight((1e308, 0, 60), (-1e308, 0, 60)), "check the calibration's unit"),
        (bench.straight(camera=dataclasses.replace(bench.CAMERA, baseline=1e300)), "check the calibration's unit"),
    ],
)
def test_what_is_no_thread_before_an_endoscope_is_named(thread, said):
    with pytest.raises(NoGraspError, match=said):
        curve_of(thread)
