"""Several threads that look alike: each is reconstructed by itself, as long as it is seen to be."""

from dataclasses import replace

import numpy as np
import pytest

from agents.reconstruction.methods import METHODS, TRACKERS
from schemas.codec import decode, encode
from schemas.messages import Centrelines, Status, StrandLines, ThreadCandidate, ThreadReconstruction, Trail
from shared.splines import evaluate
from tests.agents.reconstruction.refined.test_tracking import seen, winding

NO = np.zeros(0, bool)
NO_TRAIL = Trail(NO, NO, np.zeros(0), np.zeros((0, 3, 3), np.uint8), NO, NO)
track, alone = TRACKERS["refined"], METHODS["refined"]


def drawn_in(number):
    """A second thread, of which less is seen from frame to frame, as tissue takes it in at x = -15 mm."""
    return lambda t: np.column_stack((-15 + (25 - number) * t, np.full(len(t), 17.0), 92 + 3 * t))


def under(t):
    """A thread that no course leads to from the first one."""
    return np.column_stack((-2 + 4 * t, 8 + 16 * t, 92 + 3 * t))


def apart(t):
    """A thread whose ends are nowhere near those of the first one."""
    return np.column_stack((-5 + 12 * t, np.full(len(t), 28.0), 92 + 3 * t))


def speck(t):
    """Too little to be a thread."""
    return winding(0.5 + 0.01 * t)


def lines(shape, number=0):
    found = seen(shape, number=number)
    return StrandLines(found.centrelines_left, found.centrelines_right, NO_TRAIL, NO_TRAIL)


def beside(one, other):
    piece = np.concatenate((one.piece, one.piece.max() + 1 + other.piece))
    parts = ((getattr(one, name), getattr(other, name)) for name in ("point_px", "width_px", "deviation_px"))
    point, width, deviation = map(np.concatenate, parts)
    return Centrelines(point, piece, width, deviation)


def candidate(of):
    left, right = (each.point_px[::6] for each in (of.centrelines_left, of.centrelines_right))
    return ThreadCandidate(0.9, left, right, 5.0, np.zeros(3, np.int64))


def both(number):
    return replace(seen(number=number), strands=(lines(drawn_in(number), number),))


def off_mm(thread, shape):
    """The greatest distance from a curve to the nearest of the true points, and of the ends, which may be turned."""
    at = evaluate(thread.knots, thread.control_points_camera, 3, np.linspace(0, 1, 200))
    true = shape(np.linspace(0, 1, 800))
    ends = min(float(np.linalg.norm(at[[0, -1]] - true[way], axis=1).max()) for way in ([0, -1], [-1, 0]))
    return max(float(np.linalg.norm(at[:, None] - true[None], axis=2).min(axis=1).max()), ends)


@pytest.mark.parametrize("made", [track, lambda observations, _: alone(observations)], ids=["tracked", "alone"])
def test_each_strand_has_a_curve_in_every_frame_that_ends_where_it_is_seen_to_end(made):
    last = None
    for number in range(6):
        last = decode(ThreadReconstruction, encode(made(both(number), last)))
        assert off_mm(last, winding) < 0.3
        meant, strand = last.apart
        assert off_mm(meant, winding) < 0.3
        assert off_mm(strand, drawn_in(number)) < 0.3


def test_what_of_the_centrelines_is_no_part_of_the_thread_is_a_strand_too():
    first, second = seen(), lines(under)
    together = replace(
        first,
        centrelines_left=beside(first.centrelines_left, second.centrelines_left),
        centrelines_right=beside(first.centrelines_right, second.centrelines_right),
        candidates=(candidate(first), candidate(second)),
    )
    made = alone(together)
    assert off_mm(made, winding) < 0.3
    _, strand = made.apart
    assert off_mm(strand, under) < 0.3


def test_a_strand_that_is_no_thread_is_left_out_and_a_thread_that_fails_leaves_its_strands():
    assert len(track(replace(both(0), strands=(lines(speck),)), None).strands) == 1
    assert track(seen(), None).strands == ()
    failed = track(replace(seen(speck), strands=(lines(drawn_in(0)),)), None)
    assert failed.status is Status.FAILED
    assert off_mm(failed.apart[0], drawn_in(0)) < 0.3


def test_pieces_that_nobody_sees_joined_are_strands_of_their_own():
    first, second = seen(), lines(apart)
    together = replace(
        first,
        centrelines_left=beside(first.centrelines_left, second.centrelines_left),
        centrelines_right=beside(first.centrelines_right, second.centrelines_right),
        strands=(lines(drawn_in(0)),),
    )
    made = alone(together).apart
    assert len(made) == 3
    assert max(min(off_mm(one, shape) for one in made) for shape in (winding, apart, drawn_in(0))) < 0.3


def test_a_thread_of_which_too_little_is_seen_between_its_pieces_leaves_those_as_strands():
    shapes = [lambda t: winding(0.35 * t), lambda t: winding(0.65 + 0.35 * t)]
    first, second = seen(shapes[0]), lines(shapes[1])
    together = replace(
        first,
        centrelines_left=beside(first.centrelines_left, second.centrelines_left),
        centrelines_right=beside(first.centrelines_right, second.centrelines_right),
    )
    made = alone(together)
    assert made.status is Status.FAILED
    assert max(min(off_mm(one, shape) for one in made.apart) for shape in shapes) < 0.3


def test_threads_whose_ends_are_apart_are_no_strands_of_one_thread():
    assert track(replace(seen(), strands=(lines(apart),)), None).strands == ()
    unknown = replace(both(0), camera=replace(both(0).camera, metres_per_unit=None))
    assert track(unknown, None).strands == ()
