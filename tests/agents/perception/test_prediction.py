"""Where both eyes are to look for the thread: the curve in space, brought to where it was seen last."""

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import make_lsq_spline
from scipy.spatial import KDTree

from agents.perception.centrelines.along import Pieces
from agents.perception.following.appearance import some_of_observed
from agents.perception.following.prediction import expected
from schemas.messages import (
    Centrelines,
    FrameStamp,
    RectifiedStereo,
    ReliabilityRegions,
    Status,
    ThreadReconstruction,
    ThreadTrack,
    TrackStep,
    Trail,
)
from shared.camera import project

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)
FRAME_NS = 33_000_000
U = np.linspace(0.0, 1.0, 1200)
ARC = np.column_stack((30 * (U - 0.5), 12 * np.sin(3 * U), 100 + 4 * U))
V = U - 0.5
LOOP = np.column_stack((50 * V - 12 * np.sin(2 * np.pi * V), 9 * np.cos(2 * np.pi * V), np.full(len(U), 100.0)))


def thread_along(points, velocity=None):
    """A reconstruction whose track runs along these points."""
    spans = 24
    inner = np.linspace(0, 1, spans + 1)
    knots = np.concatenate((np.zeros(3), inner, np.ones(3)))
    along = np.append(0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    control_points = make_lsq_spline(along / along[-1], points, knots).c
    m, stamp = len(control_points), FrameStamp(1, 0, 0, "")
    track = ThreadTrack(
        TrackStep.CONTINUED, "", 1, 0.0, 1.0, stamp, knots, control_points, np.zeros((m, 4, 3, 3)), 1.0,
        np.ones(spans), 0.0, float(along[-1]), np.array([0.0, 1.0]),
        velocity_camera=None if velocity is None else np.tile(np.asarray(velocity, float), (m, 1)),
    )  # fmt: skip
    nothing = np.zeros(0)
    regions = ReliabilityRegions(nothing, np.zeros((0, 3)), np.zeros((0, 2)), nothing, nothing)
    return ThreadReconstruction(
        stamp, CAMERA, Status.OK, "", "refined", 3, knots, control_points, regions, nothing, nothing, track=track
    )


def observed(*pieces):
    """What an eye saw of these lines, every second pixel, each piece with a colour of its own."""
    spaced = []
    for piece in pieces:
        along = np.append(0, np.cumsum(np.linalg.norm(np.diff(piece, axis=0), axis=1)))
        at = np.arange(0.0, along[-1], 2.0)
        spaced.append(np.column_stack([np.interp(at, along, part) for part in piece.T]))
    number = np.repeat(np.arange(len(spaced)), [len(piece) for piece in spaced])
    point = np.concatenate(spaced)
    some = some_of_observed(Pieces(number))
    colours = np.tile((40 + 10 * number[some])[:, None, None], (1, 3, 3)).astype(np.uint8)
    yes = np.ones(len(spaced), bool)
    length = np.array([2.0 * (len(piece) - 1) for piece in spaced])
    return (
        Centrelines(point, number, np.full(len(point), 5.0), np.ones(len(point))),
        Trail(yes, yes, length, colours, yes, yes),
    )


def looked_for(thread, *eyes, now_ns=0):
    found = expected(CAMERA, eyes, thread, 0, now_ns)
    assert not isinstance(found, str)
    return found


def farthest(point, line):
    return float(np.asarray(KDTree(line).query(point)[0]).max())


def test_what_was_hidden_is_looked_for_with_the_rest():
    left, right = project(CAMERA, ARC)
    eyes = observed(left[:500], left[700:]), observed(right[:450], right[700:])
    for found, line in zip(looked_for(thread_along(ARC), *eyes), (left, right), strict=True):
        assert farthest(found.lines.point_px, line) < 0.5
        assert farthest(line, found.lines.point_px) < 3.0
        assert found.lines.piece.max() == 0
        assert not found.was_seen.all()
        assert found.was_seen.mean() > 0.7


def test_a_curve_that_is_late_or_off_is_brought_to_where_it_was_seen_last():
    left, right = (line + np.array((1.0, 7.0)) for line in project(CAMERA, ARC))
    for found, line in zip(looked_for(thread_along(ARC), observed(left), observed(right)), (left, right), strict=True):
        # along itself the thread shows no motion
        assert farthest(found.lines.point_px[5:-5], line) < 1.0


def test_a_curve_goes_on_moving_as_it_did():
    eyes = [observed(line) for line in project(CAMERA, ARC)]
    there = project(CAMERA, ARC + np.array((0.0, 2.0, 0.0)))
    thread = thread_along(ARC, velocity=np.array((0.0, 2.0, 0.0)) / (1e-9 * FRAME_NS))
    for found, line in zip(looked_for(thread, *eyes, now_ns=FRAME_NS), there, strict=True):
        assert farthest(found.lines.point_px, line) < 0.5


def test_a_thread_that_crosses_itself_is_cut_there_and_each_strand_keeps_to_its_own_side():
    left, right = project(CAMERA, LOOP)
    found = looked_for(thread_along(LOOP), observed(left), observed(right))[0]
    assert found.lines.piece.max() == 2
    assert (found.trail.loose_start.tolist(), found.trail.loose_end.tolist()) == (
        [True, False, False],
        [False, False, True],
    )
    strands = [found.lines.point_px[found.lines.piece == k] for k in range(3)]
    for k, own in enumerate(strands):
        others = np.concatenate([strand for other, strand in enumerate(strands) if other != k])
        apart = np.asarray(KDTree(others).query(own)[0])
        reach = found.reach_px[found.lines.piece == k]
        assert (reach <= apart / 2 + 1e-9).all()


@pytest.mark.parametrize("with_curve", [True, False])
def test_what_is_none_of_the_curve_is_looked_for_where_it_was(with_curve):
    left, right = project(CAMERA, ARC)
    other = np.column_stack((np.linspace(100, 250, 200), np.full(200, 480.0)))
    eyes = observed(left, other), observed(right, other)
    found = looked_for(thread_along(ARC) if with_curve else None, *eyes)[0]
    assert farthest(other, found.lines.point_px) < 3.0
    assert farthest(left, found.lines.point_px) < 3.0
    assert len(np.unique(found.trail.colour_bgr)) == 2


def test_without_anything_seen_nothing_tells_where_to_look():
    lines, trail = observed(project(CAMERA, ARC)[0])
    none = dataclasses.replace(
        lines, point_px=np.zeros((0, 2)), piece=np.zeros(0, int), width_px=np.zeros(0), deviation_px=np.zeros(0)
    )
    assert expected(CAMERA, [(none, trail), (lines, trail)], None, 0, 0) == "no pieces"


def test_pieces_that_are_too_short_and_curves_that_no_thread_has_tell_nothing():
    short = observed(np.column_stack((np.linspace(100, 106, 10), np.full(10, 50.0))))
    assert expected(CAMERA, [short, short], None, 0, 0) == "no piece is long enough"
    left, right = (observed(line) for line in project(CAMERA, ARC))
    far = looked_for(thread_along(ARC, velocity=(1e12, 0.0, 0.0)), left, right, now_ns=FRAME_NS)[0]
    alone = looked_for(None, left, right)[0]
    assert np.array_equal(far.lines.point_px, alone.lines.point_px)
