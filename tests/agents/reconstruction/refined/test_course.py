"""The thread's course through pieces that are given in any order and direction, and how sure it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from agents.reconstruction.refined.course import BothImages, likeliest_course
from agents.reconstruction.refined.method import course_of
from schemas.messages import SURE, Image, ImageEncoding, Occluder, Occluders
from shared.camera import project
from shared.disparities import disparities

SIZE = 960, 540
SHIFT = np.array([55.0, 0.0])
WHOLE = 292.0
"""Degrees of the circle that the hoop goes through, from 20 on."""


def loop(t):
    """A strand that crosses itself at t = -1 and t = 1, straight on both times."""
    return np.column_stack((480 + 130 * (t**2 - 1), 270 + 130 * t * (t**2 - 1)))


def hoop(t):
    """Most of a circle, a little askew, in millimetres."""
    angle = np.radians(20.0 + WHOLE * t)
    return np.column_stack((10 * np.cos(angle), 10 * np.sin(angle), 95 + 1.5 * np.cos(angle)))


def hoop_shown(*degrees):
    """Stretches of the hoop, from and to angles."""
    return [((low - 20.0) / WHOLE, (high - 20.0) / WHOLE) for low, high in degrees]


def map_image(pixels):
    return Image(ImageEncoding.RAW, pixels.shape[1], pixels.shape[0], 1, pixels.tobytes())


def found_in(make_lines, *pieces, right=None, occluders=None):
    """The course through pieces at one depth."""
    left = make_lines(*pieces)
    right = make_lines(*(piece - SHIFT for piece in pieces)) if right is None else right
    found = likeliest_course(BothImages(left, right, disparities(SIZE[0]), SIZE, occluders))
    assert found is not None
    return found


def visited(chain):
    """The pieces in the order of the chain, from that end at which the smaller number stands."""
    changes = np.flatnonzero(np.diff(chain.piece, prepend=-1))
    order = chain.piece[changes].tolist()
    return min(order, order[::-1])


@given(order=st.permutations([0, 1, 2]), turned=st.tuples(*[st.booleans()] * 3))
def test_a_crossing_is_passed_straight_on_and_for_certain(make_lines, order, turned):
    stretches = [(-1.5, -1.02), (-0.98, 0.98), (1.02, 1.5)]
    pieces = [
        loop(np.linspace(stretches[k][0], stretches[k][1], 400))[:: -1 if back else 1]
        for k, back in zip(order, turned, strict=True)
    ]
    found = found_in(make_lines, *pieces)
    t = np.linspace(-1.5, 1.5, 6001)
    apart, nearest = cKDTree(loop(t)).query(found.chain.point_px)
    assert np.max(apart) < 0.2
    assert (np.diff(t[nearest]) > 0).mean() in (0.0, 1.0)
    assert len(set(found.chain.piece.tolist())) == 3
    assert found.probability.min() > SURE


def test_where_two_courses_are_as_likely_none_is_certain_and_both_are_told(make_lines):
    # two strands go behind a tool, so inclined that parallel and crossed they bend as much; beyond it they are one loop
    gap, apart = np.array([160.0, 0.0]), np.array([0.0, 40.0])
    inclined = np.arctan2(apart[1], gap[0]) * np.sqrt(3) / (1 + np.sqrt(3))
    down, up = (np.array([np.cos(inclined), side * np.sin(inclined)]) for side in (1, -1))
    t, corner = np.linspace(0.0, 1.0, 250)[:, None], np.array([400.0, 250.0])
    above, below = corner - 250 * t * down, corner + apart - 250 * t * up
    far = corner + gap, corner + gap + 180 * up, corner + gap + apart + 180 * down, corner + gap + apart
    loop = sum(k * (1 - t) ** (3 - i) * t**i * far[i] for i, k in enumerate((1, 3, 3, 1)))
    occluders = np.zeros((135, 240), np.uint8)
    occluders[40:95, 100:140] = 1
    found = found_in(make_lines, above, loop, below, occluders=occluders)
    assert visited(found.chain) == [0, 1, 2]
    assert 0.3 < found.probability.min() < 0.7
    changes = np.flatnonzero(np.diff(found.chain.piece)) + 1
    here = [(int(piece[0]), int(piece[-1])) for piece in np.split(found.chain.index, changes)]
    other = [tuple(piece) for piece in found.other.tolist()]
    # the next likeliest goes round the other way
    assert {tuple(sorted(piece)) for piece in other} == {tuple(sorted(piece)) for piece in here}
    assert other not in (here, [(b, a) for a, b in here[::-1]])


def test_a_kink_where_ends_touch_is_followed(make_lines):
    t = np.linspace(0, 1, 100)[:, None]
    corner = np.array([400.0, 300.0])
    thread, needle = corner + t * [-200, 30], corner + [1, 1] + t * [40, -120]
    assert visited(found_in(make_lines, thread, needle).chain) == [0, 1]


def test_a_long_gap_is_bridged_to_what_continues_the_bend(make_lines):
    def arc(low, high):
        angle = np.linspace(low, high, 300)
        return np.column_stack((480 + 200 * np.cos(angle), 270 + 200 * np.sin(angle)))

    stray = np.column_stack((np.full(100, 484.0), np.linspace(430, 480, 100)))
    found = found_in(make_lines, arc(0.0, 1.2), stray, arc(1.9, 3.0))
    assert visited(found.chain) == [0, 2]
    assert np.diff(found.chain.along_px).max() == pytest.approx(2 * 200 * np.sin(0.35), rel=0.02)


def test_clutter_beside_the_thread_is_left_out_and_specks_are_no_thread(make_lines, threads, see):
    thread = see(threads["waving"], 0).point_px
    rng = np.random.default_rng(3)
    clutter = [np.array([place, place + rng.normal(0, 6, 2)]) for place in rng.uniform(40, 500, (12, 2))]
    pieces = [piece for piece in clutter if np.linalg.norm(thread - piece.mean(axis=0), axis=1).min() > 40]
    assert len(pieces) > 4
    assert visited(found_in(make_lines, *pieces, thread, right=see(threads["waving"], 1)).chain) == [len(pieces)]
    specks = make_lines(*(np.array([[k, 100.0], [k + 1.0, 100.0]]) for k in range(100, 400, 30)))
    assert likeliest_course(BothImages(specks, specks, disparities(SIZE[0]), SIZE)) is None


@pytest.mark.parametrize("gap_ends", [270, 300])
def test_an_end_behind_a_tool_belongs_to_the_thread_or_is_said_to_be_undecided(see, of_lines, camera, gap_ends):
    # what both images hide, each at other places of the thread; a speck far behind the tool may be something else
    left = see(hoop, 0, hoop_shown((20, 190), (gap_ends, 312)))
    right = see(hoop, 1, hoop_shown((20, 184), (gap_ends - 6, 312)))
    hidden_px, _ = project(camera, hoop((np.linspace(192, gap_ends - 2, 200) - 20) / WHOLE))
    tool = np.zeros((135, 240), np.uint8)
    u, v = np.rint(hidden_px.T / 4).astype(int)
    tool[v.min() : v.max() + 1, u.min() : u.max() + 1] = Occluder.TOOL.value
    course = course_of(of_lines(left, right, occluders=Occluders(map_image(tool), map_image(tool), 7)))
    whole, sure = set(course.left.piece.tolist()) == {0, 1}, course.likeliest.probability.min() > SURE
    assert (whole and sure) if gap_ends == 270 else (whole or not sure)


def test_a_short_piece_of_another_depth_stays_outside(see, make_lines, of_lines):
    left = see(hoop, 0, hoop_shown((20, 190), (300, 312)))
    right = see(hoop, 1, hoop_shown((20, 184), (294, 312)))
    deeper = make_lines(right.point_px[right.piece == 0], right.point_px[right.piece == 1] - (90.0, 0.0))
    course = course_of(of_lines(left, deeper))
    assert set(course.left.piece.tolist()) == {0}


def test_what_one_eye_cuts_and_the_other_shows_whole_is_one_thread(threads, see, of_lines):
    left = see(threads["winding"], 0, ((0.0, 0.3), (0.5, 1.0)))
    course = course_of(of_lines(left, see(threads["winding"], 1)))
    assert set(course.left.piece.tolist()) == {0, 1}
    assert course.likeliest.probability.min() > SURE
