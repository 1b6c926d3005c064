"""Ends of a thread and ends of what is seen of it: a cover hides other places in the one image than in the other."""

import numpy as np
import pytest

from agents.reconstruction.refined.alignment import align
from agents.reconstruction.refined.chains import COVERED, chains
from agents.reconstruction.refined.method import course_of
from agents.reconstruction.refined.tips import MOST_EVIDENCE, ends_of
from shared.disparities import disparities

WHOLE = 292.0
"""Degrees of the circle that the hoop goes through, from 20 on."""


def hoop(t):
    """Most of a circle, a little askew, in millimetres."""
    angle = np.radians(20.0 + WHOLE * t)
    return np.column_stack((10 * np.cos(angle), 10 * np.sin(angle), 95 + 1.5 * np.cos(angle)))


def hoop_shown(*degrees):
    """Stretches of the hoop, from and to angles."""
    return [((low - 20.0) / WHOLE, (high - 20.0) / WHOLE) for low, high in degrees]


@pytest.fixture
def told(camera):
    """How much likelier tips than covered the ends of the left pieces are, in the order of the pieces."""

    def of(left, right):
        found = chains(left, camera.image_width)
        matched = [(chain, align(chain, right, disparities(camera.image_width))) for chain in found]
        ends = np.flatnonzero(np.diff(left.piece, prepend=-1, append=-1))
        index = np.sort(np.concatenate((ends[:-1], ends[1:] - 1)))
        return ends_of(left, right, matched, camera).tip[index]

    return of


@pytest.mark.parametrize("nearer", [0.02, 0.06])
def test_ends_at_a_cover_of_another_depth_are_covered_and_others_are_tips(told, see, threads, nearer):
    left = see(threads["winding"], 0, ((0.0, 0.42), (0.62, 1.0)))
    right = see(threads["winding"], 1, ((0.0, 0.42 - nearer), (0.62 - nearer, 1.0)))
    tip = told(left, right)
    assert (tip[[0, 3]] > 1.0).all()
    assert (tip[[1, 2]] < COVERED).all()
    assert np.abs(tip).max() <= MOST_EVIDENCE
    # what ends at one place in both images is not covered
    assert (told(left, see(threads["winding"], 1, ((0.0, 0.42), (0.62, 1.0)))) > 1.0).all()


def test_ends_along_the_rows_say_nothing(told, make_lines):
    # as far as the rows can tell, the right image may show any other part of the line
    level = np.array([[300.0, 150.0], [500.0, 150.05]])
    upright = np.array([[300.0, 200.0], [310.0, 400.0]])
    tip = told(make_lines(upright, level), make_lines(upright - [55, 0], level - [70, 0]))
    assert np.abs(tip[2:]).max() < 0.5


def test_a_short_end_behind_a_tool_belongs_to_the_thread(see, camera):
    left = see(hoop, 0, hoop_shown((20, 190), (300, 312)))
    right = see(hoop, 1, hoop_shown((20, 184), (294, 312)))
    assert len(chains(left, camera.image_width)) == 2
    course = course_of(left, right, camera, disparities(camera.image_width))
    assert set(course.left.piece.tolist()) == {0, 1}
    assert set(course.left.index[[0, -1]].tolist()) == {0, len(left.piece) - 1}


def test_a_short_piece_with_tips_of_its_own_or_of_another_depth_stays_outside(see, camera, make_lines):
    left, own_tips = (see(hoop, eye, hoop_shown((20, 190), (300, 312))) for eye in (0, 1))
    right = see(hoop, 1, hoop_shown((20, 184), (294, 312)))
    deeper = make_lines(right.point_px[right.piece == 0], right.point_px[right.piece == 1] - (90.0, 0.0))
    for other in (own_tips, deeper):
        course = course_of(left, other, camera, disparities(camera.image_width))
        assert set(course.left.piece.tolist()) == {0}


@pytest.mark.parametrize("rows_off", [0.0, 5.0])
def test_ends_beside_each_other_are_cut_where_rows_that_are_off_make_both_look_covered(camera, make_lines, rows_off):
    # a needle lies back along the end of its thread; what is hidden might turn back, but here nothing is
    t = np.linspace(0.0, 1.0, 400)[:, None]
    thread = np.hstack((400.0 + 40.0 * np.sin(3.0 * (1 - t)), 60.0 + 340.0 * t))
    needle = np.hstack((412.0 + 30.0 * t**2, 398.0 - 120.0 * t))
    left = make_lines(thread, needle)
    right = make_lines(*(piece - (55.0, 0.0) + (0.0, rows_off) for piece in (thread, needle)))
    found = chains(left, camera.image_width)
    known = ends_of(
        left, right, [(chain, align(chain, right, disparities(camera.image_width))) for chain in found], camera
    )
    cut = int((left.piece == 0).sum())
    assert (known.tip[[cut - 1, cut]] < COVERED).all() == (rows_off != 0)
    assert set(chains(left, camera.image_width, known)[0].piece.tolist()) == {0}
