"""A glint takes a few pixels out of a thread: both sides of it are one piece, and what is beside is not."""

import dataclasses

import numpy as np
import pytest

from agents.reconstruction.refined.joined import LONGEST_WIDTHS, joined
from agents.reconstruction.refined.method import course_of
from shared.disparities import disparities

WIDTH = 3.0


def straight(start, end):
    return np.linspace(start, end, 200)


def flat_end(t):
    """Round a half turn, then along the rows, nearer to the camera and away again; in millimetres."""
    turn, along = np.minimum(t / 0.4, 1.0), np.maximum(t - 0.4, 0.0) / 0.6
    angle = np.pi * (0.5 + turn)
    return np.column_stack((-8 + 9 * np.cos(angle) + 34 * along, -9 * np.sin(angle), 95 - 4 * np.sin(np.pi * along)))


def test_a_strand_with_a_short_gap_is_one_piece(make_lines):
    lines = make_lines(straight((10, 50), (100, 52)), straight((108, 52.2), (200, 54)), width=WIDTH)
    assert (joined(lines).piece == 0).all()


@pytest.mark.parametrize("turned", [(False, False), (True, False), (False, True), (True, True)])
def test_the_points_of_joined_pieces_follow_each_other_whichever_way_they_were_passed(make_lines, turned):
    parts = straight((10, 50), (100, 52)), straight((108, 52.2), (200, 54)), straight((207, 54.1), (300, 56))
    pieces = [part[:: -1 if back else 1] for part, back in zip(parts, (*turned, False), strict=True)]
    lines = make_lines(pieces[1], pieces[2], pieces[0], width=WIDTH)
    numbered = dataclasses.replace(lines, deviation_px=np.linspace(0.1, 0.2, len(lines.piece)))
    found = joined(numbered)
    step = np.linalg.norm(np.diff(found.point_px, axis=0), axis=1)
    assert (found.piece == 0).all()
    assert step.max() < 9
    assert len(np.unique(np.sign(np.diff(found.point_px[:, 0])))) == 1
    # each point keeps what is known of it
    was = {
        tuple(point): float(deviation) for point, deviation in zip(lines.point_px, numbered.deviation_px, strict=True)
    }
    assert [was[tuple(point)] for point in found.point_px] == found.deviation_px.tolist()


def apart(lines):
    return len(np.unique(joined(lines).piece))


def test_a_longer_gap_stays(make_lines):
    after = 101 + LONGEST_WIDTHS * WIDTH
    assert apart(make_lines(straight((10, 50), (100, 50)), straight((after, 50), (200, 50)), width=WIDTH)) == 2


def test_ends_that_turn_stay_apart(make_lines):
    assert apart(make_lines(straight((10, 50), (100, 50)), straight((108, 50), (150, 90)), width=WIDTH)) == 2


def test_strands_side_by_side_stay_apart(make_lines):
    assert apart(make_lines(straight((10, 50), (100, 50)), straight((108, 56), (200, 56)), width=WIDTH)) == 2


def test_the_four_ends_of_a_crossing_stay_apart(make_lines):
    arms = straight((10, 50), (96, 50)), straight((104, 50), (200, 50))
    other = straight((100, 10), (100, 46)), straight((100, 54), (100, 90))
    assert apart(make_lines(*arms, *other, width=WIDTH)) == 4


def test_a_gap_through_which_another_strand_leads_stays(make_lines):
    arms = straight((10, 50), (97, 50)), straight((103, 50), (200, 50))
    assert apart(make_lines(*arms, straight((100, 10), (100, 90)), width=WIDTH)) == 3


def test_a_ring_of_pieces_keeps_every_point_once(make_lines):
    def arc(start, end):
        angle = np.linspace(start, end, 200)
        return 100 + 60 * np.column_stack((np.cos(angle), np.sin(angle)))

    lines = make_lines(arc(0.05, np.pi - 0.05), arc(np.pi + 0.05, 2 * np.pi - 0.05), width=WIDTH)
    found = joined(lines)
    assert sorted(map(tuple, found.point_px)) == sorted(map(tuple, lines.point_px))
    assert len(np.unique(found.piece)) == 1


@pytest.mark.parametrize("cut_eye", [0, 1])
def test_thread_along_the_rows_has_a_say_beyond_a_gap_though_its_end_is_seen_by_one_eye_alone(see, camera, cut_eye):
    end = 0.9, 1.0
    shown = [((0.0, end[eye]),) if eye != cut_eye else ((0.0, 0.6), (0.605, end[eye])) for eye in (0, 1)]
    course = course_of(see(flat_end, 0, shown[0]), see(flat_end, 1, shown[1]), camera, disparities(camera.image_width))
    right = np.sort(course.sight.s[course.sight.eye == 1])
    far = right[-1] if right[0] < 0.05 else 1.0 - right[0]
    assert far > 0.95
    assert np.diff(right).max() < 0.03
